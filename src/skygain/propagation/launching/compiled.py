"""How the launcher's inner functions are compiled.

Numba counts references to every array that a function takes, and these counts, atomic because
threads share them, took more than half of the time. What allocates nothing needs no count.
"""

from __future__ import annotations

__all__ = ["inner"]

from skygain.ground.kernels import uncounted

inner = uncounted(nogil=True)
"""compiles a function that allocates nothing; an allocation in it fails to compile"""
