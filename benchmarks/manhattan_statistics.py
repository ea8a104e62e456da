"""Compare generated Manhattan cities with those of a data set: built share, buildings, sizes,
heights, transmitter sites.

    python benchmarks/manhattan_statistics.py PATH.zarr.zip [--cities 300] [--json OUT.json]

The data set is any in the project's layout; docs/cities.md shows the table for version 0.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from skygain.cities import manhattan_city, transmitter_sites

PERCENT = (5, 25, 50, 75, 95)


def statistics(built: np.ndarray, rectangles: list[np.ndarray]) -> dict[str, str]:
    """Rows of the table from the built share per city and its ``[building, (x0, y0, x1, y1,
    height)]``."""
    counts = np.array([len(r) for r in rectangles])
    every = np.concatenate(rectangles)
    rows = {
        "cities": f"{len(built)}",
        "built share of the cells": f"{built.mean():.3f} ± {built.std():.3f}",
        "buildings per city": f"{counts.mean():.1f} ± {counts.std():.1f}",
    }
    measures = {
        "width": every[:, 2] - every[:, 0],
        "length": every[:, 3] - every[:, 1],
        "height": every[:, 4],
    }
    for name, values in measures.items():
        rows[f"building {name}, 5/25/50/75/95 % (m)"] = " / ".join(
            f"{v:.1f}" for v in np.percentile(values, PERCENT)
        )
    for altitude in (10, 20, 30):
        rows[f"share of buildings below {altitude} m"] = f"{(every[:, 4] < altitude).mean():.3f}"
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("path", type=Path)
    parser.add_argument("--cities", type=int, default=300)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()

    with xr.open_zarr(zarr.storage.ZipStore(arguments.path, mode="r"), consolidated=False) as data:
        stored = data.building.values.astype(float)
        theirs = statistics(
            (data.height_m.values > 0).mean(axis=(1, 2)), [r[np.isfinite(r[:, 0])] for r in stored]
        )
    cities = [manhattan_city(seed) for seed in range(arguments.cities)]
    rectangles = [
        np.array([[*b.footprint_m[0], *b.footprint_m[2], b.height_m] for b in city.buildings])
        for city in cities
    ]
    ours = statistics(np.array([(city.height_m > 0).mean() for city in cities]), rectangles)
    ours["outdoor transmitter sites per city"] = (
        f"{np.mean([len(transmitter_sites(city)) for city in cities]):.1f} of 25"
    )

    print(f"| | generated | {arguments.path.name} |\n|---|---|---|")
    for name, value in ours.items():
        print(f"| {name} | {value} | {theirs.get(name, '')} |")
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"generated": ours, arguments.path.name: theirs}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
