"""What the U-Nets are fed with: the city and the readings as maps of order one."""

from __future__ import annotations

__all__ = ["DIRECT_CHANNELS", "direct_inputs", "paper_inputs"]

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from skygain.networks.scales import GAIN_CENTRE_DB, GAIN_SCALE_DB, HEIGHT_SCALE_M, PADDING_DB

Maps = NDArray[np.float32]

WIDTHS = (2.0, 6.0, 18.0)
"""standard deviations in cells of the smoothing kernels"""
DIRECT_CHANNELS = 5 + 2 * len(WIDTHS)


def paper_inputs(height_m: Maps, gain_db: Maps, measured: NDArray[np.bool_], blind: bool) -> Maps:
    """``[sample, channel, row, col]`` from heights, gains and the mask of measured cells, each
    ``[sample, row, col]``.

    The channels are the height map and the measurements padded with c_L; without the height map
    when ``blind``.
    """
    gain = (np.where(measured, gain_db, np.float32(PADDING_DB)) - GAIN_CENTRE_DB) / GAIN_SCALE_DB
    channels = [gain] if blind else [height_m / HEIGHT_SCALE_M, gain]
    return np.stack(channels, axis=1).astype(np.float32)


def direct_inputs(
    height_m: Maps, gain_db: Maps, measured: NDArray[np.bool_], altitude_m: NDArray[np.floating]
) -> Maps:
    """``[sample, channel, row, col]``; the last channel is the interpolation the network corrects.

    ``gain_db`` counts at ``measured`` cells only; both and ``height_m`` are ``[sample, row, col]``,
    ``altitude_m`` is ``[sample]``.
    """
    mask = measured.astype(np.float32)
    gain = ((gain_db - GAIN_CENTRE_DB) / GAIN_SCALE_DB).astype(np.float32) * mask
    altitude = np.asarray(altitude_m, dtype=np.float32)[:, None, None]
    channels = [
        height_m / 20.0,
        height_m >= altitude,
        np.broadcast_to(altitude / 20.0 - 1.0, mask.shape),
        mask,
        gain,
    ]
    overall = gain.sum(axis=(1, 2)) / np.maximum(mask.sum(axis=(1, 2)), 1.0)
    estimate = np.broadcast_to(overall[:, None, None], gain.shape)
    # From the widest: each finer one falls back on the coarser where it has no data.
    for width in reversed(WIDTHS):
        weight, value = _smoothed(mask, width), _smoothed(gain, width)
        estimate = (value + 0.02 * estimate) / (weight + 0.02)
        channels += [np.log(weight + 1e-3) / 5.0, estimate]
    return np.stack([channel.astype(np.float32) for channel in channels], axis=1)


def _smoothed(maps: Maps, width: float) -> Maps:
    reach = int(2.5 * width)
    line = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    rows = correlate1d(maps, line, axis=2, mode="constant")
    return correlate1d(rows, line, axis=1, mode="constant")
