"""Where a UAV is at every moment of its flight, and how near two of them come.

Legs are flown with one speed and one acceleration, and with a stop at every corner, which the files
ask for. Nobody knows moments to the second, and accelerations differ: two UAVs keep their
separation also when each is up to `SLIP_S` early or late, and a share of every stop more.
"""

from __future__ import annotations

__all__ = [
    "ACCELERATION_MPS2",
    "CLIMB_MPS",
    "DESCENT_MPS",
    "HOLD_S",
    "SLIP_S",
    "STOP_SLIP",
    "Timeline",
    "first_conflict",
    "leg_seconds",
    "nearest",
    "runs",
    "timeline",
]

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

CLIMB_MPS = 2.0
"""speed of take-off"""
DESCENT_MPS = 1.0
"""speed of landing"""
ACCELERATION_MPS2 = 2.0
"""along a leg"""
HOLD_S = 1.0
"""a stop at a corner lasts so long"""
SLIP_S = 2.5
"""so early or late a UAV may be at any time"""
STOP_SLIP = 0.4
"""and by so much of the time that a stop costs for each stop before: accelerations of 1.4 to 3.3
m/s² are within it"""
TICK_S = 0.25
"""positions are compared at these moments; the movement in between is added to the distance"""
_STRAIGHT = np.cos(np.radians(5.0))


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


def leg_seconds(length_m: NDArray[np.float64], speed_mps: float) -> NDArray[np.float64]:
    """Time for legs that begin and end at rest."""
    length = np.asarray(length_m, dtype=float)
    rush = speed_mps**2 / ACCELERATION_MPS2
    slow = 2 * np.sqrt(length / ACCELERATION_MPS2)
    return np.where(length >= rush, length / speed_mps + speed_mps / ACCELERATION_MPS2, slow)


