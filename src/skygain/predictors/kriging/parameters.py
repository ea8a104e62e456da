"""The numbers a Kriging predictor starts from: the trend and the covariance of the gain, with how
much each varies among surveys.

The trend is linear in known columns h(q): m(q) = h(q)ᵀθ. Three are offered.

- ``log-distance``: θ = (α, β), m(q) = α − β·log₁₀‖q − w_TX‖, the paper's path-loss line. Needs the
  transmitter.
- ``constant``: θ = (α,).
- ``quadratic``: a second-order polynomial in x and y about the middle of the map, in units of half
  its longer side.

θ differs from one transmitter to the next. Training measures by how much, and that spread is the
prior with which each survey estimates its own θ.
"""

from __future__ import annotations

__all__ = [
    "FLAT_DB2",
    "TRENDS",
    "far_columns",
    "KrigingParameters",
    "Trained",
    "generic_parameters",
    "parameter_file",
    "shipped_parameters",
    "trained_parameters",
    "trend_columns",
]

import json
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.fields.offsets import ExponentialKernel
from skygain.grid import Grid
from skygain.ground.errors import InputError

Array = NDArray[np.float64]

TRENDS = ("log-distance", "constant", "quadratic")
"""names of the trends"""
FLAT_DB2 = 1e8
"""prior variance of a level that may be anything"""
TRAINED_REACH_M = 620.0
"""distance from the transmitter up to which path-loss lines were trained"""
FAR_SLOPE_DB = 60.0
"""standard deviation of what the slope changes by beyond it, in dB per decade"""
CLOSEST_M = 1.0
"""distance to the transmitter below which the path loss no longer falls"""


@dataclass(frozen=True)
class KrigingParameters:
    """One trend and one covariance, with their spread among surveys."""

    trend: tuple[float, ...]
    """θ: (α, β) in dB and dB per decade, (α,) in dB, or the six coefficients of 1, x, y, x², xy, y²
    in dB"""
    trend_covariance: tuple[tuple[float, ...], ...]
    """prior covariance of θ; all zero when the trend is known"""
    sill_db2: float
    """φ, variance of the spatially correlated shadowing"""
    range_m: float
    """δ, its decorrelation distance (Gudmundson)"""
    nugget_db2: float = 0.0
    """ν, variance that differs from cell to cell"""
    log_spread: tuple[float, float, float] = (0.5, 0.5, 0.5)
    """standard deviation of log φ, log δ and log ν among transmitters; the per-survey fit takes its
    prior from it"""

    def __post_init__(self) -> None:
        covariance = np.asarray(self.trend_covariance, dtype=float)
        if covariance.shape != (len(self.trend), len(self.trend)):
            raise InputError(
                f"trend_covariance must be {len(self.trend)} × {len(self.trend)} for a trend of "
                f"{len(self.trend)} numbers, "
                f"got shape {covariance.shape}"
            )
        if not (self.sill_db2 > 0 and self.range_m > 0 and self.nugget_db2 >= 0):
            raise InputError(
                f"a covariance needs sill_db2 > 0, range_m > 0 and nugget_db2 >= 0, "
                f"got {self.sill_db2:g}, {self.range_m:g}, {self.nugget_db2:g}"
            )

    @property
    def with_flat_level(self) -> KrigingParameters:
        """The same with a level that may be anything: a constant added to every reading is then
        added to the map and changes nothing else."""
        covariance = np.array(self.trend_covariance)
        covariance[0, 0] += FLAT_DB2
        return replace(self, trend_covariance=tuple(map(tuple, covariance.tolist())))

    @property
    def with_far_slope(self) -> KrigingParameters:
        """The same with a slope of unknown change beyond the trained reach, for `far_columns`."""
        k = len(self.trend)
        covariance = np.zeros((k + 1, k + 1))
        covariance[:k, :k] = self.trend_covariance
        covariance[k, k] = FAR_SLOPE_DB**2
        return replace(
            self,
            trend=(*self.trend, 0.0),
            trend_covariance=tuple(map(tuple, covariance.tolist())),
        )

    @property
    def kernel(self) -> ExponentialKernel:
        """The covariance of the gain about its trend."""
        return ExponentialKernel(self.sill_db2, self.range_m, self.nugget_db2)

    @classmethod
    def known_trend(
        cls, *trend: float, sill_db2: float, range_m: float, nugget_db2: float = 0.0
    ) -> KrigingParameters:
        """Parameters whose trend is taken as exact: simple Kriging as in the paper.

        >>> KrigingParameters.known_trend(27.0, 72.0, sill_db2=380.0, range_m=57.0).trend_covariance
        ((0.0, 0.0), (0.0, 0.0))
        """
        zeros = ((0.0,) * len(trend),) * len(trend)
        return cls(trend, zeros, sill_db2, range_m, nugget_db2)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> KrigingParameters:
        """Parameters from a decoded JSON object."""
        return cls(
            tuple(values["trend"]),
            tuple(tuple(row) for row in values["trend_covariance"]),
            float(values["sill_db2"]),
            float(values["range_m"]),
            float(values["nugget_db2"]),
            tuple(values["log_spread"]),  # type: ignore[arg-type]
        )


