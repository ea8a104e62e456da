"""Wireless InSite's receiver grids become truth maps."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.instruments import grid_for, on_grid, read_recording


def p2m(path, level, values, spacing=5.0, cols=6):
    lines = ["# <Transmitter>", f"# Receiver number  X(m)  Y(m)  Z(m)  Distance(m)  {level}"]
    for i, value in enumerate(values, start=1):
        row, col = divmod(i - 1, cols)
        x, y = 100 + spacing * col, 200 + spacing * row
        lines.append(f" {i:4d} {x:.4e} {y:.4E} 1.5 {np.hypot(x, y):.3f} {value:.5e}")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_loss_becomes_a_gain_on_the_receivers_grid(tmp_path):
    loss = 80.0 + np.arange(24)
    recording = read_recording(p2m(tmp_path / "pl.t001_01.r002.p2m", "Path Loss (dB)", loss))
    assert recording.quantity == "gain"
    np.testing.assert_allclose(recording.level_db, -loss)
    gridded = on_grid(recording, grid_for(recording, None))
    assert gridded.grid.spacing_m == 5.0
    assert (len(gridded), gridded.count.max()) == (24, 1)
    np.testing.assert_allclose(gridded.grid.xy_m(gridded.cell), recording.xy_m)


def test_exponents_of_fortran(tmp_path):
    path = tmp_path / "pl.t001_01.r002.p2m"
    path.write_text("# Path Loss\n1 1.0D+02 2.0d+02 1.5 3.0E+02 9.1D+01\n")
    recording = read_recording(path)
    assert recording.xy_m.tolist() == [[100.0, 200.0]]
    assert recording.level_db.tolist() == [-91.0]


def test_receivers_without_a_path_are_left_out(tmp_path):
    power = [-60.0, -250.0, -70.5, -250.0, -80.0, -90.0]
    recording = read_recording(p2m(tmp_path / "power.t001_01.r002.p2m", "Power (dBm)", power))
    assert recording.quantity == "power"
    assert recording.level_db.tolist() == [-60.0, -70.5, -80.0, -90.0]
    assert "2 of 6 receivers hear nothing" in recording.notes[1]


def test_the_name_tells_what_the_comments_do_not(tmp_path):
    path = p2m(tmp_path / "pg.t001_01.r002.p2m", "x", [-90.0, -91.0])
    assert read_recording(path).quantity == "gain"
    with pytest.raises(InputError, match=r"pl\.p2m"):
        read_recording(p2m(tmp_path / "cir.p2m", "x", [-90.0]))


@pytest.mark.parametrize(
    "text",
    [
        "# Path Loss\n",
        "# Path Loss\n1 2 3\n",
        "# Path Loss\n1 0 0 1 5 90\n2 x\n",
        "# Power\n1 2\n3\n",
    ],
)
def test_what_is_no_table_is_one_line(tmp_path, text):
    path = tmp_path / "pl.p2m"
    path.write_text(text)
    with pytest.raises(InputError, match=r"pl\.p2m"):
        read_recording(path)
