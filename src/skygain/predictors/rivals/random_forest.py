"""Random forest over place and map, after Alimpertis, Markopoulou, Butts and Psounis (2022).

Each reading is a row: where it was taken, what is built around it, and, where the transmitter is
known, how far away and in which direction that is. The variance is that of the forest, by the law
of total variance: of the readings within a leaf, and of the leaves among the trees.
"""

from __future__ import annotations

__all__ = ["RandomForestPredictor"]

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, uniform_filter

from skygain.ground.errors import InputError, require
from skygain.predictors.interpolators.interpolation import InterpolationBelief, ReadingsPredictor
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]

WINDOWS_M = (20.0, 60.0, 140.0)
"""sides of the squares over which heights are averaged"""


@dataclass(frozen=True)
class RandomForestPredictor(ReadingsPredictor):
    """See the module.

    Raises:
        InputError: no tree, or no reading in a leaf.
    """

    trees: int = 100
    """how many trees are grown"""
    in_leaf: int = 3
    """fewest readings in a leaf"""
    transmitter: Literal["required", "optional", "unused"] = field(
        init=False, repr=False, default="optional"
    )
    """distance and direction join the features"""

    def __post_init__(self) -> None:
        if self.trees < 1 or self.in_leaf < 1:
            raise InputError(
                "a forest needs `trees` and `in_leaf` of 1 or more, got "
                f"{self.trees} and {self.in_leaf}"
            )

    def begin(self, scenario: Scenario) -> InterpolationBelief:
        """The belief before the first measurement.

        Raises:
            MissingExtraError: scikit-learn is not installed.
        """
        require("sklearn", "rivals")
        return super().begin(scenario)

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        from sklearn.ensemble import RandomForestRegressor

        features, level = _features(scenario), readings.gain_db.mean()
        forest = RandomForestRegressor(
            self.trees, min_samples_leaf=self.in_leaf, random_state=0, n_jobs=1
        )
        # rounded, so that a constant added to every reading does not decide between equal splits
        forest.fit(features[readings.cells], np.round(readings.gain_db - level, 6))
        first, second = np.zeros((2, len(features)))
        for tree in forest.estimators_:
            leaf = tree.apply(features)
            mean, variance = tree.tree_.value[leaf, 0, 0], tree.tree_.impurity[leaf]
            first += mean / self.trees
            second += (variance + mean**2) / self.trees
        return level + first, np.maximum(second - first**2, 0.0) + readings.noise_db2.mean()


def _features(scenario: Scenario) -> Array:
    """``[cell, feature]``."""
    grid, height = scenario.grid, scenario.city.height_m.astype(float)
    xy = grid.xy_m(grid.cells)
    columns = [*xy.T, height.ravel()]
    for side_m in WINDOWS_M:
        side = max(1, round(side_m / grid.spacing_m))
        columns.append(uniform_filter(height, side, mode="nearest").ravel())
    built = height >= scenario.uav_altitude_m
    if built.any():
        columns.append(grid.spacing_m * distance_transform_edt(~built).ravel())
    if scenario.transmitter_m is not None:
        away = xy - np.array(scenario.transmitter_m[:2])
        columns += [np.log10(np.maximum(np.hypot(*away.T), 1.0)), np.arctan2(*away.T[::-1])]
    return np.column_stack(columns)
