"""A file is there in full or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write, writable_folder


def test_the_old_content_stays_until_the_new_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "map.txt"
    path.write_text("old")
    with atomic_write(path) as tmp:
        tmp.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["map.txt"]


def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "map.txt"
    path.write_text("old")

    def write_half() -> None:
        with atomic_write(path) as tmp:
            tmp.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["map.txt"]


def test_a_new_file_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with atomic_write(tmp_path / "deep" / "written") as tmp:
        tmp.write_text("x")
    assert (tmp_path / "deep" / "written").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("target", ["file/inside", "folder"])
def test_a_place_that_cannot_be_written_is_one_line_with_a_remedy(
    tmp_path: Path, target: str
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with (
        pytest.raises(InputError, match=r"cannot write .*choose a folder") as caught,
        atomic_write(tmp_path / target) as tmp,
    ):
        tmp.write_text("x")
    assert "\n" not in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_a_folder_is_tried_out_before_the_work(tmp_path: Path) -> None:
    assert writable_folder(tmp_path / "a" / "b").is_dir()
    assert os.listdir(tmp_path / "a" / "b") == []
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="choose a folder"):
        writable_folder(tmp_path / "file")
