"""The surveys of a comparison: reproducible, independent of each other, and possible."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.datasets import ChannelDataset, open_sample, survey_cases
from skygain.flight.ways import steps_between
from skygain.ground.errors import InputError


@pytest.fixture(scope="module")
def dataset() -> ChannelDataset:
    return open_sample()


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n_uavs=st.integers(1, 6),
    start=st.sampled_from(["cluster", "spread"]),
)
def test_starts_are_distinct_and_connected_to_most_of_the_crop(
    seed: int, n_uavs: int, start: str
) -> None:
    for case in survey_cases(open_sample(), "T4", n_uavs=n_uavs, start=start, seed=seed):
        scenario = case.scenario()
        assert len(set(case.starts)) == n_uavs
        reach = steps_between(scenario.flyable, case.start_cells[0]) >= 0
        assert all(reach[cell] for cell in case.starts)
        assert reach.sum() >= 0.25 * reach.size


def test_the_same_call_gives_the_same_cases(dataset: ChannelDataset) -> None:
    assert survey_cases(dataset, "T4", seed=5) == survey_cases(dataset, "T4", seed=5)
    assert survey_cases(dataset, "T4", seed=5) != survey_cases(dataset, "T4", seed=6)


def test_there_is_one_case_per_link_city_by_city(dataset: ChannelDataset) -> None:
    cases = survey_cases(dataset, "T1")
    assert [c.link for c in cases] == dataset.links("T1")


def test_a_shorter_list_is_the_beginning_of_a_longer_one(shared_data) -> None:
    large = ChannelDataset.open(shared_data / "manhattan-v0.zarr.zip")
    short, longer, every = (survey_cases(large, "T2", max_surveys=n) for n in (7, 40, None))
    assert longer[:7] == short
    assert set(longer) <= set(every)
    assert len({c.city_index for c in longer[:25]}) == 25  # one of each city before a second of any
    assert [c.city_index for c in every] == sorted(c.city_index for c in every)


def test_crops_do_not_depend_on_the_swarm(dataset: ChannelDataset) -> None:
    few, many = (
        survey_cases(dataset, "T4", n_uavs=2),
        survey_cases(dataset, "T4", n_uavs=5, start="spread"),
    )
    assert [(c.link, c.row, c.col, c.seed) for c in few] == [
        (c.link, c.row, c.col, c.seed) for c in many
    ]


def test_cases_have_streams_of_their_own(dataset: ChannelDataset) -> None:
    cases = survey_cases(dataset, "T1") + survey_cases(dataset, "T4")
    assert len({c.seed for c in cases}) == len(cases)
    assert cases[0].rng(0).random() == cases[0].rng(0).random() != cases[0].rng(1).random()


def test_a_case_survives_pickling_and_stays_small(dataset: ChannelDataset) -> None:
    case = survey_cases(dataset, "T4")[0]
    data = pickle.dumps(case)
    assert len(data) < 1000
    copy = pickle.loads(data)
    assert copy == case
    np.testing.assert_array_equal(copy.truth_db, case.truth_db)


def test_the_crop_is_a_window_of_the_link(dataset: ChannelDataset) -> None:
    case = survey_cases(dataset, "T4")[0]
    link = dataset.link(case.link)
    window = (slice(case.row, case.row + 96), slice(case.col, case.col + 96))
    np.testing.assert_array_equal(case.truth_db, link.truth_db[window])
    np.testing.assert_array_equal(case.ray_traced, link.ray_traced[window])
    assert case.scenario().transmitter_m == case.crop.transmitter_m
    assert case.scenario(transmitter_known=False).transmitter_m is None


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ({"altitude_m": 15.0}, "altitude"),
        ({"start": "nowhere"}, "known"),
        ({"max_surveys": 0}, "1 or more"),
        ({"crop_shape": (500, 96)}, "smaller crop"),
        ({"crop_shape": (4, 4), "n_uavs": 17}, "fewer UAVs"),
    ],
)
def test_impossible_surveys_are_refused(dataset: ChannelDataset, options: dict, hint: str) -> None:
    with pytest.raises(InputError, match=hint):
        survey_cases(dataset, "T4", **options)


def test_an_unknown_split_is_refused(dataset: ChannelDataset) -> None:
    with pytest.raises(InputError, match="it has T1, T2, T3, T4"):
        survey_cases(dataset, "T9")
