"""Truth rebuilt from the rectangles of data set version 0, which another program traced."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skygain.city import City
from skygain.grid import Grid
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.sionna import trace_gain_db

from .conftest import box, needs_rays


@needs_rays
def test_a_link_of_version_0_is_reproduced_up_to_ray_noise(shared_data: Path) -> None:
    xr, zarr = pytest.importorskip("xarray"), pytest.importorskip("zarr")
    data = xr.open_zarr(
        zarr.storage.ZipStore(shared_data / "manhattan-v0.zarr.zip", mode="r"), consolidated=False
    )
    boxes = data.building[0].values.astype(float)
    buildings = tuple(box(*b) for b in boxes[np.isfinite(boxes[:, 0])])
    city = City(
        Grid((121, 121), 4.0, (3.0, 3.0)), data.height_m[0].values.astype(np.float32), buildings
    )
    transmitter, outdoor = data.tx_m[0].values, ~city.obstructed(10.0)
    stored, by_ray = data.gain_db[0, 0].values.astype(float), data.ray_traced[0, 0].values
    rays = trace_gain_db(city, transmitter, [10.0], samples=3_000_000)
    roof = over_rooftop_gain_db(city, transmitter, [10.0])[0, 0]
    gap = np.abs(np.maximum(rays.gain_db[0, 0], roof) - stored)
    assert np.median(gap[outdoor]) < 0.15
    # Whether a ray reaches a cell of the deep shadow is a matter of chance; nine in ten cells agree
    # on it.
    same = outdoor & ((rays.gain_db[0, 0] >= roof) == by_ray)
    assert same.sum() > 0.88 * outdoor.sum()
    assert np.percentile(gap[same], 90) < 2.0
    # The rooftop term involves no chance, only another sampling of the profile.
    assert np.percentile(np.abs(roof - stored)[outdoor & ~by_ray], 90) < 0.3
