"""A scenario of DeepMIMO is a map of its gain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import savemat

from skygain.ground.errors import InputError
from skygain.instruments import grid_for, on_grid, read_recording


@pytest.fixture(params=["npz", "mat"])
def scenario(tmp_path, request):
    """Two transmitters, 30 receivers 5 m apart at 1.5 m; the last hears nothing."""
    folder = tmp_path / "town_3p5"
    folder.mkdir()
    (folder / "params.json").write_text("{}")
    x, y = np.meshgrid(5.0 * np.arange(6), 5.0 * np.arange(5))
    place = np.column_stack([x.ravel(), y.ravel(), np.full(30, 1.5)]).astype(np.float32)
    for k, tx in enumerate(("t001_tx000", "t001_tx001")):
        power = np.full((30, 4), np.nan, dtype=np.float32)
        power[:29, :2] = -100.0 - 10.0 * k - np.arange(29)[:, None]
        for key, data in (("power", power), ("rx_pos", place)):
            path = folder / f"{key}_{tx}_r002.{request.param}"
            if request.param == "npz":
                np.savez_compressed(path, **{key: data})
            else:
                savemat(path, {key: data})
    return folder


def test_powers_of_paths_are_added(scenario):
    recording = read_recording(scenario, where={"tx": "t001_tx000"})
    assert recording.quantity == "gain"
    np.testing.assert_allclose(
        recording.level_db, -100.0 + 10 * np.log10(2) - np.arange(29), atol=1e-4
    )
    gridded = on_grid(recording, grid_for(recording, None))
    assert gridded.grid.shape == (5, 6)
    assert gridded.grid.spacing_m == 5.0
    assert any("have no path" in note for note in recording.notes)


def test_transmitters_are_several_maps(scenario):
    with pytest.raises(InputError, match=r"2 values of 'tx': t001_tx000.*where=tx="):
        read_recording(scenario)


def test_damaged_scenarios_are_one_line(scenario):
    powers = sorted(scenario.glob("power_*"))
    powers[0].write_bytes(b"PK" + bytes(50))
    with pytest.raises(InputError, match="no readable part of a DeepMIMO scenario"):
        read_recording(scenario)
    for path in powers:
        path.unlink()
    with pytest.raises(InputError, match="holds no powers of paths"):
        read_recording(scenario)
