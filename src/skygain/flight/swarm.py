"""Where the UAVs are, where they have been, and which moves are legal.

A UAV moves one cell north, east, south or west per step, never off the map, into a building or a
no-fly cell. Under the default rules two UAVs never share a cell and never swap cells in one step. A
UAV hovers only when every move is blocked, and it is out of the air once its steps are spent.
"""

from __future__ import annotations

__all__ = ["FlightRules", "Swarm"]

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.flight.moves import MOVES, Cells
from skygain.ground.errors import InputError
from skygain.scenario import Scenario


@dataclass(frozen=True)
class FlightRules:
    """What is forbidden besides obstacles."""

    separate: bool = True
    """two UAVs in the air never share a cell and never swap cells in one step"""
    min_distance_m: float = 0.0
    """horizontal distance between any two UAVs in the air at every step, on top of ``separate``"""
    return_to_start: bool = False
    """a UAV never flies so far that its remaining steps cannot bring it back to its first cell"""

    def __post_init__(self) -> None:
        if not 0 <= self.min_distance_m < np.inf:
            raise InputError(f"`min_distance_m` must be 0 m or more, got {self.min_distance_m}")


@dataclass(frozen=True, eq=False)
class Swarm:
    """N UAVs in the middle of a survey. Build one with `Swarm.deployed`."""

    flyable: NDArray[np.bool_]
    """``[row, col]`` cells a UAV may enter"""
    spacing_m: float
    """side of a cell"""
    history: Cells
    """``[uav, step, (row, col)]`` every cell held so far, the starting cell first"""
    steps_left: NDArray[np.int64]
    """``[uav]`` moves the battery still allows"""
    rules: FlightRules = FlightRules()
    """what is forbidden besides obstacles"""
    home_steps: NDArray[np.int32] | None = None
    """``[uav, row, col]`` fewest moves back to the start, kept when the UAVs must return"""

    @classmethod
    def deployed(
        cls,
        scenario: Scenario,
        cells: ArrayLike,
        steps: int | ArrayLike,
        rules: FlightRules | None = None,
    ) -> Swarm:
        """UAVs at ``cells[uav, (row, col)]`` with ``steps`` moves each (one number, or one per
        UAV).

        Raises:
            InputError: a cell is off the map, blocked or (under separation) taken twice or too
                close, or steps are negative.
        """
        rules = rules or FlightRules()
        cells = np.array(cells, dtype=np.int64).reshape(-1, 2)
        if len(cells) == 0:
            raise InputError(
                "a swarm needs at least one UAV, got none; give one start cell per UAV"
            )
        steps_left = np.broadcast_to(np.asarray(steps, dtype=np.int64), (len(cells),)).copy()
        if (steps_left < 0).any():
            raise InputError(
                f"steps must be 0 or more, got {int(steps_left.min())}; give the number of moves "
                "each UAV may make"
            )
        off = ~scenario.grid.contains(cells)
        if off.any():
            raise InputError(
                f"UAV start {tuple(cells[off][0].tolist())} is off the map of "
                f"{scenario.grid.shape} cells; start inside it"
            )
        blocked = ~scenario.flyable[cells[:, 0], cells[:, 1]]
        if blocked.any():
            raise InputError(
                f"UAV start {tuple(cells[blocked][0].tolist())} is inside a building or a no-fly "
                "zone; start on a free cell"
            )
        home = None
        if rules.return_to_start:
            from skygain.flight.ways import steps_between  # compiled, and seldom needed

            home = np.stack([steps_between(scenario.flyable, c) for c in cells])
        swarm = cls(
            scenario.flyable, scenario.grid.spacing_m, cells[:, None], steps_left, rules, home
        )
        problem = swarm._conflict(cells, cells, np.ones(len(cells), dtype=bool))
        if problem:
            raise InputError(
                f"UAV starts break the separation rule: {problem}; start the UAVs on different "
                "cells, further apart"
            )
        return swarm

    @property
    def n_uavs(self) -> int:
        """How many UAVs."""
        return len(self.history)

    @property
    def cells(self) -> Cells:
        """``[uav, (row, col)]`` where they are now."""
        return self.history[:, -1]

    @property
    def steps_flown(self) -> int:
        """Steps since deployment."""
        return self.history.shape[1] - 1

    @property
    def flying(self) -> NDArray[np.bool_]:
        """``[uav]`` whether each UAV still has steps left."""
        return self.steps_left > 0

    @cached_property
    def visited(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells that some UAV has held."""
        mask = np.zeros(self.flyable.shape, dtype=bool)
        mask[self.history[..., 0], self.history[..., 1]] = True
        return mask

    def neighbours(self, cell: ArrayLike) -> Cells:
        """``[k, (row, col)]`` flyable cells one move from ``cell``, in the order of `MOVES`."""
        near = np.asarray(cell) + MOVES
        inside = np.all((near >= 0) & (near < self.flyable.shape), axis=1)
        near = near[inside]
        return near[self.flyable[near[:, 0], near[:, 1]]]

    def next_cells(
        self,
        uav: int,
        now: ArrayLike | None = None,
        decided: dict[int, tuple[int, int]] | None = None,
        steps_left: ArrayLike | None = None,
    ) -> Cells:
        """``[k, (row, col)]`` cells that ``uav`` may move to while the others hold ``now`` and some
        have already ``decided``.

        Move the UAVs one after another, adding each choice to ``decided``. Cells that an undecided
        UAV holds are left free for
        it, so a UAV that finds no legal move can always hover where it is: an empty answer means
        hover.
        """
        now_cells = self.cells if now is None else np.asarray(now)
        left = self.steps_left if steps_left is None else np.asarray(steps_left)
        decided = decided or {}
        if left[uav] <= 0:
            return np.empty((0, 2), dtype=np.int64)
        options = self.neighbours(now_cells[uav])
        if self.home_steps is not None:
            options = options[self.home_steps[uav][options[:, 0], options[:, 1]] <= left[uav] - 1]
        if self.rules.separate or self.rules.min_distance_m > 0:
            keep = np.ones(len(options), dtype=bool)
            for other in range(self.n_uavs):
                if other == uav or (left[other] <= 0 and other not in decided):
                    continue
                held = np.asarray(decided.get(other, tuple(now_cells[other])))
                if self.rules.separate:
                    keep &= (options != held).any(axis=1)
                    if (
                        held == now_cells[uav]
                    ).all():  # the other one comes here: going there would be a swap
                        keep &= (options != now_cells[other]).any(axis=1)
                if self.rules.min_distance_m > 0:
                    keep &= (
                        np.hypot(*(options - held).T) * self.spacing_m
                        >= self.rules.min_distance_m - 1e-9
                    )
            options = options[keep]
        return options

    def advanced(self, cells: ArrayLike) -> Swarm:
        """The swarm one step later, at ``cells[uav, (row, col)]``; flying UAVs use up one step.

        Raises:
            ValueError: the step is illegal; see `check`.
        """
        step = np.stack([self.cells, np.asarray(cells, dtype=np.int64)], axis=1)
        self.check(step)
        return replace(
            self,
            history=np.concatenate([self.history, step[:, 1:]], axis=1),
            steps_left=np.maximum(self.steps_left - 1, 0),
        )

    def check(self, paths: ArrayLike) -> None:
        """Raise `ValueError` unless ``paths[uav, step, (row, col)]``, step 0 being now, is legal
        from here."""
        paths = np.asarray(paths)
        if (
            paths.ndim != 3
            or paths.shape[0] != self.n_uavs
            or paths.shape[2] != 2
            or paths.shape[1] < 1
        ):
            raise ValueError(
                f"paths must have shape [uav, step, 2] for {self.n_uavs} UAVs, got {paths.shape}"
            )
        if not (paths[:, 0] == self.cells).all():
            raise ValueError(
                "paths must begin where the UAVs stand now; step 0 is the current cell"
            )
        for step in range(1, paths.shape[1]):
            now, then = paths[:, step - 1], paths[:, step]
            left = self.steps_left - (step - 1)
            flying = left > 0
            for uav in range(self.n_uavs):
                where = f"UAV {uav} at step {step}"
                cell, moved = tuple(then[uav].tolist()), int(np.abs(then[uav] - now[uav]).sum())
                if not flying[uav]:
                    if moved:
                        raise ValueError(
                            f"{where} moves to {cell} with no steps left; end its path there"
                        )
                    continue
                if moved > 1:
                    raise ValueError(
                        f"{where} jumps from {tuple(now[uav].tolist())} to {cell}; moves are one "
                        "cell N, E, S or W"
                    )
                if not ((then[uav] >= 0) & (then[uav] < self.flyable.shape)).all():
                    raise ValueError(
                        f"{where} leaves the map: expected cells within {self.flyable.shape}, got "
                        f"{cell}"
                    )
                if not self.flyable[cell]:
                    raise ValueError(f"{where} enters {cell}, which is a building or a no-fly cell")
                if (
                    self.home_steps is not None
                    and not 0 <= self.home_steps[uav][cell] <= left[uav] - 1
                ):
                    raise ValueError(
                        f"{where} goes to {cell}, too far to return to its start with "
                        f"{int(left[uav]) - 1} steps left"
                    )
                if moved == 0 and not self._boxed_in(uav, now, then, flying, int(left[uav])):
                    raise ValueError(
                        f"{where} hovers at {cell} although a move is free; a UAV moves while it "
                        "has steps left"
                    )
            problem = self._conflict(now, then, flying)
            if problem:
                raise ValueError(f"at step {step} {problem}")

    def _boxed_in(
        self, uav: int, now: Cells, then: Cells, flying: NDArray[np.bool_], left: int
    ) -> bool:
        """Whether every move of ``uav`` is blocked by obstacles, by the way home or by another UAV
        before or after this step."""
        free = self.neighbours(now[uav])
        if self.home_steps is not None:
            free = free[self.home_steps[uav][free[:, 0], free[:, 1]] <= left - 1]
        apart = max(self.rules.min_distance_m, 1e-6 if self.rules.separate else 0.0)
        for other in np.flatnonzero(flying):
            if other == uav or apart == 0:
                continue
            for held in (now[other], then[other]):
                free = free[np.hypot(*(free - held).T) * self.spacing_m >= apart - 1e-9]
        return len(free) == 0

    def _conflict(self, now: Cells, then: Cells, flying: NDArray[np.bool_]) -> str | None:
        """How the step from ``now`` to ``then`` breaks the separation rules, or ``None``."""
        air = np.flatnonzero(flying)
        for i, first in enumerate(air):
            for second in air[i + 1 :]:
                if self.rules.separate:
                    if (then[first] == then[second]).all():
                        return f"UAVs {first} and {second} share cell {tuple(then[first].tolist())}"
                    if (then[first] == now[second]).all() and (then[second] == now[first]).all():
                        return (
                            f"UAVs {first} and {second} swap cells "
                            f"{tuple(now[first].tolist())} and {tuple(now[second].tolist())}"
                        )
                gap = float(np.hypot(*(then[first] - then[second]))) * self.spacing_m
                if gap < self.rules.min_distance_m - 1e-9:
                    return (
                        f"UAVs {first} and {second} come within {gap:.1f} m, less than "
                        f"{self.rules.min_distance_m:g} m"
                    )
        return None
