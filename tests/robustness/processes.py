"""Commands as processes of their own, to be killed, and disks that are soon full."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

TRIALS = int(os.environ.get("SKYGAIN_TRIALS", "1"))
SIGNALS = [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP]


def skygain(*words: str | Path, **options: object) -> subprocess.Popen[str]:
    return started([sys.executable, "-m", "skygain", *map(str, words)], **options)


def started(command: list[str], **options: object) -> subprocess.Popen[str]:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    if os.name == "posix":  # a job in the background ignores Ctrl-C, and so would its children
        pipes["preexec_fn"] = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.Popen(command, **(pipes | options))  # type: ignore[call-overload]


def ended(child: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = child.communicate(timeout=240)
    return child.returncode, out, err


def wait_for_lines(path: Path, lines: int, child: subprocess.Popen[str]) -> None:
    """Until the flight's journal has so many records, or the flight is over."""
    while child.poll() is None:
        with contextlib.suppress(OSError):
            if path.read_bytes().count(b"\n") >= lines:
                return
        time.sleep(0.002)


@dataclass(frozen=True)
class Disk:
    path: Path

    def enlarge(self) -> None:
        """Make room."""
        subprocess.run(["mount", "-o", "remount,size=50m", str(self.path)], check=True)


@contextlib.contextmanager
def small_disk(path: Path, kilobytes: int) -> Iterator[Disk]:
    """A disk of its own in the new folder ``path``; the test is skipped where there can be none."""
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("a small tmpfs needs root on Linux")
    path.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "none", str(path)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this machine does not let a small tmpfs be mounted")
    try:
        yield Disk(path)
    finally:
        subprocess.run(["umount", str(path)], check=False)
