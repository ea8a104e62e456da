"""Jobs of Slurm become workers, and go; a small stand-in takes the place of sbatch and scancel."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from skygain.ground.errors import InputError
from skygain.ground.executor import units

pytest.importorskip("dask_jobqueue", reason="the extra `cluster` is not installed")

RUNS = """#!/bin/sh
cp "$1" {folder}/job.sh
sh {folder}/job.sh > /dev/null 2>&1 &
echo "Submitted batch job $!"
"""
REFUSES = """#!/bin/sh
echo "sbatch: error: invalid partition" >&2
exit 1
"""
LEAVES = """#!/bin/sh
echo "Submitted batch job 1"
"""
CONFIG = "jobs = 1\ncores = 1\nmemory = '1GB'\n"


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Puts an sbatch of that text onto the path; scancel notes what it was given and kills it."""

    def put(text: str) -> None:
        cancel = f"#!/bin/sh\necho $@ >> {tmp_path}/cancelled\nkill $@\n"
        for name, script in (("sbatch", text), ("scancel", cancel)):
            (tmp_path / name).write_text(script.format(folder=tmp_path))
            (tmp_path / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)

    return put


def _processes(config: Path) -> list[int]:
    return list(units(os.getpid, [()] * 2, workers=1, cluster=f"slurm:{config}"))


def test_jobs_compute_and_are_cancelled(slurm: Callable[[str], None], tmp_path: Path) -> None:
    slurm(RUNS)
    config = tmp_path / "config.toml"
    config.write_text(CONFIG)
    found = _processes(config)
    assert len(set(found)) == 1
    assert found[0] != os.getpid()
    assert (tmp_path / "cancelled").read_text().strip()
    assert "--nthreads 1" in (tmp_path / "job.sh").read_text()


@pytest.mark.parametrize(
    ("sbatch", "config", "message"),
    [
        (REFUSES, CONFIG, "Slurm refuses the jobs of .*invalid partition"),
        (LEAVES, f"wait_minutes = 0.01\n{CONFIG}", "squeue"),
        (RUNS, f"nonsense = 1\n{CONFIG}", "dask-jobqueue does not have.*nonsense"),
        (RUNS, "cores = 1", "needs `jobs`"),
        (RUNS, "jobs = 1\ncores = 1", "needs `memory`"),
        (RUNS, "jobs =", "cannot be read"),
    ],
)
def test_what_goes_wrong_is_one_line(
    sbatch: str, config: str, message: str, slurm: Callable[[str], None], tmp_path: Path
) -> None:
    slurm(sbatch)
    file = tmp_path / "config.toml"
    file.write_text(config)
    with pytest.raises(InputError, match=message):
        _processes(file)


def test_a_machine_without_slurm_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "config.toml").write_text(CONFIG)
    with pytest.raises(InputError, match="there is no `sbatch`"):
        _processes(tmp_path / "config.toml")
