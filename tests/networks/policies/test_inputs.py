"""What a policy sees turns with the survey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skygain.flight.moves import MOVES
from skygain.grid import SYMMETRIES
from skygain.networks.policies.inputs import (
    Seen,
    centred_view,
    turned_moves,
    turned_view,
)


@pytest.fixture
def seen(rng):
    shape = (5, 20, 23)
    return Seen(
        mean=rng.integers(0, 256, shape).astype(np.uint8),
        std=rng.integers(0, 256, shape).astype(np.uint8),
        height=rng.integers(0, 256, shape).astype(np.uint8),
        flyable=rng.random(shape) < 0.7,
        cells=rng.integers(0, 20, (5, 3, 2)),
        uav=rng.integers(0, 3, 5),
        last=rng.integers(-1, 4, 5),
        left=rng.integers(0, 200, 5),
    )


def turned_survey(seen, symmetry):
    """The same survey on the turned map."""
    rows, cols = seen.mean.shape[1:]

    def turned(maps):
        maps = maps[:, :: -1 if symmetry & 1 else 1, :: -1 if symmetry & 2 else 1]
        return np.ascontiguousarray(maps.transpose(0, 2, 1) if symmetry & 4 else maps)

    cells = seen.cells.copy()
    if symmetry & 1:
        cells[..., 0] = rows - 1 - cells[..., 0]
    if symmetry & 2:
        cells[..., 1] = cols - 1 - cells[..., 1]
    last = np.where(seen.last >= 0, turned_moves(symmetry)[seen.last], -1)
    return replace(
        seen,
        mean=turned(seen.mean),
        std=turned(seen.std),
        height=turned(seen.height),
        flyable=turned(seen.flyable),
        cells=cells[..., ::-1] if symmetry & 4 else cells,
        last=last,
    )


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_the_view_turns_with_the_survey(seen, symmetry):
    for one, two in zip(
        turned_view(centred_view(seen), symmetry),
        centred_view(turned_survey(seen, symmetry)),
        strict=True,
    ):
        assert np.allclose(one, two, atol=1e-6)


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_moves_turn_like_cells(symmetry):
    cells = np.array([[5, 5]] * 4) + MOVES
    if symmetry & 1:
        cells[:, 0] = 10 - cells[:, 0]
    if symmetry & 2:
        cells[:, 1] = 10 - cells[:, 1]
    if symmetry & 4:
        cells = cells[:, ::-1]
    assert np.array_equal(cells - 5, MOVES[turned_moves(symmetry)])
