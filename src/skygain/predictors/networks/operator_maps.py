"""Maps of the propagation operator for many transmitter positions over one city, computed once
each."""

from __future__ import annotations

__all__ = ["OperatorMaps", "OperatorNetwork", "frequency_shift_db"]

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.networks.operator.evidence import EvidenceSums, evidence_channels
from skygain.networks.operator.features import operator_inputs
from skygain.networks.operator.judge import CandidateJudge
from skygain.networks.operator.path_model import PathModel
from skygain.networks.runtime import Network, load
from skygain.networks.weights import weight_file
from skygain.scenario import Scenario

CHUNK = 32
"""positions evaluated together"""
OFFSET_DB = 110.0
"""gains are kept as float16 about this value: steps of 0.06 dB at most where they lie"""
TRAINED_HZ = 5.0e9
"""carrier the operator was trained at; another one shifts the gain by the difference in free
space"""


class OperatorNetwork:
    """The trained networks as plain functions of arrays."""

    def __init__(
        self,
        weights: str | Path = "operator",
        paths: str | Path = "path-model",
        locator: str | Path = "locator",
        judge: str | Path = "judge",
        runtime: str = "onnx",
    ) -> None:
        self.judge = CandidateJudge.load(weight_file(judge)) if str(judge) else None
        self.paths = PathModel.load(weight_file(paths))
        self._locator_weights, self._runtime = locator, runtime
        self.network = load("operator", weights, runtime)
        self.profile = bool(self.network.weights.task.get("profile", True))

    def maps(
        self, scenario: Scenario, altitude_m: float, positions: NDArray[np.float64]
    ) -> tuple[NDArray, NDArray]:
        """(mean in dB, standard deviation), each ``[position, row * col]`` float32, for
        ``positions[k, (row, col, z)]``."""
        heights, spacing = scenario.city.height_m, scenario.grid.spacing_m
        means, stds = np.empty((2, len(positions), heights.size), dtype=np.float32)
        for first in range(0, len(positions), CHUNK):
            part = slice(first, first + CHUNK)
            inputs = operator_inputs(heights, spacing, positions[part], altitude_m, self.profile)
            mean, log_variance = self.network(inputs)
            means[part] = mean.reshape(len(mean), -1)
            stds[part] = np.exp(0.5 * log_variance).reshape(len(mean), -1)
        return means + np.float32(frequency_shift_db(scenario)), stds

    @cached_property
    def _locator(self) -> Network:
        return load("locator", self._locator_weights, self._runtime)

    def located(self, channels: NDArray[np.float32]) -> NDArray[np.float64]:
        """``[row, col]`` probability of every square from the maps of `evidence_channels`."""
        (logits,) = self._locator(channels[None])
        weight = np.exp(logits[0].astype(float) - logits.max())
        return weight / weight.sum()


def frequency_shift_db(scenario: Scenario) -> float:
    """Free-space gain at the scenario's carrier minus that at the trained one."""
    return -20.0 * float(np.log10(scenario.frequency_hz / TRAINED_HZ))


@dataclass(eq=False)
class OperatorMaps:
    """Cache of one scenario's maps. It only grows, so that an index once handed out stays valid."""

    network: OperatorNetwork
    """what computes a map"""
    scenario: Scenario
    """city, altitudes and frequency"""
    height_z_m: float = 1.5
    """height of the candidates above the street"""
    index: dict[tuple[float, ...], int] = field(default_factory=dict)
    """position → index"""
    _buffers: dict[float, tuple[NDArray[np.float16], NDArray[np.float16]]] = field(
        default_factory=dict
    )

    def indices(self, positions: list[tuple[float, ...]]) -> NDArray[np.int64]:
        """Index of the map of each position ((row, col) or (row, col, z)), computing those not
        known yet."""
        full = [(*p, self.height_z_m) if len(p) == 2 else p for p in positions]
        new = [p for p in dict.fromkeys(full) if p not in self.index]
        if new:
            for altitude_m in {self.scenario.prediction_altitude_m, self.scenario.uav_altitude_m}:
                self._append(
                    altitude_m,
                    *self.network.maps(self.scenario, altitude_m, np.array(new, dtype=float)),
                )
            self.index.update({p: len(self.index) + k for k, p in enumerate(new)})
        return np.array([self.index[p] for p in full], dtype=np.int64)

    def _append(self, altitude_m: float, mean: NDArray, std: NDArray) -> None:
        used, count = len(self.index), len(mean)
        nothing = np.empty((0, mean.shape[1]), dtype=np.float16)
        means, stds = self._buffers.get(altitude_m, (nothing, nothing))
        if used + count > len(means):
            room = np.empty((max(count, used), mean.shape[1]), dtype=np.float16)
            means, stds = np.concatenate([means[:used], room]), np.concatenate([stds[:used], room])
            self._buffers[altitude_m] = means, stds
        means[used : used + count] = mean + OFFSET_DB
        stds[used : used + count] = std

    def path_evidence(
        self, evidence: EvidenceSums, cells: NDArray[np.int64], gain_db: NDArray[np.float64]
    ) -> EvidenceSums:
        """``evidence`` after readings ``gain_db[n]`` at ``cells[n, (row, col)]``, flight
        altitude."""
        s = self.scenario
        gain = gain_db - frequency_shift_db(s)
        return evidence.grown(
            self.network.paths, s.city.height_m, s.grid.spacing_m, s.uav_altitude_m, cells, gain
        )

    def transmitter_probability(self, evidence: EvidenceSums) -> NDArray[np.float64]:
        """``[k]`` probability of every square of the evidence, as the locator sees it."""
        s = self.scenario
        found = self.network.located(
            evidence_channels(evidence, s.city.height_m, s.grid.spacing_m, s.uav_altitude_m)
        )
        weight = found.ravel()[evidence.grid.index].astype(float)
        return weight / weight.sum()

    def whole(
        self, indices: NDArray[np.int64], altitude_m: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(mean, standard deviation) maps, each ``[k, row * col]``."""
        mean, std = self._buffers[altitude_m]
        return mean[indices].astype(np.float32) - np.float32(OFFSET_DB), std[indices].astype(
            np.float32
        )

    def at(
        self, indices: NDArray[np.int64], cells: NDArray[np.int64], altitude_m: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(mean, standard deviation) at raveled ``cells``, each ``[cell, k]``."""
        mean, std = self._buffers[altitude_m]
        pick = np.ix_(indices, cells)
        return mean[pick].T.astype(np.float32) - np.float32(OFFSET_DB), std[pick].T.astype(
            np.float32
        )
