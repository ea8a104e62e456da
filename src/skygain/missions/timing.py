"""Where a UAV is at every moment of its flight, and how near two of them come.

Legs are flown with one speed and one acceleration. A corner is flown through as autopilots do,
rounded within `ROUNDING_M` and as slowly as the turn asks for, or with a stop where there is no
room to round it. Nobody knows moments to the second, and accelerations differ: two UAVs keep their
separation also when each is up to `SLIP_S` early or late, and a share of every corner more.
"""

from __future__ import annotations

__all__ = [
    "ACCELERATION_MPS2",
    "CLIMB_MPS",
    "CORNER_MPS2",
    "DESCENT_MPS",
    "HOLD_S",
    "ROUNDING_M",
    "SHARPEST_DEGREES",
    "SLIP_S",
    "TICK_S",
    "Timeline",
    "clear_delays",
    "corner_seconds",
    "first_conflict",
    "nearest",
    "sharp_corners",
    "timeline",
    "way_seconds",
]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

CLIMB_MPS = 2.0
"""speed of take-off"""
DESCENT_MPS = 1.0
"""speed of landing"""
ACCELERATION_MPS2 = 2.0
"""along a leg"""
CORNER_MPS2 = 1.5
"""towards the inside of a turn; half of what PX4 allows along a leg, as PX4 halves its own"""
ROUNDING_M = 2.0
"""a corner is left so far before it and met again so far behind it; the acceptance radius of PX4's
multicopters and of ArduPilot"""
SHARPEST_DEGREES = 120.0
"""a turn by more than that is made at a stop"""
HOLD_S = 1.0
"""a stop at a corner lasts so long"""
SLIP_S = 2.5
"""so early or late a UAV may be at any time"""
_ACCELERATIONS = (1.4, 3.3)
"""vehicles from the slowest to the quickest that the slip covers"""
_OFF_CORNER_M = 1.2
"""a rounded corner passes nearer than this to the corner itself"""
TICK_S = 0.25


@dataclass(frozen=True, eq=False)
class Timeline:
    """A flight by time."""

    ticks_m: NDArray[np.float64]
    """``[tick, (x, y, z)]`` every `TICK_S` from moment 0; NaN while on the ground"""
    slip_s: NDArray[np.float64]
    """``[tick]`` so early or late it may be there"""
    reached_s: NDArray[np.float64]
    """``[point]`` moment at which each point of the route is reached"""
    landed_s: float
    """moment of landing"""

    @property
    def air_s(self) -> float:
        """Seconds in the air."""
        return float(np.isfinite(self.ticks_m[:, 0]).sum() * TICK_S)


def sharp_corners(
    route_m: NDArray[np.float64], turn_degrees: float = SHARPEST_DEGREES
) -> NDArray[np.bool_]:
    """``[point]`` corners that turn by more than an angle; never the first or the last."""
    sharp = np.zeros(len(route_m), dtype=bool)
    if len(route_m) > 2:
        unit, _ = _directions(route_m)
        turn = (unit[:-1] * unit[1:]).sum(axis=1)
        sharp[1:-1] = turn < np.cos(np.radians(turn_degrees))
    return sharp


def corner_seconds(turn: NDArray[np.float64], speed_mps: float) -> NDArray[np.float64]:
    """Seconds that a turn with the cosine ``turn`` costs in the midst of long legs."""
    turn = np.asarray(turn, dtype=float)
    through = _turn_speed(turn, np.full(turn.shape, ROUNDING_M), CORNER_MPS2)
    stop = turn < np.cos(np.radians(SHARPEST_DEGREES))
    slow = np.where(stop, 0.0, np.minimum(through, speed_mps))
    return (speed_mps - slow) ** 2 / (speed_mps * ACCELERATION_MPS2) + HOLD_S * stop


def way_seconds(
    route_m: NDArray[np.float64], speed_mps: float, stop: NDArray[np.bool_] | None = None
) -> float:
    """Time along ``route_m[point, (x, y, z)]`` from rest to rest, without climb and landing.

    Args:
        route_m: points of the way.
        speed_mps: along the legs.
        stop: ``[point]`` whether it stops there; at sharp corners when left out.
    """
    route = np.asarray(route_m, dtype=float)
    if len(route) < 2:
        return 0.0
    stop = sharp_corners(route) if stop is None else stop
    length, at = _speeds(route, speed_mps, stop)
    top = _top(length, at, speed_mps)
    return float(_leg_times(length, at, top).sum() + HOLD_S * stop[1:-1].sum())


