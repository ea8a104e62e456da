"""Fixtures shared by the whole suite."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with the large data sets that are not part of the product; tests that need it skip where it is absent."""
    root = Path(os.environ.get("SKYGAIN_SHARED", Path(__file__).parents[1].parent / "shared")) / "data"
    if not (root / "manhattan-v0.zarr.zip").exists():
        pytest.skip("the shared data sets are absent; set SKYGAIN_SHARED to the folder that holds data/manhattan-v0.zarr.zip")
    return root


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240229)
