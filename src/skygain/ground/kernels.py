"""How functions in the innermost loops are compiled.

Numba counts references to every array that a function takes or returns, and these counts, atomic
because threads share them, can take as long as the work. What allocates nothing needs no count.
"""

from __future__ import annotations

__all__ = ["uncounted"]

from typing import Any

import numba


def uncounted(**options: Any) -> Any:
    """A decorator that compiles a function that allocates nothing, with further ``options`` of
    `numba.njit`; an allocation in it fails to compile."""
    return numba.njit(cache=True, _nrt=False, **options)  # type: ignore[call-overload]