def timeline(
    route_m: NDArray[np.float64],
    ground_m: float,
    speed_mps: float,
    delay_s: float = 0.0,
    *,
    airborne: bool = False,
) -> Timeline:
    """The flight along ``route_m[point, (x, y, z)]``, from the ground below its first point to that
    below its last.

    Args:
        route_m: points above the pad, along the way, and above the pad again.
        ground_m: z of the pad.
        speed_mps: along the legs.
        delay_s: moment of take-off.
        airborne: it is at the first point already.
    """
    route = np.asarray(route_m, dtype=float)
    climb_s = 0.0 if airborne else (route[0, 2] - ground_m) / CLIMB_MPS
    parts = runs(route)
    reached = np.zeros(len(route))
    at = delay_s + climb_s
    reached[0] = at
    spans: list[tuple[float, float, NDArray, NDArray]] = []
    stops_s: list[float] = []
    for first, last in parts:
        lengths = np.linalg.norm(np.diff(route[first : last + 1], axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        total_s = float(leg_seconds(along[-1:], speed_mps)[0])
        reached[first : last + 1] = at + _moments(along, along[-1], speed_mps)
        spans.append((at, total_s, along, route[first : last + 1]))
        at += total_s
        if last < len(route) - 1:
            stops_s.append(at)
            at += HOLD_S
    down_s = (route[-1, 2] - ground_m) / DESCENT_MPS
    landed = at + down_s
    moments = np.arange(0.0, landed + TICK_S, TICK_S)
    ticks = np.full((len(moments), 3), np.nan)
    up = (moments >= delay_s) & (moments < delay_s + climb_s)
    ticks[up] = route[0]
    ticks[up, 2] = ground_m + (moments[up] - delay_s) * CLIMB_MPS
    for begin, total_s, along, points in spans:
        inside = (moments >= begin) & (moments < begin + total_s)
        if inside.any():
            done = _covered(moments[inside] - begin, along[-1], speed_mps)
            ticks[inside] = np.stack(
                [np.interp(done, along, points[:, axis]) for axis in range(3)], axis=1
            )
    for moment in stops_s:
        held = (moments >= moment) & (moments < moment + HOLD_S)
        ticks[held] = [np.interp(moment, reached, route[:, axis]) for axis in range(3)]
    down = (moments >= at) & (moments < landed)
    ticks[down] = route[-1]
    ticks[down, 2] -= (moments[down] - at) * DESCENT_MPS
    per_stop = STOP_SLIP * speed_mps / ACCELERATION_MPS2
    slip = SLIP_S + per_stop * np.searchsorted(np.array(stops_s), moments, side="right")
    return Timeline(ticks, np.asarray(slip, dtype=np.float64), reached, landed)


def runs(route: NDArray[np.float64]) -> list[tuple[int, int]]:
    """First and last point of each part that is flown without a stop."""
    if len(route) < 2:
        return []
    step = np.diff(route, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(length, 1e-9)[:, None]
    stops = [k for k in range(1, len(route) - 1) if float(unit[k - 1] @ unit[k]) < _STRAIGHT]
    edges = [0, *stops, len(route) - 1]
    return list(pairwise(edges))


def _covered(t_s: NDArray[np.float64], length_m: float, speed_mps: float) -> NDArray[np.float64]:
    """Metres after ``t_s`` of a leg that begins and ends at rest."""
    total = float(leg_seconds(np.array([length_m]), speed_mps)[0])
    ramp = min(speed_mps / ACCELERATION_MPS2, total / 2)
    top = ramp * ACCELERATION_MPS2
    rising = 0.5 * ACCELERATION_MPS2 * np.minimum(t_s, ramp) ** 2
    steady = top * np.clip(t_s - ramp, 0, total - 2 * ramp)
    left = np.clip(total - t_s, 0, ramp)
    falling = 0.5 * ACCELERATION_MPS2 * (ramp**2 - left**2)
    return np.clip(rising + steady + falling, 0.0, length_m)


def _moments(along_m: NDArray[np.float64], length_m: float, speed_mps: float) -> NDArray:
    """Seconds after which each place along a leg is reached."""
    total = float(leg_seconds(np.array([length_m]), speed_mps)[0])
    fine = np.linspace(0.0, total, 257)
    covered = np.maximum.accumulate(_covered(fine, length_m, speed_mps))
    return np.interp(along_m, covered, fine)


def nearest(one: Timeline, other: Timeline, speed_mps: float) -> float:
    """A distance in metres that two flights are never nearer than, as long as each is within its
    slip; infinite if they are never near each other."""
    for reach_m in (15.0, 30.0, 60.0, 120.0, 240.0):
        _, gaps = _meetings(one, other, reach_m)
        if len(gaps):
            return float(gaps.min()) - _between_ticks(speed_mps)
    return float("inf")


def first_conflict(
    one: Timeline, other: Timeline, speed_mps: float, apart_m: float
) -> float | None:
    """The first moment of ``one`` at which the two may come nearer than ``apart_m``; ``None`` if
    never."""
    ticks, _ = _meetings(one, other, apart_m + _between_ticks(speed_mps))
    return float(ticks.min() * TICK_S) if len(ticks) else None


def _between_ticks(speed_mps: float) -> float:
    """Metres that two UAVs may be nearer than at the ticks next to a moment."""
    return max(speed_mps, CLIMB_MPS) * TICK_S


def _meetings(
    one: Timeline, other: Timeline, reach_m: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Ticks of ``one`` at which it may be within ``reach_m`` of ``other``, and how near."""
    a = np.flatnonzero(np.isfinite(one.ticks_m[:, 0]))
    b = np.flatnonzero(np.isfinite(other.ticks_m[:, 0]))
    if not len(a) or not len(b):
        return np.empty(0, dtype=np.int64), np.empty(0)
    near = cKDTree(one.ticks_m[a]).sparse_distance_matrix(
        cKDTree(other.ticks_m[b]), reach_m, output_type="coo_matrix"
    )
    first, second = a[near.row], b[near.col]
    together = np.abs(first - second) * TICK_S <= one.slip_s[first] + other.slip_s[second]
    return first[together], near.data[together]
