"""Work on a cluster: the same bytes whoever computes and whoever dies, and every trap in a line."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skygain.app.requests import DatasetBuildRequest
from skygain.datasets.builder import build_dataset
from skygain.datasets.presets import BuildConfig
from skygain.evaluation.comparison import compare
from skygain.evaluation.request import EvaluateRequest
from skygain.ground.errors import InputError
from skygain.ground.executor import cluster as cluster_module
from skygain.ground.executor import units

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

FAST = BuildConfig(
    name="fast", cities=(6, 0, 0, 6), max_sites=2, altitudes_m=(10.0,), propagation="gudmundson"
)
"""twelve cities without a ray tracer"""

Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler in a process of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"]
    with _quiet_process([*command, "--host", address]) as process:
        _wait_for(port)
        yield address
        process.kill()


def _wait_for(port: int) -> None:
    """Until somebody listens there."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        with socket.socket() as caller:
            if caller.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    pytest.fail("the scheduler did not begin within two minutes")


@pytest.fixture
def worker(scheduler: str, tmp_path: Path) -> Iterator[Start]:
    """Begins a worker of the scheduler in a process of its own."""
    begun: list[subprocess.Popen[bytes]] = []

    def start(*options: str, path: Path | None = None) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_worker", scheduler, "--no-nanny"]
        threads = () if "--nthreads" in options else ("--nthreads", "1")
        plain = ("--no-dashboard", "--local-directory", str(tmp_path / "dask"))
        before = os.environ.get("PYTHONPATH", "")
        env = {"PYTHONPATH": f"{path}{os.pathsep}{before}" if path else before}
        begun.append(_quiet_process([*command, *threads, *plain, *options], **env))
        return begun[-1]

    yield start
    for process in begun:
        process.kill()
        process.wait()


def _quiet_process(command: list[str], **env: str) -> subprocess.Popen[bytes]:
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=quiet, env={**os.environ, **env})


def test_a_build_survives_its_workers(scheduler: str, worker: Start, tmp_path: Path) -> None:
    """Two of four workers are killed at random moments, and one more comes."""
    alone = build_dataset(FAST, tmp_path / "alone.zarr.zip", workers=1)
    workers = [worker() for _ in range(4)]
    rng = np.random.default_rng()
    moments = set(rng.choice(np.arange(1, 11), size=2, replace=False).tolist())

    def progress(done: int, total: int, seconds_left: float | None) -> None:
        if done in moments:
            workers.pop(int(rng.integers(len(workers)))).kill()
            worker()

    shared = build_dataset(FAST, tmp_path / "shared.zarr.zip", cluster=scheduler, progress=progress)
    assert len(workers) == 2
    assert shared.read_bytes() == alone.read_bytes()


def test_surveys_score_the_same_on_a_cluster(scheduler: str, worker: Start, tmp_path: Path) -> None:
    worker()
    request = EvaluateRequest(
        methods=("idw / lawnmower", "knn / random-waypoint"),
        steps=10,
        record_every=5,
        max_surveys=2,
        workers=1,
        out=tmp_path / "alone",
    )
    alone = compare(request)
    shared = compare(replace(request, cluster=scheduler, out=tmp_path / "shared"))
    assert shared.request.settings == alone.request.settings
    for label, named in alone.scores.items():
        for name, values in named.items():
            assert np.array_equal(values, shared.scores[label][name], equal_nan=True)


def test_a_unit_computes_on_one_thread_in_the_folder_of_the_command(
    scheduler: str, worker: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker()
    monkeypatch.chdir(tmp_path)
    jobs = [("OMP_NUM_THREADS",), ("NUMBA_NUM_THREADS",)]
    assert list(units(os.getenv, jobs, workers=1, cluster=scheduler)) == ["1", "1"]
    assert list(units(os.getcwd, [()], workers=1, cluster=scheduler)) == [str(tmp_path)]


def test_an_error_of_a_unit_is_told_as_it_is(scheduler: str, worker: Start) -> None:
    worker()
    with pytest.raises(InputError, match="T9"):
        compare(EvaluateRequest(split="T9", cluster=scheduler))
    with pytest.raises(ZeroDivisionError):
        list(units(divmod, [(1, 0)], workers=1, cluster=scheduler))


def test_a_unit_that_ends_its_workers_is_told(scheduler: str, worker: Start) -> None:
    for _ in range(4):
        worker()
    with pytest.raises(InputError, match="want of memory"):
        list(units(os._exit, [(1,)], workers=1, cluster=scheduler))


@pytest.mark.parametrize(
    ("options", "package", "message"),
    [
        (("--nthreads", "2"), None, "begin workers with --nthreads 1"),
        ((), "raise ImportError('none here')", "has no Skygain"),
        ((), "__version__ = '0.0'", r"skygain 0\.0 .* there, .* here"),
    ],
)
def test_workers_that_would_compute_otherwise_are_refused(
    options: tuple[str, ...],
    package: str | None,
    message: str,
    scheduler: str,
    worker: Start,
    tmp_path: Path,
) -> None:
    path = None
    if package is not None:
        path = tmp_path / "other"
        (path / "skygain").mkdir(parents=True)
        (path / "skygain" / "__init__.py").write_text(package)
    worker(*options, path=path)
    with pytest.raises(InputError, match=message):
        list(units(os.getpid, [()], workers=1, cluster=scheduler))


def test_a_scheduler_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "ANSWER_S", 0.5)
    began = time.monotonic()
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        list(units(os.getpid, [()], workers=1, cluster="tcp://127.0.0.1:9"))
    assert time.monotonic() - began < 10


def test_a_scheduler_without_workers_is_told(
    scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "WORKERS_S", 0.5)
    with pytest.raises(InputError, match="dask worker tcp://"):
        list(units(os.getpid, [()], workers=1, cluster=scheduler))


@pytest.mark.parametrize("text", ["here", "tcp://host", "http://host:80", "slurm:", "tcp://:1x"])
def test_what_is_no_cluster_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="`cluster` must be tcp://HOST:PORT"):
        DatasetBuildRequest(preset="tiny", out=Path("a.zarr.zip"), cluster=text)
