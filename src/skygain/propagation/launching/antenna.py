"""Antennas of the transmitter: isotropic, a 3GPP sector, or a measured table.

A pattern is a table of amplitudes over azimuth and elevation, 0 dB for isotropic.
"""

from __future__ import annotations

__all__ = ["Antenna", "amplitude", "sector_gain_dbi"]

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.propagation.launching.compiled import inner

_AZIMUTHS, _ELEVATIONS = 361, 181


@dataclass(frozen=True)
class Antenna:
    """The transmitter's antenna; the default is isotropic and vertically polarised."""

    polarisation: str = "vertical"
    """``"vertical"`` or ``"horizontal"``"""
    gain_dbi: NDArray[np.float64] | None = field(default=None, repr=False)
    """``[azimuth, elevation]`` gain over isotropic at whole degrees: azimuth 0 to 359 from east
    to north relative to `azimuth_deg`, elevation -90 to 90; ``None`` for isotropic"""
    azimuth_deg: float = 0.0
    """direction of the pattern's azimuth 0, from east to north"""

    def __post_init__(self) -> None:
        if self.polarisation not in ("vertical", "horizontal"):
            raise InputError(
                "an antenna's polarisation must be 'vertical' or 'horizontal', "
                f"got {self.polarisation!r}"
            )
        if self.gain_dbi is not None:
            gain = np.asarray(self.gain_dbi)
            if gain.shape != (_AZIMUTHS - 1, _ELEVATIONS) or not np.isfinite(gain).all():
                raise InputError(
                    "an antenna's gain_dbi must be finite numbers [360 azimuths, 181 elevations], "
                    f"got the shape {gain.shape}; resample the table to whole degrees"
                )
        if not np.isfinite(self.azimuth_deg):
            raise InputError(f"azimuth_deg must be a number, got {self.azimuth_deg}")

    @property
    def field(self) -> NDArray[np.complex128]:
        """(E_v, E_h) of a ray where the pattern is 0 dB."""
        vertical = self.polarisation == "vertical"
        return np.array([1.0, 0.0] if vertical else [0.0, 1.0], dtype=np.complex128)

    @property
    def pattern(self) -> NDArray[np.float64]:
        """``[azimuth, elevation]`` amplitudes at whole degrees, turned; empty if isotropic."""
        if self.gain_dbi is None:
            return np.zeros((0, 0))
        degrees = (np.arange(_AZIMUTHS) - self.azimuth_deg) % 360
        low = np.floor(degrees).astype(int) % 360
        share = (degrees - np.floor(degrees))[:, None]
        amplitudes = 10 ** (np.asarray(self.gain_dbi, dtype=float) / 20)
        return (1 - share) * amplitudes[low] + share * amplitudes[(low + 1) % 360]


def sector_gain_dbi(
    *,
    tilt_deg: float = 0.0,
    azimuth_width_deg: float = 65.0,
    elevation_width_deg: float = 65.0,
    peak_dbi: float = 8.0,
    floor_db: float = 30.0,
) -> NDArray[np.float64]:
    """A sector after 3GPP TR 38.901, table 7.3-1, tilted downwards, for `Antenna.gain_dbi`.

    Args:
        tilt_deg: how far the beam points below the horizon.
        azimuth_width_deg: width at half power in azimuth.
        elevation_width_deg: width at half power in elevation.
        peak_dbi: gain of the beam.
        floor_db: most that the pattern falls below the beam.
    """
    if not (azimuth_width_deg > 0 and elevation_width_deg > 0 and floor_db >= 0):
        raise InputError(
            "a sector's widths must be positive and its floor_db 0 or more, got "
            f"{azimuth_width_deg}, {elevation_width_deg}, {floor_db}"
        )
    azimuth = (np.arange(360)[:, None] + 180) % 360 - 180
    elevation = np.arange(-90, 91)[None, :]
    across = np.minimum(12 * (azimuth / azimuth_width_deg) ** 2, floor_db)
    up = np.minimum(12 * ((elevation + tilt_deg) / elevation_width_deg) ** 2, floor_db)
    return peak_dbi - np.minimum(across + up, floor_db)


@inner
def amplitude(pattern: NDArray[np.float64], azimuth: float, sine: float) -> float:
    """Amplitude of a pattern in a direction: azimuth in radians, sine of the elevation."""
    degrees = math.degrees(azimuth) % 360.0
    up = math.degrees(math.asin(min(max(sine, -1.0), 1.0))) + 90.0
    i, j = min(int(degrees), 359), min(int(up), 179)
    a, b = degrees - i, up - j
    return (
        pattern[i, j] * (1 - a) * (1 - b)
        + pattern[i + 1, j] * a * (1 - b)
        + pattern[i, j + 1] * (1 - a) * b
        + pattern[i + 1, j + 1] * a * b
    )