def _between(low: KrigingParameters, high: KrigingParameters, share: float) -> KrigingParameters:
    """Parameters a ``share`` of the way from ``low`` to ``high``: scales in the logarithm, the rest
    linearly."""

    def line(a: Any, b: Any) -> Array:
        return (1 - share) * np.asarray(a) + share * np.asarray(b)

    phi, delta, nu = np.exp(
        line(
            np.log([low.sill_db2, low.range_m, low.nugget_db2]),
            np.log([high.sill_db2, high.range_m, high.nugget_db2]),
        )
    ).tolist()
    covariance = tuple(
        tuple(row) for row in line(low.trend_covariance, high.trend_covariance).tolist()
    )
    spread = tuple(line(low.log_spread, high.log_spread).tolist())
    return KrigingParameters(
        tuple(line(low.trend, high.trend).tolist()), covariance, phi, delta, nu, spread
    )  # type: ignore[arg-type]


Trained = dict[str, dict[float, KrigingParameters]]
"""parameters by trend and altitude in metres"""


def parameter_file(path: str | Path) -> Trained:
    """The parameters that ``skygain train kriging`` wrote to ``path``.

    Raises:
        InputError: there is no such file, or it holds something else.
    """
    try:
        trends = json.loads(Path(path).read_text(encoding="utf-8"))["trends"]
        found = {
            trend: {float(z): KrigingParameters.from_dict(v) for z, v in trends[trend].items()}
            for trend in TRENDS
        }
        if not all(found.values()):
            raise ValueError("a trend has no altitude")
        return found
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"cannot read Kriging's parameters from {path} ({error}); give a file written by "
            "`skygain train kriging`"
        ) from error


@cache
def shipped_parameters() -> Trained:
    """The parameters that ship with Skygain, trained on ray-traced Manhattan cities at 10, 20 and
    30 m."""
    with as_file(files("skygain").joinpath("data/kriging.json")) as path:
        return parameter_file(path)


def trained_parameters(
    trend: str, altitude_m: float, trained: Trained | None = None
) -> KrigingParameters:
    """The parameters for ``trend`` at ``altitude_m``, of ``trained`` or of those that ship.

    Between the altitudes of the training they are interpolated, below and above them the nearest
    ones hold.

    Raises:
        InputError: no such trend.
    """
    if trend not in TRENDS:
        raise InputError(f"unknown trend {trend!r}; known: {', '.join(TRENDS)}")
    table = (shipped_parameters() if trained is None else trained)[trend]
    altitudes = sorted(table)
    altitude = min(max(altitude_m, altitudes[0]), altitudes[-1])
    if altitude in table:
        return table[altitude]
    upper = next(i for i, a in enumerate(altitudes) if a > altitude)
    low, high = altitudes[upper - 1], altitudes[upper]
    return _between(table[low], table[high], (altitude - low) / (high - low))


def generic_parameters(trend: str) -> KrigingParameters:
    """Parameters for a place and a quantity of which nothing is known: textbook values, wide apart,
    and any level.

    Shadowing of about 8 dB with a decorrelation distance of some tens of metres (Gudmundson 1991;
    3GPP TR 38.901), a level that may be anything, as for a received power in dBm, and no path-loss
    line, which such data rarely bear out.
    """
    variance = {
        "log-distance": (1e4, 0.0),
        "constant": (1e4,),
        "quadratic": (1e4, 1e2, 1e2, 1e2, 1e2, 1e2),
    }[trend]
    level = (-100.0,) + (0.0,) * (len(variance) - 1)
    covariance = tuple(tuple(row) for row in np.diag(variance).tolist())
    return KrigingParameters(
        level, covariance, sill_db2=64.0, range_m=40.0, nugget_db2=2.0, log_spread=(2.8, 2.0, 4.0)
    )


def trend_columns(
    trend: str,
    grid: Grid,
    altitude_m: float,
    transmitter_m: tuple[float, float, float] | None = None,
) -> Array:
    """``[cell, k]`` the columns h(q) of ``trend`` at every cell of ``grid``, in raveled order.

    Raises:
        InputError: no such trend, or a log-distance trend without a transmitter.
    """
    if trend == "constant":
        return np.ones((grid.size, 1))
    xy = grid.xy_m(grid.cells)
    if trend == "log-distance":
        if transmitter_m is None:
            raise InputError(
                "Kriging with a log-distance trend needs the transmitter's position and the "
                "scenario has none; "
                "give it, or choose the predictor kriging-inferred or kriging-blind"
            )
        distance = np.linalg.norm(
            np.column_stack([xy, np.full(grid.size, altitude_m)]) - np.asarray(transmitter_m),
            axis=1,
        )
        return np.column_stack([np.ones(grid.size), -np.log10(np.maximum(distance, CLOSEST_M))])
    if trend == "quadratic":
        middle = grid.xy_m((np.asarray(grid.shape) - 1) / 2)
        x, y = (2 * (xy - middle) / (max(grid.shape) * grid.spacing_m)).T
        return np.column_stack([np.ones(grid.size), x, y, x * x, x * y, y * y])
    raise InputError(f"unknown trend {trend!r}; known: {', '.join(TRENDS)}")


def far_columns(columns: Array) -> Array:
    """``[cell, 3]`` log-distance ``columns[cell, 2]`` and a third one for what the slope changes by
    beyond the trained reach; 0 within it."""
    return np.column_stack([columns, np.minimum(columns[:, 1] + np.log10(TRAINED_REACH_M), 0.0)])
