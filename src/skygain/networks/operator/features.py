"""What the straight path from a transmitter to every cell passes: the inputs of the propagation
operator.

For one city and one transmitter position the kernel walks from the transmitter to the centre of
each cell and notes distance,
direction, whether the line of sight is free, and how much of the built volume stands in the way.
These are facts of geometry: no term of any propagation formula is among them. Ground outside the
map counts as open, and the share of the path that runs there is an input too, so that a transmitter
outside the map is met honestly.
"""

from __future__ import annotations

__all__ = ["CHANNELS", "PROFILE_CHANNELS", "fill_cells", "fill_features", "operator_inputs"]

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
from numpy.typing import NDArray

CHANNELS = (
    "height",
    "obstructed",
    "altitude",
    "log_distance",
    "direction_row",
    "direction_col",
    "outside",
    "line_of_sight",
    "blocked_length",
    "blocked_share",
    "buildings_crossed",
    "excess_height",
    "excess_position",
    "shadow_depth",
    "last_block",
)
"""names of the input channels, in order"""

PROFILE_CHANNELS = CHANNELS[7:]
"""those that read the heights along the path; an ablation sets them to zero"""


@numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _fill_cell(height_m, spacing_m, tx_row, tx_col, tx_z_m, r, c, altitude_m, out):  # type: ignore[no-untyped-def]
    rows, cols = height_m.shape
    dr, dc = r - tx_row, c - tx_col
    flat = math.sqrt(dr * dr + dc * dc)
    ground_m = max(flat * spacing_m, 0.5 * spacing_m)
    rise = altitude_m - tx_z_m
    steps = math.ceil(1.5 * max(abs(dr), abs(dc))) + 1
    outside = blocked = crossed = 0
    inside_building = False
    excess, excess_at, slope, last = -30.0, 0.5, -1.0, 0.0
    for i in range(1, steps):
        t = i / steps
        pr, pc = math.floor(tx_row + t * dr + 0.5), math.floor(tx_col + t * dc + 0.5)
        if pr < 0 or pc < 0 or pr >= rows or pc >= cols:
            outside += 1
            inside_building = False
            continue
        top = height_m[pr, pc]
        over = top - (tx_z_m + t * rise)
        if over > excess:
            excess, excess_at = over, t
        seen = (top - tx_z_m) / (t * ground_m)
        if seen > slope:
            slope = seen
        if over > 0:
            blocked += 1
            last = t
            if not inside_building:
                crossed += 1
            inside_building = True
        else:
            inside_building = False
    share = blocked / steps
    depth = tx_z_m + slope * ground_m - altitude_m
    out[0] = height_m[r, c] / 20.0
    out[1] = 1.0 if height_m[r, c] >= altitude_m else 0.0
    out[2] = altitude_m / 20.0 - 1.0
    out[3] = math.log10(math.sqrt(ground_m * ground_m + rise * rise)) - 2.0
    out[4] = dr / flat if flat > 0 else 0.0
    out[5] = dc / flat if flat > 0 else 0.0
    out[6] = outside / steps
    out[7] = 0.0 if blocked > 0 else 1.0
    out[8] = math.log1p(share * ground_m) / 5.0
    out[9] = share
    out[10] = math.log1p(crossed) / 2.0
    out[11] = min(max(excess / 20.0, -1.0), 3.0)
    out[12] = excess_at
    out[13] = min(max(depth / 40.0, -1.0), 4.0)
    out[14] = math.log1p((1.0 - last) * ground_m) / 5.0 if blocked > 0 else 0.0


@numba.njit(cache=True, nogil=True)
def fill_features(height_m, spacing_m, tx_row, tx_col, tx_z_m, altitude_m, out):  # type: ignore[no-untyped-def]
    """Fill ``out[channel, row, col]`` for the map ``height_m[row, col]``; channels as in
    `CHANNELS`, all of order one."""
    for r in range(height_m.shape[0]):
        for c in range(height_m.shape[1]):
            _fill_cell(height_m, spacing_m, tx_row, tx_col, tx_z_m, r, c, altitude_m, out[:, r, c])


@numba.njit(cache=True, nogil=True)
def fill_cells(height_m, spacing_m, tx, cells, altitude_m, out):  # type: ignore[no-untyped-def]
    """Fill ``out[cell, transmitter, channel]`` for ``cells[n, (row, col)]`` and ``tx[k, (row, col,
    z)]``."""
    for k in range(len(tx)):
        for i in range(len(cells)):
            _fill_cell(
                height_m,
                spacing_m,
                tx[k, 0],
                tx[k, 1],
                tx[k, 2],
                cells[i, 0],
                cells[i, 1],
                altitude_m,
                out[i, k],
            )


def operator_inputs(
    height_m: NDArray[np.float32],
    spacing_m: float,
    transmitters: NDArray[np.float64],
    altitude_m: float,
    profile: bool = True,
) -> NDArray[np.float32]:
    """``[candidate, channel, row, col]`` inputs for each of ``transmitters[candidate, (row, col,
    z)]`` (fractional cells, metres).

    Without ``profile`` the channels that read the heights along the path are zero.
    """
    out = np.empty((len(transmitters), len(CHANNELS), *height_m.shape), dtype=np.float32)
    heights = np.ascontiguousarray(height_m, dtype=np.float32)

    def fill(k: int) -> None:
        row, col, z = (float(value) for value in transmitters[k])
        fill_features(heights, float(spacing_m), row, col, z, float(altitude_m), out[k])

    # Threads of our own: Numba's parallel loops are not safe to enter from several threads, and
    # spin on a shared machine.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(fill, range(len(transmitters))))
    if not profile:
        out[:, -len(PROFILE_CHANNELS) :] = 0.0
    return out
