"""Straight legs, closed tours and what they teach, checked by other means than their own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely

from skygain.fields.planning import planning_field
from skygain.measurements import Measurements
from skygain.missions.clearance import straightened
from skygain.missions.imagined import ahead_of
from skygain.missions.lessons import Lessons
from skygain.missions.planning import plan_sortie
from skygain.missions.rehearsal import rehearse
from skygain.missions.site import open_site
from skygain.missions.sortie import Flight, Sortie, corners
from skygain.missions.streets import Streets
from skygain.missions.timing import ROUNDING_M, way_seconds
from skygain.missions.tours import Start, find_tours, plan_tours
from skygain.survey.methods import planner, predictor
from tests.missions.test_planning import AREA, SOLID, ZONE
from tests.missions.town import mission_request


@pytest.fixture(scope="module")
def streets(site) -> Streets:
    return Streets.of(site.space)


def clear(shape) -> bool:
    """Six metres from everything, as drawn; degrees cost a millimetre."""
    near = min(shape.distance(one) for one in (*SOLID, ZONE, AREA.exterior))
    return near >= 6.0 and AREA.contains(shape)


def random_walk(site, rng: np.random.Generator, steps: int) -> np.ndarray:
    """Metres along neighbouring flyable cells that prefers to go on."""
    flyable = site.scenario.flyable
    cells = np.argwhere(flyable)
    at, move, walk = cells[rng.integers(len(cells))], np.array([0, 1]), []
    for _ in range(steps):
        walk.append(at)
        options = [move, *rng.permutation([(0, 1), (1, 0), (0, -1), (-1, 0)])]
        if rng.random() < 0.4:
            options = options[1:]
        for move in options:
            there = at + move
            if site.grid.contains(there) and flyable[tuple(there)]:
                at = there
                break
    return site.grid.xy_m(np.array(walk))


@pytest.mark.parametrize("seed", range(5))
def test_stairs_become_clear_legs_near_them(site, seed: int) -> None:
    walk = corners(random_walk(site, np.random.default_rng(seed), 120))
    tolerance = 0.75 * site.grid.spacing_m
    line = straightened(site.space, walk, tolerance)
    assert (line[[0, -1]] == walk[[0, -1]]).all()
    assert len(line) <= len(walk)
    straight, stairs = shapely.LineString(line), shapely.LineString(walk)
    assert clear(straight)
    assert straight.length <= stairs.length + 1e-9
    assert straight.hausdorff_distance(stairs) <= tolerance * 1.001


@pytest.mark.parametrize("seed", range(3))
def test_cells_under_a_way_touch_it_and_each_other(site, seed: int) -> None:
    walk = corners(random_walk(site, np.random.default_rng(seed), 80))
    line = straightened(site.space, walk, 3.0)
    cells = site.space.cells_along(line)
    assert cells is not None
    assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()
    assert site.scenario.flyable[cells[:, 0], cells[:, 1]].all()
    half = site.grid.spacing_m / 2
    way = shapely.LineString(line)
    for x, y in site.grid.xy_m(cells):
        # a cell passed at its corner may be a tenth of a cell aside
        assert way.distance(shapely.box(x - half, y - half, x + half, y + half)) <= 0.2 * half


def test_all_places_are_joined_by_clear_legs(site, streets: Streets) -> None:
    assert np.isfinite(streets.length_m).all()
    for one, other in np.argwhere(np.triu(streets.seen))[::7]:
        assert clear(shapely.LineString(streets.xy_m[[one, other]]))
    rng = np.random.default_rng(0)
    for one, other in rng.integers(len(streets.places), size=(30, 2)):
        way = streets.way(one, other)
        assert (way[0], way[-1]) == (one, other)
        assert all(streets.seen[pair] for pair in pairwise(way))


def test_lessons_are_what_gaussian_conditioning_says(site, streets: Streets) -> None:
    """The fall of the weighted variance, by plain linear algebra over sites and targets."""
    belief = predictor("kriging-blind").begin(site.scenario)
    lessons = Lessons.about(ahead_of(belief), streets.sites, 1.0, weighted=False)
    rng = np.random.default_rng(1)
    first, second = rng.permutation(len(streets.sites))[:24].reshape(2, 12)
    lessons.begin(first)
    told = lessons.gain(second)
    n = len(streets.sites)
    among, cross = lessons.among[:, :n].astype(float), lessons.among[:, n:].astype(float)

    def explained(sites: np.ndarray) -> float:
        gram = among[np.ix_(sites, sites)] + np.eye(len(sites))
        return float((cross[sites] * np.linalg.solve(gram, cross[sites])).sum())

    assert told == pytest.approx(explained(np.r_[first, second]) - explained(first), rel=1e-3)
    field = planning_field(belief)
    assert among[3, 3] == pytest.approx(field.level_db2, rel=1e-3)


def test_tours_are_closed_and_in_time(site, streets: Streets) -> None:
    belief = ahead_of(predictor("kriging-blind").begin(site.scenario))
    lessons = Lessons.about(belief, streets.sites, 1.0)
    tours = find_tours(streets, lessons, [0, 1], [0, 1], [60.0, 90.0], 5.0)
    for tour, place, most in zip(tours, (0, 1), (60.0, 90.0), strict=True):
        assert (tour.stops[0], tour.stops[-1]) == (place, place)
        assert 0.5 * most < tour.seconds <= most
        out, home = tour.legs_m(streets)
        assert (out[-1] == home[0]).all()
        assert clear(shapely.LineString(np.vstack([out, home[1:]])))


def test_uavs_have_their_own_parts(sortie: Sortie) -> None:
    """Away from their homes few cells are read by two of them."""
    read = [{tuple(cell) for cell in f.read_cells.tolist()} for f in sortie.flights]
    every = [cell for one in read for cell in one]
    assert len(set(every)) >= 0.8 * len(every)


def test_tours_that_took_too_long_are_cut_together(site, streets: Streets, monkeypatch) -> None:
    """Tours found with more time than there is come home in time, and still part the area."""
    belief = ahead_of(predictor("kriging-blind").begin(site.scenario))
    starts = [Start(uav, site.pads[uav].xy_m[None], 60.0) for uav in range(3)]
    found = find_tours

    def generous(joined, lessons, begins, homes, seconds, *rest):
        return found(joined, lessons, begins, homes, [1.4 * s for s in seconds], *rest)

    monkeypatch.setattr("skygain.missions.tours.find_tours", generous)
    flights = [each[0] for each in plan_tours(site, belief, starts, 1.0, weighted=True)]
    assert all(way_seconds(f.route_m, f.speed_mps, f.stops) <= 60.0 for f in flights)
    read = [{tuple(cell) for cell in f.read_cells.tolist()} for f in flights]
    every = [cell for one in read for cell in one]
    assert len(set(every)) >= 0.7 * len(every)


def test_rounded_corners_have_room(sortie: Sortie) -> None:
    """The triangle that a rounded corner stays in is as clear as the legs."""
    rounded = 0
    for flight in sortie.flights:
        points = flight.route_m[:, :2]
        for k in range(1, len(points) - 1):
            if flight.stops[k]:
                continue
            before, after = points[k - 1] - points[k], points[k + 1] - points[k]
            room = min(ROUNDING_M, np.hypot(*before) / 2, np.hypot(*after) / 2)
            ends = [points[k] + room * leg / np.hypot(*leg) for leg in (before, after)]
            assert clear(shapely.MultiPoint([ends[0], points[k], ends[1]]).convex_hull)
            rounded += 1
    assert rounded > 5


def test_flights_of_older_journals_stop_at_every_corner(sortie: Sortie) -> None:
    data = sortie.flights[0].as_data()
    del data["stops"], data["homeward"]
    old = Flight.of(data)
    assert old.stops[1:-1].sum() > sortie.flights[0].stops[1:-1].sum()
    assert old.air_s > sortie.flights[0].air_s


def test_a_rehearsed_sortie_keeps_the_rules(town) -> None:
    """What is flown is clear, ends at home in time, and nobody comes near another."""
    site = open_site(mission_request(town, battery_min=2.5))
    belief = predictor("kriging-blind").begin(site.scenario)
    chooser = planner("sequential-greedy")
    sortie = plan_sortie(site, belief, chooser, np.random.default_rng(0))
    asked = []

    def read(cells: np.ndarray) -> Measurements:
        asked.extend(map(tuple, cells.tolist()))
        return Measurements.at(cells, -100.0 - 0.5 * cells.sum(axis=1))

    live = rehearse(site, belief, sortie, read, chooser, every_s=25.0)
    assert asked
    assert len(asked) == len(set(asked))
    ticks = [flight.timeline.ticks_m for flight in live.flights]
    for flight in live.flights:
        assert flight.air_s <= 2.5 * 60 * 0.8
        assert flight.route_m[-1, :2] == pytest.approx(flight.pad_m[:2])
        assert clear(shapely.LineString(flight.route_m[:, :2]))
    for i, one in enumerate(ticks):
        for other in ticks[:i]:
            n = min(len(one), len(other))
            gap = np.linalg.norm(one[:n] - other[:n], axis=1)
            assert np.nanmin(gap, initial=np.inf) >= 12.0
