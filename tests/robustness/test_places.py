"""A package that cannot be written to, on a machine without a home, still flies."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import skygain

from .processes import ended, small_disk
from .processes import skygain as command

PACKAGE = Path(skygain.__file__).parent
NOWHERE = "/proc/nowhere"
"""no folder can be made there, not even by root"""


def without_home(package: Path, temporary: Path) -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if k in ("PATH", "OMP_NUM_THREADS", "LANG")}
    return kept | {
        "HOME": NOWHERE,
        "PYTHONPATH": str(package),
        "TMPDIR": str(temporary),
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def test_a_read_only_package_without_a_home(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with small_disk(tmp_path / "site", 60_000) as disk:
        leave = shutil.ignore_patterns("__pycache__")
        shutil.copytree(PACKAGE, disk.path / "skygain", ignore=leave)
        subprocess.run(["mount", "-o", "remount,ro", str(disk.path)], check=True)
        temporary = tmp_path / "tmp"
        temporary.mkdir()
        child = command(
            "survey", "--city", "sample:9", "--predictor", "idw", "--planner", "lawnmower",
            "--steps", "3",
            cwd=tmp_path / "empty",
            env=without_home(disk.path, temporary),
        )  # fmt: skip
        code, out, err = ended(child)
        assert code == 0, err
        assert "Traceback" not in err
        assert "report: surveys/latest/report.html" in out
        assert any(temporary.glob("skygain-kernels-*/**/*.nbi"))


def test_a_cache_of_others_is_not_trusted(tmp_path: Path) -> None:
    """Anybody could have left a folder of that name: what is in it would be run."""
    planted = tmp_path / f"skygain-kernels-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    code = (
        "import os, pathlib; from skygain.ground import kernel_cache as c; "
        "c.os.access = lambda *_: False; os.environ.pop('NUMBA_CACHE_DIR', None); "
        "print(c.find_cache())"
    )
    env = os.environ | {"HOME": NOWHERE, "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    named = Path(done.stdout.strip())
    assert named.parent == tmp_path
    assert named != planted
    assert not named.stat().st_mode & 0o077
