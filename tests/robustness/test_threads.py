"""The number of threads is no part of an answer."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from .processes import ended, skygain


@pytest.mark.parametrize("predictor", ["kriging-blind", "operator+tx"])
def test_one_thread_and_two_give_the_same_bytes(tmp_path: Path, predictor: str) -> None:
    asked = ("survey", "--city", "sample:9", "--crop", "64", "--steps", "6", "--planner")
    found = []
    for threads in ("1", "2"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        env = os.environ | dict.fromkeys(names, threads)
        out = tmp_path / threads
        words = ("greedy-variance", "--predictor", predictor, "--out", out)
        code, _, err = ended(skygain(*asked, *words, env=env))
        assert code == 0, err
        scores = json.loads((out / "results.json").read_text())["scores"]
        with xr.open_dataset(out / "radio_map.nc") as maps:
            found.append((scores, maps.mean_db.values, maps.std_db.values))
    (one, mean_one, std_one), (two, mean_two, std_two) = found
    assert one == two
    assert np.array_equal(mean_one, mean_two, equal_nan=True)
    assert np.array_equal(std_one, std_two, equal_nan=True)
