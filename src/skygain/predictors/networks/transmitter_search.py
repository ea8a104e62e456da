"""Where an unseen transmitter may stand: the probability of every square on and around the map, and
the candidates that stand for them.

The squares (`skygain.networks.operator.evidence.PositionGrid`) get their probability from the
locator network; before the first reading
it is the prior, that of a map cut at random out of a city that reaches further: constant over the
map, falling linearly to zero over the margin, none in buildings. Nothing is assumed about how
transmitters are placed in the city.

A gain map can be computed for a few of the squares only, the candidates. Every square is
represented by the candidate nearest to it, and a candidate's weight is the probability of all it
represents. Candidates are added one by one, each where it shortens the mean distance between a
square and its representative most.

Not all candidates have a map at once. The mapped ones are a few, evenly spread, before the first
reading; with each update more join, the likeliest first. The rest waits with the probability that
the locator gives it.
"""

from __future__ import annotations

__all__ = ["TransmitterSearch"]

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skygain.scenario import Scenario

if TYPE_CHECKING:
    from skygain.networks.operator.evidence import EvidenceSums
    from skygain.predictors.networks.operator_maps import OperatorMaps

Floats = NDArray[np.float64]

PROPOSALS = 24
"""squares among which the next candidate is sought"""
SMALLEST = 1e-30
"""probability of a square below which the judge takes it to be this"""
NEGLIGIBLE = 0.1
"""squares with less than this share of the mean probability do not matter where the next candidate
goes"""


