"""What generated cities are like."""

from __future__ import annotations

import numpy as np
import xarray as xr
import zarr

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.cities import manhattan_city, transmitter_sites

PERCENT = (5, 25, 50, 75, 95)


def statistics(built: np.ndarray, rectangles: list[np.ndarray]) -> dict[str, str]:
    """Rows of the table from the built share per city and its ``[building, (x0, y0, x1, y1,
    height)]``."""
    counts = np.array([len(r) for r in rectangles])
    every = np.concatenate(rectangles)
    measures = {
        "width": every[:, 2] - every[:, 0],
        "length": every[:, 3] - every[:, 1],
        "height": every[:, 4],
    }
    return {
        "cities": f"{len(built)}",
        "built share of the cells": f"{built.mean():.3f} ± {built.std():.3f}",
        "buildings per city": f"{counts.mean():.1f} ± {counts.std():.1f}",
        **{
            f"building {name}, 5/25/50/75/95 % (m)": " / ".join(
                f"{v:.1f}" for v in np.percentile(values, PERCENT)
            )
            for name, values in measures.items()
        },
        "share of buildings below 10 / 20 / 30 m": " / ".join(
            f"{(every[:, 4] < altitude).mean():.3f}" for altitude in (10, 20, 30)
        ),
    }


@study("manhattan", data="DATA", cities=Option(300, "how many cities are generated"))
def manhattan(run: Run) -> list[Table]:
    """Generated Manhattan cities beside those of a data set: built share, buildings, sizes,
    heights, transmitter sites."""
    with xr.open_zarr(zarr.storage.ZipStore(run.data, mode="r"), consolidated=False) as data:
        stored = data.building.values.astype(float)
        theirs = statistics(
            (data.height_m.values > 0).mean(axis=(1, 2)), [r[np.isfinite(r[:, 0])] for r in stored]
        )
    cities = [manhattan_city(seed) for seed in range(run.options.cities)]
    rectangles = [
        np.array([[*b.footprint_m[0], *b.footprint_m[2], b.height_m] for b in city.buildings])
        for city in cities
    ]
    ours = statistics(np.array([(city.height_m > 0).mean() for city in cities]), rectangles)
    sites = np.mean([len(transmitter_sites(city)) for city in cities])
    ours["outdoor transmitter sites per city"] = f"{sites:.1f} of 25"
    rows = [[name, value, theirs.get(name, "")] for name, value in ours.items()]
    return [Table("", ["", "generated", "data set"], rows)]
