"""How the launcher's inner functions are compiled.

Numba counts references to every array that a function takes, and these counts, atomic because
threads share them, took more than half of the time. What allocates nothing needs no count.
"""

from __future__ import annotations

__all__ = ["inner"]

import numba

inner = numba.njit(cache=True, nogil=True, _nrt=False)
"""compiles a function that allocates nothing; an allocation in it fails to compile"""