@dataclass(frozen=True, eq=False)
class TransmitterSearch:
    """What is known about the transmitter. Growing it leaves older searches valid."""

    evidence: EvidenceSums
    """of every square"""
    probability: Floats
    """``[k]`` of every square, summing to 1"""
    located: Floats
    """``[k]`` the same as the locator sees it, before the candidates are judged"""
    chosen: NDArray[np.int64]
    """``[c]`` squares that are candidates"""
    nearest: NDArray[np.int64]
    """``[k]`` candidate that represents each square"""
    distance_m: Floats
    """``[k]`` to it"""
    mapped: NDArray[np.int64]
    """``[a]`` which of the candidates have a map, in the order in which they got it"""
    spacing_m: float
    """side of a cell"""

    @classmethod
    def begun(
        cls,
        scenario: Scenario,
        *,
        margin_m: float,
        fine_m: float,
        fine_at_most: int,
        coarse_m: float,
        at_most: int,
        first_maps: int,
        height_z_m: float,
    ) -> TransmitterSearch:
        """Before the first reading, with evenly spread candidates of which at most ``first_maps``
        are mapped."""
        from skygain.networks.operator.evidence import EvidenceSums, PositionGrid

        spacing, heights = scenario.grid.spacing_m, scenario.city.height_m
        side = max(1, round(fine_m / spacing))
        grid = PositionGrid.over(heights, spacing, margin_m, side, height_z_m)
        while len(grid.index) > fine_at_most:
            side *= 2
            grid = PositionGrid.over(heights, spacing, margin_m, side, height_z_m)
        step = max(1, round(coarse_m / (side * spacing)))
        chosen = _spread(grid.index, grid.shape, step)
        while len(chosen) > at_most:
            step += max(1, step // 2)
            chosen = _spread(grid.index, grid.shape, step)
        place = grid.position[:, :2] * spacing
        apart = _apart(place, place[chosen])
        nearest = apart.argmin(axis=1)
        distance = apart[np.arange(len(place)), nearest]
        mapped = np.arange(len(chosen))
        while len(mapped) > first_maps:
            step += 1
            mapped = _spread(grid.index[chosen], grid.shape, step)
        prior = grid.prior / grid.prior.sum()
        evidence = EvidenceSums.none(grid)
        return cls(evidence, prior, prior, chosen, nearest, distance, mapped, spacing)

    def positions(self, squares: NDArray[np.int64]) -> list[tuple[float, ...]]:
        """(row, col, z) of ``squares``."""
        return [tuple(p) for p in self.evidence.grid.position[squares].tolist()]

    def candidates(self) -> NDArray[np.int64]:
        """``[a]`` squares of the mapped candidates."""
        return self.chosen[self.mapped]

    def weights(self) -> Floats:
        """``[a]`` probability of each mapped candidate if it is one of them."""
        weight = self._mass(self.probability)[self.mapped]
        return weight / weight.sum()

    def spread_m(self) -> Floats:
        """``[a]`` root mean squared distance between each mapped candidate and what it
        represents."""
        return self._spread(self.probability)[self.mapped]

    def _mass(self, probability: Floats) -> Floats:
        return np.bincount(self.nearest, probability, minlength=len(self.chosen)).astype(float)

    def _spread(self, probability: Floats) -> Floats:
        square = self._mass(probability * self.distance_m**2)
        return np.sqrt(square / np.maximum(self._mass(probability), 1e-300))

    def standing(self) -> tuple[Floats, NDArray[np.int64], Floats]:
        """Of each mapped candidate: the locator's probability of what it represents, how many
        squares that is, and their spread in m."""
        squares = np.bincount(self.nearest, minlength=len(self.chosen))
        parts = self._mass(self.located), squares, self._spread(self.located)
        return tuple(part[self.mapped] for part in parts)  # type: ignore[return-value]

    def judged(self, weight: Floats) -> TransmitterSearch:
        """With the probability ``weight[a]`` of each mapped candidate if it is one of them, shared
        among the squares that it represents as the locator shares it; what the locator gives to the
        others stays."""
        located = np.maximum(self.located, SMALLEST)
        mass = self._mass(located)
        factor = np.full(len(mass), 1.0 / mass.sum())
        factor[self.mapped] *= weight * (mass[self.mapped].sum() / mass[self.mapped])
        return replace(self, probability=located * factor[self.nearest])

    def woken(self, share: float, at_most: int) -> TransmitterSearch:
        """With so many more of the candidates mapped, the likeliest first, that the locator gives
        the mapped ones ``share`` of the probability (1: until all are), at most ``at_most``
        more."""
        mass = self._mass(self.located)
        asleep = np.setdiff1d(np.arange(len(mass)), self.mapped)
        asleep = asleep[np.argsort(-mass[asleep], kind="stable")]
        before = mass[self.mapped].sum() + np.cumsum(mass[asleep]) - mass[asleep]
        wanted = before < share * mass.sum() if share < 1.0 else np.ones(len(asleep), dtype=bool)
        more = asleep[: min(at_most, np.count_nonzero(wanted))]
        return replace(self, mapped=np.append(self.mapped, more))

    def grown(
        self, maps: OperatorMaps, cells: NDArray[np.int64], gain_db: Floats, power: float
    ) -> TransmitterSearch:
        """After readings ``gain_db[m]`` at ``cells[m, (row, col)]``: the probability is the
        locator's, raised to ``power``."""
        evidence = maps.path_evidence(self.evidence, cells, gain_db)
        located = maps.transmitter_probability(evidence)
        weight = located**power
        return replace(self, evidence=evidence, probability=weight / weight.sum(), located=located)

    def refined(self, count: int, gain_m: float) -> TransmitterSearch:
        """With up to ``count`` more candidates, mapped ones, each shortening the mean distance by
        at least ``gain_m``."""
        place = self.evidence.grid.position[:, :2] * self.spacing_m
        chosen, nearest, distance = self.chosen, self.nearest, self.distance_m
        likely = np.flatnonzero(self.probability > NEGLIGIBLE / len(self.probability))
        probability, likely_place = self.probability[likely], place[likely]
        for _ in range(count):
            proposals = likely[
                np.argsort(-probability * distance[likely], kind="stable")[:PROPOSALS]
            ]
            gains = (
                np.maximum(distance[likely] - _apart(place[proposals], likely_place), 0.0)
                @ probability
            )
            best = int(np.argmax(gains))
            if gains[best] < gain_m:
                break
            apart = _apart(place[proposals[best]][None], place)[0]
            closer = apart < distance
            nearest = np.where(closer, len(chosen), nearest)
            distance = np.where(closer, apart, distance)
            chosen = np.append(chosen, proposals[best])
        mapped = np.append(self.mapped, np.arange(len(self.chosen), len(chosen)))
        return replace(self, chosen=chosen, nearest=nearest, distance_m=distance, mapped=mapped)


def _apart(one: Floats, other: Floats) -> Floats:
    """``[a, b]`` distance in m between points ``one[a, (row, col)]`` and ``other[b, (row, col)]``
    in m."""
    return np.sqrt(
        (one[:, None, 0] - other[None, :, 0]) ** 2 + (one[:, None, 1] - other[None, :, 1]) ** 2
    )


def _spread(index: NDArray[np.int64], shape: tuple[int, int], step: int) -> NDArray[np.int64]:
    """One of the squares ``index`` (raveled, of ``shape``) out of every ``step`` × ``step`` of
    them, that nearest to the middle."""
    row, col = np.divmod(index, shape[1])
    block = (row // step) * (shape[1] // step + 1) + col // step
    middle = (step - 1) / 2
    away = (row % step - middle) ** 2 + (col % step - middle) ** 2
    order = np.lexsort((away, block))
    _, first = np.unique(block[order], return_index=True)
    return np.sort(order[first])
