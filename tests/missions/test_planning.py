"""A sortie keeps its rules in continuous space and time, as other means than its own tell."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

from skygain.ground.errors import InputError
from skygain.missions.planning import Leftover, check_battery, plan_sortie
from skygain.missions.site import open_site
from skygain.missions.sortie import Sortie, corners, flight_along
from skygain.missions.timing import Timeline, nearest, timeline, way_seconds
from skygain.survey.methods import planner, predictor
from tests.missions.town import (
    BLOCKS,
    SOUTH_M,
    WEST_M,
    degrees,
    home,
    mission_request,
    write_polygons,
)


def shifted(west, south, east, north):
    return shapely.box(WEST_M + west, SOUTH_M + south, WEST_M + east, SOUTH_M + north)


SOLID = [shifted(*block[:4]) for block in BLOCKS]
ZONE, AREA = shifted(0, 80, 30, 100), shifted(0, 0, 160, 160)


def test_every_leg_is_clear_of_buildings_zones_and_the_edge(sortie: Sortie) -> None:
    """Measured from the outlines as drawn; degrees cost a millimetre."""
    for flight in sortie.flights:
        line = shapely.LineString(flight.route_m[:, :2])
        assert min(line.distance(one) for one in (*SOLID, ZONE)) >= 6.0
        assert line.distance(AREA.exterior) >= 6.0
        assert AREA.contains(line)


def test_every_flight_ends_where_it_began_within_its_battery(sortie: Sortie) -> None:
    for flight in sortie.flights:
        assert flight.route_m[0, :2] == pytest.approx(flight.pad_m[:2])
        assert flight.route_m[-1, :2] == pytest.approx(flight.pad_m[:2])
        assert flight.air_s <= 4 * 60 * 0.8
        legs = np.linalg.norm(np.diff(flight.route_m, axis=0), axis=1)
        assert flight.air_s >= legs.sum() / 5.0 + 30 / 2 + 30 / 1
    # and at least one is used
    assert max(flight.air_s for flight in sortie.flights) > 0.9 * 4 * 60 * 0.8


def position(line: Timeline, t: float) -> np.ndarray:
    k = t / 0.25
    low = int(k)
    if low + 1 >= len(line.ticks_m):
        return np.full(3, np.nan)
    return line.ticks_m[low] + (k - low) * (line.ticks_m[low + 1] - line.ticks_m[low])


def test_uavs_keep_apart_at_random_moments_and_slips(sortie: Sortie) -> None:
    """Each as early or late as accelerations from 1.4 to 3.3 m/s² make it, and 2.5 s more."""
    rng = np.random.default_rng(3)
    lines = [flight.timeline for flight in sortie.flights]
    for _ in range(3000):
        moment = rng.uniform(0, sortie.duration_s)
        at = []
        for line in lines:
            slip = line.slip_s[min(int(moment * 4), len(line.slip_s) - 1)] * 0.95
            at.append(position(line, max(0.0, moment + rng.uniform(-slip, slip))))
        for i, one in enumerate(at):
            for other in at[:i]:
                gap = np.linalg.norm(one - other)
                assert np.isnan(gap) or gap >= 12.0


def test_flights_that_cross_are_told_and_those_far_apart_are_not() -> None:
    east = np.array([[0.0, 0, 30], [100, 0, 30]])
    north = np.array([[50.0, -50, 30], [50, 50, 30]])
    one, other = timeline(east, 0.0, 5.0), timeline(north, 0.0, 5.0)
    assert nearest(one, other, 5.0) <= 0.0
    later = timeline(north, 0.0, 5.0, delay_s=300.0)
    assert nearest(one, later, 5.0) == np.inf


def test_a_leg_takes_what_physics_says() -> None:
    """Two seconds for a metre at 1 m/s² up and down; a long one is flown at its speed."""
    for length_m, seconds in ((2.0, 2.0), (100.0, 100 / 5 + 5 / 2)):
        assert way_seconds(np.array([[0.0, 0, 20], [length_m, 0, 20]]), 5.0) == pytest.approx(
            seconds
        )
    line = timeline(np.array([[0.0, 0, 20], [100, 0, 20]]), 0.0, 5.0, delay_s=7.0)
    assert line.landed_s == pytest.approx(7 + 20 / 2 + 22.5 + 20)
    speed = np.linalg.norm(np.diff(line.ticks_m, axis=0), axis=1) / 0.25
    assert np.nanmax(speed) <= 5.0 + 1e-6


def test_a_corner_is_passed_as_slowly_as_its_turn_asks() -> None:
    """A right angle within 2 m at 1.5 m/s²: √3 m/s, whatever the legs; never faster than asked."""
    route = np.array([[0.0, 0, 20], [100, 0, 20], [100, 80, 20]])
    line = timeline(route, 0.0, 5.0)
    speed = np.linalg.norm(np.diff(line.ticks_m, axis=0), axis=1) / 0.25
    assert np.nanmax(speed) <= 5.0 + 1e-6
    at = int(line.reached_s[1] / 0.25)
    assert np.sqrt(3.0) - 0.3 <= speed[at - 1 : at + 2].min() <= np.sqrt(3.0) + 0.5
    # from rest to √3 and from √3 to rest, reckoned by hand: distance is the area under the speed
    through = np.sqrt(3.0)
    lost = 2 * (5 - through) ** 2 / (2 * 2.0 * 5) + 2 * 5**2 / (2 * 2.0 * 5)
    assert way_seconds(route, 5.0) == pytest.approx(180 / 5 + lost)
    stop = np.array([False, True, False])
    assert way_seconds(route, 5.0, stop) == pytest.approx(180 / 5 + 2 * 2.5 + 1.0)
    assert line.landed_s == pytest.approx(10 + way_seconds(route, 5.0) + 20)


def test_slips_cover_quick_and_slow_vehicles() -> None:
    """A zigzag flown with 1.4 and 3.3 m/s² along legs and in proportion in turns."""
    zigzag = np.array([[20.0 * k, 15.0 * (k % 2), 20.0] for k in range(9)])
    line = timeline(zigzag, 0.0, 5.0)
    end = line.reached_s[-2]
    slip = line.slip_s[int(end / 0.25)]
    turn = np.arccos((20**2 - 15**2) / 25**2)
    for a in (1.4, 3.3):
        through = min(5.0, np.sqrt(0.75 * a * 2.0 / np.tan(turn / 2)))
        corner = (5 - through) ** 2 / (5 * a)
        took = 8 * 25 / 5 - 25 / 5 + 5 / (2 * a) + 6 * corner + (5 - through) ** 2 / (2 * 5 * a)
        assert abs(took - (end - 10)) <= slip


def test_straight_runs_are_merged_and_corners_kept() -> None:
    points = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [2, 1], [2, 1]], dtype=float)
    assert corners(points).tolist() == [[0, 0], [2, 0], [2, 2], [2, 1]]


def test_a_uav_left_out_does_not_fly(site) -> None:
    belief = predictor("kriging-blind").begin(site.scenario)
    chooser = planner("random-waypoint")
    rng = np.random.default_rng(0)
    sortie = plan_sortie(site, belief, chooser, rng, uavs=[0, 2])
    assert [flight.uav for flight in sortie.flights] == [0, 2]
    assert Sortie.of(sortie.as_data()).as_data() == sortie.as_data()


def test_what_was_left_over_is_flown_first(site, sortie: Sortie) -> None:
    belief = predictor("kriging-blind").begin(site.scenario)
    flight = sortie.flights[0]
    part = Leftover.of(flight, len(flight.cells) - 30, len(flight.cells), site.grid)
    run = part.cells
    rng = np.random.default_rng(0)
    chooser = planner("sequential-greedy:horizon=16")
    again = plan_sortie(site, belief, chooser, rng, leftover=[part])
    flown = {tuple(cell) for cell in again.cells.tolist()}
    distinct = {tuple(cell) for cell in run.tolist()}
    again_legs = sum(len(f.route_m) for f in again.flights)
    assert again_legs <= 1.5 * sum(len(f.route_m) for f in sortie.flights)  # no stairs
    assert len(flown & distinct) >= 0.9 * len(distinct)
    assert again.refly_cells >= 0.9 * len(run)


def test_a_leg_over_a_slope_follows_it(site) -> None:
    """Sampled anywhere, the height above a tilted ground stays within a metre."""
    rows, cols = site.grid.shape
    y, x = np.mgrid[:rows, :cols]
    ground = (3.0 * np.sin(x / 4.0) + 0.2 * y).astype(np.float32)
    hilly = replace(site, city=replace(site.city, ground_m=ground))
    cells = np.argwhere(site.scenario.flyable)
    row = np.bincount(cells[:, 0]).argmax()
    path = np.array([cell for cell in cells if cell[0] == row])
    flight = flight_along(hilly, 0, path, site.ways_home[0])
    line = flight.route_m
    for a, b in pairwise(line):
        for share in np.linspace(0, 1, 7):
            x_m, y_m, z = a + share * (b - a)
            assert abs(z - hilly.city.ground_at(x_m, y_m) - 30.0) <= 1.6  # a metre, and cells


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"home": home(15, 90)}, "inside a no-fly zone"),
        ({"home": home(300, 90)}, "outside the area"),
        ({"home": home(55, 55)}, "in a building 60 m high"),
        ({"home": home(73, 55)}, "3.0 m from a building"),
        ({"home": home(2, 60)}, "2.0 m from the area's edge"),
        ({"home": None}, "`home`"),
        ({"home": ",".join(reversed(home(90, 85).split(",")))}, "comes first: give `home="),
        ({"home": "49,9;49,9"}, "off the map|not on this map"),
        ({"home": f"{home(90, 85)};{home(91, 85)}"}, "2 homes for 3 UAVs"),
        ({"home": f"{home(90, 85)};{home(91, 85)}", "uavs": 2}, "1.0 m apart"),
        ({"clearance_m": 90.0}, "no cell of the area can be flown"),
        ({"uavs": 400}, "there is room for"),
        ({"altitude_m": -3}, "`altitude_m` must be 1 to 500"),
        ({"city": "7"}, "no place on Earth"),
    ],
)
def test_what_cannot_be_flown_is_one_line(town, changes: dict, message: str) -> None:
    if changes.get("city") == "7":
        changes = {**changes, "area": None, "no_fly": None}
    with pytest.raises(InputError, match=message) as caught:
        open_site(mission_request(town, **changes))
    assert "\n" not in str(caught.value)


def test_a_self_crossing_area_is_refused(town, tmp_path) -> None:
    bow = [list(degrees(*p)) for p in ((0, 0), (100, 100), (100, 0), (0, 100), (0, 0))]
    path = write_polygons(tmp_path / "bow.geojson", [bow])
    with pytest.raises(InputError, match="crosses itself"):
        open_site(mission_request(town, area=path))


def test_a_battery_too_small_to_come_back(town) -> None:
    site = open_site(mission_request(town, battery_min=1.0, reserve_percent=30))
    with pytest.raises(InputError, match="too small to come back"):
        check_battery(site, [0])