def timeline(
    route_m: NDArray[np.float64],
    ground_m: float,
    speed_mps: float,
    delay_s: float = 0.0,
    *,
    stop: NDArray[np.bool_] | None = None,
    airborne: bool = False,
    first_mps: float = 0.0,
) -> Timeline:
    """The flight along ``route_m[point, (x, y, z)]``, from the ground below its first point to that
    below its last.

    Args:
        route_m: points above the pad, along the way, and above the pad again.
        ground_m: z of the pad.
        speed_mps: along the legs.
        delay_s: moment of take-off.
        stop: ``[point]`` whether it stops there; at sharp corners when left out.
        airborne: it is at the first point already.
        first_mps: its speed there.
    """
    route = np.asarray(route_m, dtype=float)
    stop = sharp_corners(route) if stop is None else stop
    climb_s = 0.0 if airborne else (route[0, 2] - ground_m) / CLIMB_MPS
    length, speed = _speeds(route, speed_mps, stop, first_mps)
    top = _top(length, speed, speed_mps)
    took = _leg_times(length, speed, top)
    held = np.where(stop[1:], HOLD_S, 0.0)
    held[-1:] = 0.0
    begins = delay_s + climb_s + np.concatenate([[0.0], np.cumsum(took + held)])
    reached = np.concatenate([begins[:1], begins[:-1] + took])
    down_s = (route[-1, 2] - ground_m) / DESCENT_MPS
    over = float(begins[-1])
    landed = over + down_s
    moments = np.arange(0.0, landed + TICK_S, TICK_S)
    ticks = np.full((len(moments), 3), np.nan)
    up = (moments >= delay_s) & (moments < delay_s + climb_s)
    ticks[up] = route[0]
    ticks[up, 2] = ground_m + (moments[up] - delay_s) * CLIMB_MPS
    way = (moments >= begins[0]) & (moments < over)
    if way.any():
        leg = np.clip(np.searchsorted(begins, moments[way], side="right") - 1, 0, len(length) - 1)
        done = _covered(moments[way] - begins[leg], length[leg], speed[leg], speed[leg + 1],
                        top[leg], took[leg])  # fmt: skip
        share = done / np.maximum(length[leg], 1e-9)
        ticks[way] = route[leg] + share[:, None] * (route[leg + 1] - route[leg])
    down = (moments >= over) & (moments < landed)
    ticks[down] = route[-1]
    ticks[down, 2] -= (moments[down] - over) * DESCENT_MPS
    slips = np.concatenate([[0.0], np.cumsum(_corner_slips(route, speed_mps, stop))])
    passed = np.searchsorted(reached, moments, side="right")
    slip = SLIP_S + slips[np.minimum(passed, len(route))]
    return Timeline(ticks, np.asarray(slip, dtype=np.float64), reached, landed)


