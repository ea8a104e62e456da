"""What the cells of a path teach, given those before them.

Let b_v be the whitened covariance of a new cell v with the target cells x, given the cells of the
path so far. Appending v to a path of k cells costs k products, because only the new row of the
growing Cholesky factor is computed. With d_v the variance of v given the path, and σ² the noise
variance of a reading, the gain of v is

- variance:            Σ_x b_v(x)², the fall of the (weighted) posterior variance summed over the
  targets;
- entropy:             ½ log(1 + d_v/σ²);
- mutual information:  ½ log((d_v + σ²)/(d_v|X + σ²)), d_v|X the variance given all targets as well.
"""

from __future__ import annotations

__all__ = ["Reach", "Rows", "copied", "gain_of", "gains_alone", "path_value", "rows_for"]

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skygain.ground.kernels import uncounted
from skygain.planners.search.objectives import Objective


class Reach(NamedTuple):
    """Covariances of the cells that one UAV can measure, given everything already measured or
    planned; single precision."""

    number: NDArray[np.int32]
    """``[row, col]`` position of a cell among the m measurable cells, −1 for a cell that is passed
    without counting it"""
    among: NDArray[np.float32]
    """``[m, m]`` covariance of the measurable cells"""
    targets: NDArray[np.float32]
    """``[m, x]`` covariance of measurable and target cells, columns times the square root of the
    target's weight"""
    given_targets: NDArray[np.float32]
    """``[m, m]`` covariance of the measurable cells given the targets too, for mutual information;
    else of size 0"""
    noise_db2: float
    """σ², noise variance of a reading"""
    floor_db2: float
    """variance below which a cell counts as known: measuring it again gains nothing"""
    objective: Objective
    """what a path is paid for"""


class Rows(NamedTuple):
    """Measured cells with their rows of a growing Cholesky factor, one per line."""

    cell: NDArray[np.int64]
    """``[line]`` measurable cell"""
    factor: NDArray[np.float32]
    """``[line, depth]`` its row of the factor"""
    given: NDArray[np.float32]
    """``[line, depth]`` the same given the targets, for mutual information; else one line"""
    image: NDArray[np.float32]
    """``[line, x]`` its whitened covariance with the targets, for the variance; else no columns"""


@njit(cache=True)
def rows_for(lines, depth, reach):
    """Room for ``lines`` rows of up to ``depth`` entries."""
    targets = reach.targets.shape[1] if reach.objective == Objective.VARIANCE else 0
    both = reach.objective == Objective.MUTUAL_INFORMATION
    return Rows(
        np.full(lines, -1),
        np.empty((lines, depth), dtype=np.float32),
        np.empty((lines if both else 1, depth), dtype=np.float32),
        np.empty((lines, targets), dtype=np.float32),
    )


@uncounted(fastmath={"reassoc", "contract"}, error_model="numpy")
def gain_of(cell, chain, depth, rows, reach, out, line):
    """Gain of measuring ``cell`` after the ``depth`` lines ``chain`` of ``rows``; fills its own
    ``line`` of ``out``. −1 if the cell is known or on the path already."""
    # Whole arrays and two indices: a view of a row would be an object of its own each time.
    cells, factor, row, among = rows.cell, rows.factor, out.factor, reach.among
    for j in range(depth):
        if cells[chain[j]] == cell:
            return -1.0
    variance = among[cell, cell]
    for j in range(depth):
        above = chain[j]
        value = among[cell, cells[above]]
        for i in range(j):
            value -= row[line, i] * factor[above, i]
        value /= factor[above, j]
        row[line, j] = value
        variance -= value * value
    if variance <= reach.floor_db2:
        return -1.0
    total = variance + reach.noise_db2
    row[line, depth] = np.sqrt(total)
    if reach.objective == Objective.ENTROPY:
        return 0.5 * np.log(total / reach.noise_db2)
    if reach.objective == Objective.MUTUAL_INFORMATION:
        targets, factor, row = reach.given_targets, rows.given, out.given
        given = targets[cell, cell]
        for j in range(depth):
            above = chain[j]
            value = targets[cell, cells[above]]
            for i in range(j):
                value -= row[line, i] * factor[above, i]
            value /= factor[above, j]
            row[line, j] = value
            given -= value * value
        given = max(given, 0.0) + reach.noise_db2
        row[line, depth] = np.sqrt(given)
        return 0.5 * np.log(total / given)
    images, image, source = rows.image, out.image, reach.targets
    n, whole = source.shape[1], depth - depth % 4
    for x in range(n):
        image[line, x] = source[cell, x]
    for j in range(0, whole, 4):  # four at a time: the image is read and written less often
        w0, w1, w2, w3 = row[line, j], row[line, j + 1], row[line, j + 2], row[line, j + 3]
        k0, k1, k2, k3 = chain[j], chain[j + 1], chain[j + 2], chain[j + 3]
        for x in range(n):
            value = image[line, x] - w0 * images[k0, x] - w1 * images[k1, x]
            image[line, x] = value - w2 * images[k2, x] - w3 * images[k3, x]
    for j in range(whole, depth):
        weight, above = row[line, j], chain[j]
        for x in range(n):
            image[line, x] -= weight * images[above, x]
    scale, gain = np.float32(1.0) / row[line, depth], np.float32(0.0)
    for x in range(n):
        value = image[line, x] * scale
        image[line, x] = value
        gain += value * value
    return float(gain)


@uncounted()
def copied(source, line, to, node, depth, objective):
    """Copy one line of rows, of ``depth`` entries, to another."""
    to.cell[node] = source.cell[line]
    here, there = source.factor, to.factor
    for j in range(depth):
        there[node, j] = here[line, j]
    if objective == Objective.MUTUAL_INFORMATION:
        here, there = source.given, to.given
        for j in range(depth):
            there[node, j] = here[line, j]
    if objective == Objective.VARIANCE:
        here, there = source.image, to.image
        for x in range(here.shape[1]):
            there[node, x] = here[line, x]


@njit(cache=True)
def gains_alone(reach: Reach):
    """``[m]`` gain of each measurable cell on its own.

    Entropy gains only shrink along a path. Variance gains nearly always do; the search may lose a
    path where they grow.
    """
    out = np.full(len(reach.among), np.inf)
    if reach.objective == Objective.MUTUAL_INFORMATION:
        return out
    for cell in range(len(out)):
        variance = reach.among[cell, cell]
        if reach.objective == Objective.ENTROPY:
            out[cell] = 0.5 * np.log(1.0 + max(variance, 0.0) / reach.noise_db2)
        else:
            image = reach.targets[cell]
            out[cell] = np.dot(image, image) / max(variance + reach.noise_db2, reach.floor_db2)
    return out


@njit(cache=True)
def path_value(path, reach: Reach):
    """Objective of one path ``[k + 1, (row, col)]``, its first cell not counted."""
    n = len(path)
    rows, chain = rows_for(n, n, reach), np.arange(n)
    depth, total = np.int64(0), 0.0  # a plain 0 would compile `gain_of` once more
    for k in range(1, n):
        cell = reach.number[path[k, 0], path[k, 1]]
        if cell < 0:
            continue
        gain = gain_of(cell, chain, depth, rows, reach, rows, depth)
        if gain >= 0:
            rows.cell[depth] = cell
            total += gain
            depth += 1
    return total
