"""What the operator's errors at the readings say about a candidate position of the transmitter.

The operator's map for a candidate misses every reading by something; a normal likelihood of these
errors is hopeless as evidence, for they have heavy tails, come street by street, and there are
hundreds of them. The judge learned what they are worth. For every candidate it sees means over the
readings of robust functions of the standardised error z = (y − m)/s, of the same whitened by the
residual's correlation, and of the error in dB, all relative to the best candidate, beside the
probability that the locator gives to what the candidate represents, and answers with one number;
the softmax over the candidates is their probability. The means are sums that grow with each
reading, so an update costs next to nothing.
"""

from __future__ import annotations

__all__ = ["INPUTS", "TERMS", "CandidateJudge", "error_terms", "judge_inputs"]

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.networks.weights import read_weights

Array = NDArray[np.float32]

CAUCHY = (0.5, 1.0, 3.0)
"""a of log(1 + z²/a²)"""
WELSH = (0.5, 1.5, 4.0)
"""a of z²/(z² + a²), the share of readings missed by more than about a"""
DECIBELS = (3.0, 10.0, 30.0)
"""b of log(1 + error²/b²), dB"""
STRONG_DB = -100.0
"""readings above and below count separately, softly over `STRONG_WIDTH_DB`"""
STRONG_WIDTH_DB = 8.0
TERMS = (
    *(
        f"{kind}{name}"
        for kind in ("z ", "whitened ")
        for name in (*map(str, CAUCHY), *(f"over {a}" for a in WELSH), "absolute")
    ),
    *(f"{b} dB" for b in DECIBELS),
    "log std",
    "z",
    "sure weight",
    "sure",
    "strong weight",
    "strong",
    "strong whitened",
    "weak weight",
    "weak",
)
"""names of the sums, in order"""
FEWEST, MOST = 3, 800
"""readings beyond which the judge takes their number as this"""
QUALITIES = 23
INPUTS = 2 * QUALITIES + 5
"""numbers that the judge sees of each candidate"""


def error_terms(z: Array, whitened: Array, std_db: Array, gain_db: NDArray[np.floating]) -> Array:
    """``[term, candidate]`` sums over readings of what the judge looks at; they add up over sets of
    readings.

    ``z[n, candidate]`` standardised errors, ``whitened[n, candidate]`` the same made independent,
    ``std_db[n, candidate]`` the operator's standard deviation, ``gain_db[n]`` the readings as at
    the operator's carrier.
    """
    out = np.empty((len(TERMS), z.shape[1]), dtype=np.float32)
    k = 0
    for x in (z, whitened):
        square = x * x
        for a in CAUCHY:
            out[k] = np.log1p(square / (a * a)).sum(axis=0)
            k += 1
        for a in WELSH:
            out[k] = (square / (square + a * a)).sum(axis=0)
            k += 1
        out[k] = np.abs(x).sum(axis=0)
        k += 1
    error = (z * std_db) ** 2
    for b in DECIBELS:
        out[k] = np.log1p(error / (b * b)).sum(axis=0)
        k += 1
    cauchy, sure = np.log1p(z * z), 1.0 / std_db
    strong = (
        0.01 + 1.0 / (1.0 + np.exp(-(np.asarray(gain_db) - STRONG_DB) / STRONG_WIDTH_DB))
    ).astype(np.float32)
    weak = np.float32(1.02) - strong
    out[k:] = (
        np.log(std_db).sum(axis=0),
        z.sum(axis=0),
        sure.sum(axis=0),
        (sure * cauchy).sum(axis=0),
        np.full(z.shape[1], strong.sum()),
        strong @ cauchy,
        strong @ np.log1p(whitened * whitened),
        np.full(z.shape[1], weak.sum()),
        weak @ cauchy,
    )
    return out


def judge_inputs(
    sums: Array,
    n: int,
    mass: NDArray[np.floating],
    squares: NDArray[np.integer],
    spread_m: NDArray[np.floating],
) -> Array:
    """``[candidate, input]`` from the sums of `error_terms` over ``n`` readings.

    ``mass[candidate]`` is the locator's probability of what each represents, ``squares`` how many
    squares that is and ``spread_m`` their root mean squared distance.
    """
    mean = sums / max(n, 1)
    plain = 2 * (len(CAUCHY) + len(WELSH) + 1) + len(DECIBELS)
    log_std, bias, sure_weight, sure, strong_weight, strong, strong_whitened, weak_weight, weak = (
        mean[plain:]
    )
    quality = -np.concatenate(
        [
            mean[:plain],
            np.stack(
                [
                    log_std,
                    np.abs(bias),
                    sure / np.maximum(sure_weight, 1e-6),
                    strong / np.maximum(strong_weight, 1e-6),
                    strong_whitened / np.maximum(strong_weight, 1e-6),
                    weak / np.maximum(weak_weight, 1e-6),
                ]
            ),
        ]
    )
    quality = (quality - quality.max(axis=1, keepdims=True)).T
    many = math.log(min(max(n, FEWEST), MOST) / 100.0)
    located, prior = np.log(mass + 1e-6), np.log(squares + 1e-3)
    rest = np.stack([located, located * many, prior, spread_m, np.full(len(mass), many)], axis=1)
    return np.concatenate([quality, 0.5 * many * quality, rest], axis=1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class CandidateJudge:
    """A perceptron of two hidden layers beside a linear map, in plain NumPy."""

    centre: Array
    """``[input]`` subtracted first"""
    scale: Array
    """``[input]`` divided by then"""
    linear: Array
    """``[input]`` of the linear map"""
    layers: tuple[tuple[Array, Array], ...]
    """(matrix ``[in, out]``, offset ``[out]``) of each layer"""

    def probability(self, inputs: Array, power: float = 1.0) -> NDArray[np.float64]:
        """``[candidate]`` from `judge_inputs`, raised to ``power`` and normalised."""
        x = (inputs - self.centre) / self.scale
        score = x @ self.linear
        for matrix, offset in self.layers[:-1]:
            x = x @ matrix + offset
            x = x / (1.0 + np.exp(-x))
        matrix, offset = self.layers[-1]
        score = power * (score + (x @ matrix + offset)[:, 0]).astype(float)
        weight = np.exp(score - score.max())
        return weight / weight.sum()

    @classmethod
    def load(cls, path: Path) -> CandidateJudge:
        """Read a weight file.

        Raises:
            InputError: the file is not a judge's, or that of a judge with other inputs.
        """
        found = read_weights(path).arrays
        if "centre" not in found or found["centre"].shape != (INPUTS,):
            raise InputError(
                f"{path} holds no weights of a judge of this version; make them with: skygain "
                "train predictor --recipe judge"
            )
        count = sum(key.endswith(".matrix") for key in found)
        layers = tuple((found[f"{i}.matrix"], found[f"{i}.offset"]) for i in range(count))
        return cls(found["centre"], found["scale"], found["linear"], layers)
