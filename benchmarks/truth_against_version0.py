"""Rebuild links of data set version 0 from its building rectangles and compare the truths.

    python benchmarks/truth_against_version0.py ../shared/data/manhattan-v0.zarr.zip [--links
    0,126,400]

Version 0 was traced with the same ray tracer, materials and number of rays by another program. Each
link is traced alone, and in one solver call with the other stored transmitters of its city. Prints
the difference over the outdoor cells and writes benchmarks/results/truth_against_version0.json and
.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from skygain.city import Building, City
from skygain.grid import Grid
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.sionna import trace_gain_db

RESULTS = Path(__file__).parent / "results"


def city_of(data: xr.Dataset, number: int) -> City:
    """City ``number`` of the data set, with its rectangles as buildings."""
    boxes = data.building[number].values.astype(float)
    boxes = boxes[np.isfinite(boxes[:, 0])]
    buildings = tuple(
        Building(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), float(height))
        for x0, y0, x1, y1, height in boxes
    )
    grid = Grid(shape=(data.sizes["y"], data.sizes["x"]), spacing_m=4.0, origin_m=(3.0, 3.0))
    return City(
        grid=grid,
        height_m=data.height_m[number].values.astype(np.float32),
        buildings=buildings,
        name=f"version 0, city {number}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--links", default="0,126,400")
    options = parser.parse_args()
    data = xr.open_zarr(zarr.storage.ZipStore(options.data, mode="r"), consolidated=False)
    rows = []
    for link in map(int, options.links.split(",")):
        city = city_of(data, int(data.city_index[link]))
        for altitude in (10.0, 20.0):
            stored = data.gain_db[link].sel(altitude=altitude).values.astype(float)
            if not np.isfinite(stored).any():
                continue
            outdoor = ~city.obstructed(altitude)
            roof = over_rooftop_gain_db(city, data.tx_m[link].values, [altitude])[0, 0]
            mates = np.flatnonzero(data.city_index.values == int(data.city_index[link]))
            for way, links in (
                ("alone", np.array([link])),
                (f"with {len(mates) - 1} others", mates),
            ):
                traced = trace_gain_db(
                    city,
                    data.tx_m.values[links],
                    [altitude],
                    samples=3_000_000,
                    transmitters_per_call=len(links),
                ).gain_db[np.flatnonzero(links == link)[0], 0]
                gap = np.maximum(traced, roof) - stored
                same = outdoor & (
                    (traced >= roof) == data.ray_traced[link].sel(altitude=altitude).values
                )
                rows.append(
                    {
                        "link": link,
                        "altitude_m": altitude,
                        "solver_call": way,
                        "median_abs_db": float(np.median(np.abs(gap[outdoor]))),
                        "p95_abs_db": float(np.percentile(np.abs(gap[outdoor]), 95)),
                        "mean_db": float(gap[outdoor].mean()),
                        "same_source": float(same.sum() / outdoor.sum()),
                        "p95_abs_db_same_source": float(np.percentile(np.abs(gap[same]), 95)),
                    }
                )
                print(rows[-1], flush=True)
    lines = [
        "# Truth rebuilt from version 0's buildings, against its stored gain",
        "",
        "| link | altitude | transmitter traced | median | 95 % | mean | cells of the same source "
        "| 95 % of those |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        where = f"{r['link']} | {r['altitude_m']:.0f} m | {r['solver_call']}"
        gap = f"{r['median_abs_db']:.2f} dB | {r['p95_abs_db']:.2f} dB | {r['mean_db']:+.2f} dB"
        lines.append(
            f"| {where} | {gap} | {100 * r['same_source']:.1f} % | "
            f"{r['p95_abs_db_same_source']:.2f} dB |"
        )
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "truth_against_version0.json").write_text(
        json.dumps(rows, indent=1) + "\n", encoding="utf-8"
    )
    (RESULTS / "truth_against_version0.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
