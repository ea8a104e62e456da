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
