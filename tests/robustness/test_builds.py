"""A build of a data set that is killed, or fills the disk, goes on to the same bytes.

More kills: test_kills.py, and of two workers tests/datasets/test_builder.py.
"""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from .processes import ended, skygain, small_disk

ASKED = ("dataset", "build", "--preset", "tiny", "--propagation", "gudmundson", "--out")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "cities.zarr.zip"
    code, _, err = ended(skygain(*ASKED, path))
    assert code == 0, err
    return path.read_bytes()


def test_ended_it_goes_on_to_the_same_bytes(tmp_path: Path, whole: bytes) -> None:
    path, number = tmp_path / "cities.zarr.zip", signal.SIGTERM
    child = skygain(*ASKED, path)
    while child.poll() is None and len(list(tmp_path.glob("*.parts/city-*.zip"))) < 3:
        time.sleep(0.002)
    child.send_signal(number)
    code, _, err = ended(child)
    assert code in (0, -number, 128 + number)
    if code == 128 + number:
        assert "the same command goes on" in err
        assert "Traceback" not in err
    code, _, err = ended(skygain(*ASKED, path))
    assert code == 0, err
    assert path.read_bytes() == whole
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_a_full_disk_is_one_line(tmp_path: Path, whole: bytes) -> None:
    with small_disk(tmp_path / "disk", len(whole) // 2048) as disk:
        path = disk.path / "cities.zarr.zip"
        code, _, err = ended(skygain(*ASKED, path))
        assert code == 2, err
        assert "No space left" in err
        assert "Traceback" not in err
        disk.enlarge()
        code, _, err = ended(skygain(*ASKED, path))
        assert code == 0, err
        assert path.read_bytes() == whole
