"""Generated European towns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skygain.cities.european import KINDS, EuropeanConfig, european_city
from skygain.cities.manhattan import transmitter_sites
from skygain.ground.errors import InputError


@pytest.mark.parametrize("kind", KINDS)
def test_buildings_of_a_town_do_not_overlap(kind: str) -> None:
    for seed in range(3):
        city = european_city(seed, KINDS[kind])
        boxes = np.array([[*b.footprint_m[0], *b.footprint_m[2]] for b in city.buildings])
        west, south, east, north = boxes.T
        wide = np.minimum.outer(east, east) - np.maximum.outer(west, west)
        deep = np.minimum.outer(north, north) - np.maximum.outer(south, south)
        shared = np.maximum(wide, 0) * np.maximum(deep, 0)
        np.fill_diagonal(shared, 0)
        assert shared.max() == 0
        assert boxes.min() > 0
        assert boxes.max() < 486


@pytest.mark.parametrize(("kind", "low", "high"), [("centre", 0.25, 0.6), ("suburb", 0.08, 0.3)])
def test_a_centre_is_denser_than_a_suburb(kind: str, low: float, high: float) -> None:
    built = [(european_city(seed, KINDS[kind]).height_m > 0).mean() for seed in range(4)]
    assert low < np.mean(built) < high


def test_a_seed_decides_the_town() -> None:
    a, b, other = european_city(3), european_city(3), european_city(4)
    assert np.array_equal(a.height_m, b.height_m)
    assert not np.array_equal(a.height_m, other.height_m)


def test_a_town_has_streets_and_courtyards_for_transmitters() -> None:
    assert all(
        len(transmitter_sites(european_city(s, k))) > 8 for s in range(3) for k in KINDS.values()
    )


@pytest.mark.parametrize(
    "wrong", [{"pattern": "star"}, {"block_m": (20.0, 30.0)}, {"gap_share": 2.0}]
)
def test_a_town_that_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError):
        replace(EuropeanConfig(), **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="0 or more"):
        european_city(-1)
