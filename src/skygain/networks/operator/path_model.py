"""A gain model of one path: what the straight line to a cell passes → mean and standard deviation
of the gain there.

It looks at a single path where the propagation operator looks at the whole city, and is a thousand
times cheaper for a handful of cells. That is what a search over thousands of transmitter positions
needs after every reading; the operator then judges the few positions this model finds likely. A
perceptron of two hidden layers on the channels of `path_features`, in plain NumPy once trained.
"""

from __future__ import annotations

__all__ = ["PathModel"]

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.networks.operator.features import CHANNELS, fill_cells
from skygain.networks.scales import FREE_SPACE_5GHZ_DB
from skygain.networks.weights import read_weights

LOG_DISTANCE = CHANNELS.index("log_distance")
USED = tuple(i for i, name in enumerate(CHANNELS) if not name.startswith("direction"))
"""channels the model sees; the compass direction of one path means nothing"""
HIDDEN = 48
TOGETHER = 1024
"""paths looked at together: what comes between the layers stays in the processor's cache"""


@dataclass(frozen=True, eq=False)
class PathModel:
    """Weights of the perceptron."""

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    """(matrix ``[in, out]``, offset ``[out]``) of each layer"""

    def gain(
        self,
        height_m: NDArray[np.float32],
        spacing_m: float,
        tx: NDArray[np.float64],
        cells: NDArray[np.int64],
        altitude_m: float,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(mean in dB, standard deviation), each ``[cell, transmitter]``, for ``tx[k, (row, col,
        z)]`` and ``cells[n, (row, col)]``."""
        features = np.empty((len(cells), len(tx), len(CHANNELS)), dtype=np.float32)
        fill_cells(
            height_m,
            float(spacing_m),
            tx,
            np.ascontiguousarray(cells, dtype=np.int64),
            float(altitude_m),
            features,
        )
        return self.of_features(features)

    def of_features(
        self, features: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(mean in dB, standard deviation) from ``features[..., channel]``."""
        flat = features.reshape(-1, features.shape[-1])
        out = np.empty((len(flat), 2), dtype=np.float32)
        for first in range(0, len(flat), TOGETHER):
            x = flat[first : first + TOGETHER, USED]
            for matrix, offset in self.layers[:-1]:
                x = x @ matrix
                x += offset
                np.maximum(x, 0.0, out=x)
            matrix, offset = self.layers[-1]
            out[first : first + TOGETHER] = x @ matrix + offset
        out = out.reshape(*features.shape[:-1], 2)
        mean = FREE_SPACE_5GHZ_DB - 20.0 * (features[..., LOG_DISTANCE] + 2.0) + 20.0 * out[..., 0]
        return mean, np.exp(np.clip(math.log(10.0) + out[..., 1], math.log(1.0), math.log(40.0)))

    @classmethod
    def load(cls, path: Path) -> PathModel:
        """Read a weight file."""
        arrays = read_weights(path).arrays
        return cls(
            tuple(
                (np.ascontiguousarray(arrays[f"{i}.weight"].T), arrays[f"{i}.bias"])
                for i in range(len(arrays) // 2)
            )
        )
