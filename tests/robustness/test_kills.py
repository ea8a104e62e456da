"""Commands that are killed again and again end as if they had been left alone.

``SKYGAIN_TRIALS`` is the number of kills of each command. Missions have theirs in test_missions.py.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from .chains import COMMANDS
from .processes import TRIALS

NEEDS = {"predictor": "torch", "policy": "torch"}
BRIEFLY = ("build",)
"""what is killed where there is little time; the others are killed once in files of their own"""


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="this system cannot wait for a child so")
@pytest.mark.parametrize("command", COMMANDS if TRIALS > 1 else BRIEFLY)
def test_killed_again_and_again(
    command: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    if command in NEEDS and importlib.util.find_spec(NEEDS[command]) is None:
        pytest.skip(f"{command} needs {NEEDS[command]}")
    words = [command, str(tmp_path), "0", str(max(3, TRIALS))]
    child = subprocess.run(
        [sys.executable, "-m", "tests.robustness.chains", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[2],
    )
    assert child.returncode == 0, child.stderr[-5000:]
    record_property("trials", child.stdout.strip())