def _directions(route: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors and lengths of the legs."""
    step = np.diff(route, axis=0)
    length = np.linalg.norm(step, axis=1)
    return step / np.maximum(length, 1e-9)[:, None], length


def _turn_speed(
    turn: NDArray[np.float64], room_m: NDArray[np.float64], inward_mps2: float
) -> NDArray[np.float64]:
    """Speed on the circle that touches both legs ``room_m`` from their corner, where ``turn`` is
    the cosine of the angle between their directions."""
    half = np.arccos(np.clip(turn, -1.0, 1.0)) / 2
    return np.sqrt(inward_mps2 * room_m / np.maximum(np.tan(half), 1e-6))


def _corner_speeds(
    route: NDArray[np.float64], speed_mps: float, stop: NDArray[np.bool_], inward_mps2: float
) -> NDArray[np.float64]:
    """``[point]`` most that each corner allows; 0 at both ends."""
    speed = np.zeros(len(route))
    if len(route) > 2:
        unit, length = _directions(route)
        room = np.minimum(ROUNDING_M, np.minimum(length[:-1], length[1:]) / 2)
        turn = (unit[:-1] * unit[1:]).sum(axis=1)
        speed[1:-1] = np.minimum(speed_mps, _turn_speed(turn, room, inward_mps2))
        speed[stop] = 0.0
    return speed


def _speeds(
    route: NDArray[np.float64],
    speed_mps: float,
    stop: NDArray[np.bool_],
    first_mps: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``[leg]`` lengths and ``[point]`` speeds that corners and acceleration allow."""
    speed = _corner_speeds(route, speed_mps, stop, CORNER_MPS2)
    speed[0] = first_mps
    length = np.linalg.norm(np.diff(route, axis=0), axis=1)
    gain = 2 * ACCELERATION_MPS2 * length
    for k in range(len(length)):
        speed[k + 1] = min(speed[k + 1], np.sqrt(speed[k] ** 2 + gain[k]))
    for k in range(len(length) - 1, -1, -1):
        speed[k] = min(speed[k], np.sqrt(speed[k + 1] ** 2 + gain[k]))
    return length, speed


def _top(
    length: NDArray[np.float64], speed: NDArray[np.float64], speed_mps: float
) -> NDArray[np.float64]:
    """``[leg]`` highest speed on each leg."""
    peak = np.sqrt(ACCELERATION_MPS2 * length + (speed[:-1] ** 2 + speed[1:] ** 2) / 2)
    return np.minimum(speed_mps, peak)


def _leg_times(
    length: NDArray[np.float64], speed: NDArray[np.float64], top: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``[leg]`` seconds."""
    ramps = (2 * top - speed[:-1] - speed[1:]) / ACCELERATION_MPS2
    ramped = (2 * top**2 - speed[:-1] ** 2 - speed[1:] ** 2) / (2 * ACCELERATION_MPS2)
    return ramps + np.maximum(length - ramped, 0.0) / np.maximum(top, 1e-9)


def _covered(
    t_s: NDArray[np.float64],
    length: NDArray[np.float64],
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    top: NDArray[np.float64],
    took: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Metres of a leg after ``t_s``, from speed ``first`` over ``top`` to ``last``."""
    rise, fall = (top - first) / ACCELERATION_MPS2, (top - last) / ACCELERATION_MPS2
    up = np.minimum(t_s, rise)
    steady = np.clip(t_s - rise, 0.0, np.maximum(took - rise - fall, 0.0))
    down = np.clip(t_s - (took - fall), 0.0, fall)
    metres = (
        first * up
        + ACCELERATION_MPS2 * up**2 / 2
        + top * steady
        + top * down
        - ACCELERATION_MPS2 * down**2 / 2
    )
    return np.clip(metres, 0.0, length)


def _corner_slips(
    route: NDArray[np.float64], speed_mps: float, stop: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """``[point]`` so much more or less time than planned other accelerations make of a corner."""

    def lost(acceleration: float) -> NDArray[np.float64]:
        inward = acceleration * CORNER_MPS2 / ACCELERATION_MPS2
        slow = speed_mps - _corner_speeds(route, speed_mps, stop, inward)
        seconds = slow**2 / (speed_mps * acceleration)
        seconds[[0, -1]] = 0.0
        return seconds

    planned = lost(ACCELERATION_MPS2)
    return np.max([np.abs(lost(a) - planned) for a in _ACCELERATIONS], axis=0)


def nearest(one: Timeline, other: Timeline, speed_mps: float) -> float:
    """A distance in metres that two flights are never nearer than, as long as each is within its
    slip; infinite if they are never near each other."""
    for reach_m in (15.0, 30.0, 60.0, 120.0, 240.0):
        _, gaps = _meetings(one, other, reach_m)
        if len(gaps):
            return float(gaps.min()) - _beside_ticks(speed_mps)
    return float("inf")


def first_conflict(
    one: Timeline, other: Timeline, speed_mps: float, apart_m: float
) -> float | None:
    """The first moment of ``one`` at which the two may come nearer than ``apart_m``; ``None`` if
    never."""
    ticks, _ = _meetings(one, other, apart_m + _beside_ticks(speed_mps))
    return float(ticks.min() * TICK_S) if len(ticks) else None


def clear_delays(
    one: Timeline,
    other: Timeline,
    speed_mps: float,
    apart_m: float,
    delays_s: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """``[delay]`` whether the two keep ``apart_m`` if ``one`` is so much later."""
    first, second, _ = _near(one, other, apart_m + _beside_ticks(speed_mps))
    gap = (first - second) * TICK_S
    slip = one.slip_s[first] + other.slip_s[second]
    return np.array([not (np.abs(gap + delay) <= slip).any() for delay in delays_s], dtype=bool)


def _beside_ticks(speed_mps: float) -> float:
    """Metres that two UAVs may be nearer than at the ticks next to a moment, corners rounded."""
    return max(speed_mps, CLIMB_MPS) * TICK_S + 2 * _OFF_CORNER_M


def _meetings(
    one: Timeline, other: Timeline, reach_m: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Ticks of ``one`` at which it may be within ``reach_m`` of ``other``, and how near."""
    first, second, gap = _near(one, other, reach_m)
    together = np.abs(first - second) * TICK_S <= one.slip_s[first] + other.slip_s[second]
    return first[together], gap[together]


def _near(
    one: Timeline, other: Timeline, reach_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Ticks of the two whose places lie within ``reach_m`` of each other, and how near."""
    a = np.flatnonzero(np.isfinite(one.ticks_m[:, 0]))
    b = np.flatnonzero(np.isfinite(other.ticks_m[:, 0]))
    if not len(a) or not len(b):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)
    near = cKDTree(one.ticks_m[a]).sparse_distance_matrix(
        cKDTree(other.ticks_m[b]), reach_m, output_type="coo_matrix"
    )
    return a[near.row], b[near.col], near.data
