"""A world is named by one text: a packaged link, a data set in any zip, a seed."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.survey.requests import PlaceRequest
from skygain.survey.territory import parse_position
from skygain.survey.worlds import open_world


def test_a_data_set_may_have_any_name_that_ends_in_zip(tmp_path: Path) -> None:
    copy = tmp_path / "mine.zip"
    shutil.copy(str(files("skygain") / "data" / "sample.zarr.zip"), copy)
    ours, theirs = open_world(f"{copy}:2", rng=1), open_world("sample:2", rng=1)
    assert np.array_equal(ours.truth_db, theirs.truth_db, equal_nan=True)
    (tmp_path / "other.zip").write_bytes(b"PK")
    with pytest.raises(InputError, match="other"):
        open_world(str(tmp_path / "other.zip"))


def test_what_is_done_is_told() -> None:
    told: list[str] = []
    open_world(PlaceRequest(city="7", propagation="gudmundson", crop=30), told=told.append)
    assert told == ["reading the city", "computing the truth (gudmundson)"]


def test_the_instrument_looks_the_truth_up() -> None:
    world = open_world(PlaceRequest(city="sample:1", crop=40), rng=3)
    cells = np.argwhere(world.scenario().outdoor)[:5]
    exact = world.instrument().measure(cells, uav=np.arange(5), time_s=0.0)
    assert np.allclose(exact.gain_db, world.truth_db[cells[:, 0], cells[:, 1]])
    noisy = world.instrument(3.0, 1).measure(cells, uav=np.arange(5), time_s=0.0)
    assert not np.allclose(noisy.gain_db, exact.gain_db)
    assert (noisy.noise_std_db == 3.0).all()


@pytest.mark.parametrize("text", ["", "1", "1,2,3,4", "a,b", "1,inf"])
def test_positions_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="x,y"):
        parse_position(text)


def test_a_stored_truth_keeps_its_carrier() -> None:
    with pytest.raises(InputError, match="traced at 5 GHz, not at 28 GHz; leave `frequency_hz`"):
        open_world(PlaceRequest(city="sample:1", frequency_hz=28e9))
    asked = open_world(PlaceRequest(city="sample:1", frequency_hz=5e9))
    left_out = open_world("sample:1")
    assert asked.frequency_hz == left_out.scenario().frequency_hz == 5e9
    computed = PlaceRequest(city="7", propagation="gudmundson", frequency_hz=28e9, crop=20)
    assert open_world(computed).frequency_hz == 28e9


def test_a_transmitter_in_other_coordinates_is_refused_before_anything_is_computed() -> None:
    told: list[str] = []
    asked = PlaceRequest(city="7", transmitter="500000,5400000")
    with pytest.raises(InputError, match="off the map"):
        open_world(asked, told=told.append)
    assert told == ["reading the city"]


def a_truth(folder: Path, **told: object) -> Path:
    y, x = np.mgrid[0:30, 0:40]
    gain = -60 - 25 * np.log10(np.hypot(x - 20.0, y - 12.0) + 1)
    gain[3:6, 30:35] = np.nan
    np.savez(folder / "map.npz", gain_db=gain, spacing_m=4.0, **told)
    return folder / "map.npz"


def test_a_map_of_gains_is_a_world(tmp_path: Path) -> None:
    path = a_truth(tmp_path, altitude_m=20.0, frequency_hz=3.5e9)
    world = open_world(PlaceRequest(truth=path), altitude_m=10.0)
    assert (world.altitude_m, world.frequency_hz) == (20.0, 3.5e9)
    assert world.truth_db.shape == (30, 40)
    assert np.isfinite(world.truth_db).all()
    assert world.city.obstructed(20.0)[3:6, 30:35].all()
    assert world.city.grid.cells_at(world.transmitter_m[:2]).tolist() == [12, 20]
    assert world.source is not None
    assert "flight" in str(world.source)
    told = open_world(PlaceRequest(truth=path, transmitter="8,8,1.5"))
    assert told.transmitter_m == (8.0, 8.0, 1.5)
    assert told.source is not None
    assert "strongest" not in str(told.source)


def test_a_map_of_gains_over_a_city(tmp_path: Path) -> None:
    world = open_world(PlaceRequest(truth=a_truth(tmp_path), city="7", transmitter="200,200,30"))
    assert world.city.grid.shape == (121, 121)
    assert world.city.obstructed(10.0)[40:].all()  # where the map has nothing
    with pytest.raises(InputError, match="brings its own truth"):
        open_world(PlaceRequest(truth=a_truth(tmp_path), city="sample:0"))


def test_the_map_may_be_at_another_altitude_than_the_flight() -> None:
    low, high = (open_world("sample:2", altitude_m=z, rng=3) for z in (10.0, 20.0))
    world = open_world("sample:2", altitude_m=20.0, map_altitude_m=10.0, rng=3)
    np.testing.assert_array_equal(world.truth_db, low.truth_db)
    assert world.flown_db is not None
    np.testing.assert_array_equal(world.flown_db, high.truth_db)
    cell = np.argwhere(world.scenario().flyable)[:1]
    heard = world.instrument().measure(cell)
    assert heard.gain_db[0] == high.truth_db[tuple(cell[0])] != low.truth_db[tuple(cell[0])]
    assert world.scenario().map_altitude_text == "10 m above ground"
    with pytest.raises(InputError, match="has no altitude 11 m"):
        open_world("sample:2", map_altitude_m=11.0)


def test_both_altitudes_are_traced_over_any_city() -> None:
    place = PlaceRequest(city="7", propagation="over-rooftop", crop=30, transmitter="240,240,1.5")
    world = open_world(place, altitude_m=30.0, map_altitude_m=12.0)
    for altitude_m, gain in ((12.0, world.truth_db), (30.0, world.flown_db)):
        alone = open_world(place, altitude_m=altitude_m)
        np.testing.assert_array_equal(alone.truth_db, gain)
        assert alone.flown_db is None


def test_a_truth_is_at_one_altitude(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leave `map_altitude_m` out"):
        open_world(PlaceRequest(truth=a_truth(tmp_path)), map_altitude_m=25.0)
