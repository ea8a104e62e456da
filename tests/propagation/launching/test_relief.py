"""Rays over relief: level where it is level, stopped by hills, the same ground for all terms."""

from dataclasses import replace

import numpy as np
import pytest

from skygain.city import Building, City
from skygain.grid import Grid
from skygain.propagation.diffraction import free_space_gain_db
from skygain.propagation.launching.launch import Launching, launch_gain_db
from skygain.propagation.mesh import risen
from skygain.propagation.truth import trace_truth

GRID = Grid(shape=(40, 50), spacing_m=4.0, origin_m=(2.0, 2.0))
Y, X = np.meshgrid(GRID.y_m, GRID.x_m, indexing="ij")
TRANSMITTER = (30.0, 82.0, 1.5)
QUICK = Launching(azimuths=2048)


def town(ground_m=0.0, buildings=True) -> City:
    """Two blocks of 15 and 25 m."""
    height, found = np.zeros(GRID.shape, dtype=np.float32), []
    for west, south, top in ((60.0, 40.0, 15.0), (120.0, 80.0, 25.0)):
        if buildings:
            corners = [[0, 0], [32, 0], [32, 40], [0, 40]]
            found.append(Building(np.add(corners, (west, south)), top))
            here = (abs(X - west - 16) < 16) & (abs(Y - south - 20) < 20)
            height[here] = top
    return City(GRID, height, tuple(found), ground_m=np.asarray(ground_m, dtype=np.float32))


def gains(city: City, altitudes_m=(10.0, 30.0), settings=QUICK, transmitter=TRANSMITTER):
    found = launch_gain_db(city, transmitter, altitudes_m, settings=settings).gain_db[0]
    indoors = np.stack([city.obstructed(a) for a in altitudes_m])
    return np.where(indoors, np.nan, found)


def test_level_ground_may_lie_anywhere() -> None:
    assert np.array_equal(gains(town()), gains(town(412.5)), equal_nan=True)


def test_the_slightest_relief_is_as_good_as_none_but_for_the_ground() -> None:
    """Nothing but the reflections at the ground tells them apart."""
    nearly = 1e-3 * (X > 100)
    still = replace(QUICK, max_reflections=0)
    level, rough = gains(town(), settings=still), gains(town(nearly), settings=still)
    both = np.isfinite(level) & np.isfinite(rough)
    assert (np.isinf(level) != np.isinf(rough)).sum() < 10
    assert np.percentile(np.abs(level[both] - rough[both]), 99) < 0.05
    mirrored, rough = gains(town()), gains(town(nearly))
    both = np.isfinite(mirrored) & np.isfinite(rough)
    lost = mirrored[both] - rough[both]
    assert np.percentile(lost, 1) > -0.1
    assert 0 < np.median(lost) < 3


def test_a_hill_stands_in_the_way() -> None:
    """Behind a ridge there is nothing; before it and high above it there is free space."""
    ridge = 20 * np.exp(-(((X - 100) / 12) ** 2))
    bare, alone = town(ridge, buildings=False), replace(QUICK, diffraction=False)
    low, high = gains(bare, (10.0, 150.0), alone)
    assert np.isinf(low[:, X[0] > 125]).all()
    assert np.isfinite(low[:, X[0] < 95]).all()
    assert np.isfinite(high).all()
    x, y, z = TRANSMITTER
    for gain, altitude in ((low, 10.0), (high, 150.0)):
        up = bare.ground_m - bare.ground_at(x, y) + altitude - z
        away = np.sqrt((X - x) ** 2 + (Y - y) ** 2 + up**2)
        seen = np.isfinite(gain) & (away > 30)
        assert np.percentile(np.abs(gain - free_space_gain_db(away))[seen], 99) < 0.3


def test_the_truth_over_relief_is_finite_and_each_altitude_its_own() -> None:
    slope = 0.1 * X + 3 * np.sin(Y / 15)
    city = town(slope)
    three = trace_truth(city, TRANSMITTER, [10.0, 20.0, 30.0], settings=QUICK)
    assert np.isfinite(three.gain_db).all()
    assert 0.3 < three.ray_traced[0, 0][~city.obstructed(10.0)].mean() < 1
    one = trace_truth(city, TRANSMITTER, [20.0], settings=QUICK)
    assert np.abs(one.gain_db[:, 0] - three.gain_db[:, 1]).max() < 1e-6
    again = trace_truth(city, TRANSMITTER, [20.0], settings=replace(QUICK, threads=2))
    assert np.array_equal(one.gain_db, again.gain_db)


def test_buildings_rise_from_the_ground_beneath_them() -> None:
    city = town(0.1 * X)
    tops = [b.height_m for b in risen(city)]
    assert tops == pytest.approx([15 + 7.6 - 0.2, 25 + 13.6 - 0.2], abs=0.3)
    roofs = [b.height_m for b in risen(replace(city, buildings=()))]
    assert min(roofs) >= 15 + 6 - 0.5
    assert max(roofs) <= 25 + 15.2 + 0.5
