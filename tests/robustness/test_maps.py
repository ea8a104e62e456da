"""Maps of a campaign: a full disk ends in one line, and nobody's file is overwritten unasked."""

from __future__ import annotations

from pathlib import Path

import pytest

from .processes import ended, skygain, small_disk


@pytest.fixture
def log(tmp_path: Path) -> Path:
    lines = ["x_m,y_m,rsrp_dbm"]
    lines += [f"{7 * k % 90},{13 * k % 80},{-70 - k % 9}" for k in range(80)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path, log: Path) -> None:
    with small_disk(tmp_path / "disk", 40) as disk:
        asked = ("map", log, "--recording-crs", "local", "--no-validate", "--out", disk.path / "m")
        code, _, err = ended(skygain(*asked))
        assert code == 2, err
        assert "No space left" in err
        assert "Traceback" not in err
        assert list((disk.path / "m").iterdir()) == []
        disk.enlarge()
        code, _, err = ended(skygain(*asked))
        assert code == 0, err


def test_a_strangers_file_stays(tmp_path: Path, log: Path) -> None:
    (tmp_path / "map.png").write_text("mine")
    code, _, err = ended(skygain("map", log, "--out", tmp_path))
    assert code == 2
    assert "--overwrite" in err
    assert (tmp_path / "map.png").read_text() == "mine"
