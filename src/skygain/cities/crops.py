"""Windows of a large city."""

from __future__ import annotations

__all__ = ["central_crop", "random_crop"]

import numpy as np

from skygain.city import City
from skygain.ground.errors import InputError


def central_crop(city: City, shape: tuple[int, int], *, rebase: bool = False) -> City:
    """The window of ``shape`` (rows, cols) in the middle; see `City.cropped` for ``rebase``.

    Raises:
        InputError: the city is smaller than the window.
    """
    row, col = (
        have - want for have, want in zip(city.grid.shape, _fitting(city, shape), strict=True)
    )
    return city.cropped(row // 2, col // 2, shape, rebase=rebase)


def random_crop(
    city: City, shape: tuple[int, int], rng: np.random.Generator, *, rebase: bool = False
) -> City:
    """A window of ``shape`` (rows, cols) anywhere, every position as likely; see `City.cropped` for
    ``rebase``.

    Raises:
        InputError: the city is smaller than the window.
    """
    row, col = (
        int(rng.integers(have - want + 1))
        for have, want in zip(city.grid.shape, _fitting(city, shape), strict=True)
    )
    return city.cropped(row, col, shape, rebase=rebase)


def _fitting(city: City, shape: tuple[int, int]) -> tuple[int, int]:
    rows, cols = city.grid.shape
    if not (1 <= shape[0] <= rows and 1 <= shape[1] <= cols):
        raise InputError(
            f"a window of {shape} cells does not fit {city.name!r}, which has {rows} x {cols}; "
            "choose a smaller one"
        )
    return shape
