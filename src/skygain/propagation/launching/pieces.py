"""Which rays of a vertical plane are left: a list of intervals of their initial slope.

All rays of an azimuth share their way in plan; what sets them apart is the slope m they start
with. A wall takes an interval of slopes away, so what passes it and what it reflects are lists
of intervals again.
"""

from __future__ import annotations

__all__ = ["MOST", "inside", "outside"]

import numpy as np
from numpy.typing import NDArray

from skygain.propagation.launching.compiled import inner

MOST = 12
"""most intervals in a list; the shortest are left out beyond it"""


@inner
def outside(pieces: NDArray[np.float64], n: int, low: float, high: float) -> int:
    """Take the interval (low, high) away from ``pieces[:n]``, in place; returns how many remain."""
    if low >= high:
        return n
    k = 0
    added = n
    for i in range(n):
        a, b = pieces[i, 0], pieces[i, 1]
        if high <= a or low >= b:
            pieces[k, 0], pieces[k, 1] = a, b
            k += 1
            continue
        left, right = low > a, high < b
        if left:
            pieces[k, 0], pieces[k, 1] = a, low
            k += 1
        if right:
            if left:
                # two remain of one: the second waits at the end of the list
                if added < MOST:
                    pieces[added, 0], pieces[added, 1] = high, b
                    added += 1
            else:
                pieces[k, 0], pieces[k, 1] = high, b
                k += 1
    for i in range(n, added):
        pieces[k, 0], pieces[k, 1] = pieces[i, 0], pieces[i, 1]
        k += 1
    return k


@inner
def inside(
    pieces: NDArray[np.float64],
    n: int,
    low: float,
    high: float,
    found: NDArray[np.float64],
    k: int,
) -> int:
    """Append the part of ``pieces[:n]`` within (low, high) to ``found[:k]``; returns its length."""
    for i in range(n):
        a, b = max(pieces[i, 0], low), min(pieces[i, 1], high)
        if a < b and k < MOST:
            found[k, 0], found[k, 1] = a, b
            k += 1
    return k
