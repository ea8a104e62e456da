"""Make the invented town and the invented campaign of this folder: `buildings.geojson` with 300 x
300 m of streets in UTM zone 32N, `campaign.csv` with readings of two cells along those streets, and
`gain.npz` with the gain of both at 10 m, in metres of its own.

    python examples/data/make.py

The levels come from Skygain's own propagation, with 3 dB of noise; nothing here was measured.
"""

from __future__ import annotations

import csv
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from pyproj import Transformer

from skygain.cities import open_city
from skygain.propagation.truth import trace_truth

FOLDER = Path(__file__).parent
CRS, WEST_M, SOUTH_M, SIDE_M = "EPSG:32632", 500_600.0, 5_538_200.0, 300.0
CELLS = {"101": (58.0, 204.0, 18.0), "202": (206.0, 90.0, 15.0)}
"""physical cell id → x, y, z of its antenna in metres from the south-west corner"""
EIRP_DBM, FREQUENCY_HZ, NOISE_DB, LOWEST_DBM = 18.0, 3.6e9, 3.0, -128.0
TO_DEGREES = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)


def write_buildings() -> None:
    """Buildings of a generated city, moved to their place."""
    features = []
    for building in open_city("42").buildings:
        corners = np.asarray(building.footprint_m)
        if (corners < 2.0).any() or (corners > SIDE_M - 2.0).any():
            continue
        ring = np.vstack([corners, corners[:1]]) + np.array([WEST_M, SOUTH_M])
        degrees = np.round(np.column_stack(TO_DEGREES.transform(*ring.T)), 7)
        features.append(
            {
                "type": "Feature",
                "properties": {"height": round(float(building.height_m), 1)},
                "geometry": {"type": "Polygon", "coordinates": [degrees.tolist()]},
            }
        )
    lines = ",\n".join(json.dumps(feature) for feature in features)
    text = f'{{"type": "FeatureCollection", "features": [\n{lines}\n]}}\n'
    (FOLDER / "buildings.geojson").write_text(text, encoding="utf-8")


def write_campaign() -> None:
    """A walk through all streets: every few metres one reading of each cell that is heard."""
    rng = np.random.default_rng(1)
    city = open_city(str(FOLDER / "buildings.geojson"), spacing_m=4.0)
    places = [(WEST_M + x, SOUTH_M + y, z) for x, y, z in CELLS.values()]
    gain = trace_truth(city, places, [1.5], frequency_hz=FREQUENCY_HZ).gain_db[:, 0]
    time, rows = datetime(2025, 5, 6, 9, tzinfo=UTC), []
    for row, col in walk(city.height_m > 0):
        time += timedelta(seconds=3)
        x, y = city.grid.xy_m((row, col)) + rng.normal(0.0, 0.6, 2)
        lon, lat = TO_DEGREES.transform(x, y)
        for k, pci in enumerate(CELLS):
            level = EIRP_DBM + gain[k, row, col] + rng.normal(0.0, NOISE_DB)
            if level >= LOWEST_DBM:
                stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ")
                rows.append([stamp, f"{lat:.6f}", f"{lon:.6f}", pci, f"{level:.0f}"])
    with (FOLDER / "campaign.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time", "latitude", "longitude", "pci", "rsrp_dbm"])
        writer.writerows(rows)


def write_gain() -> None:
    """The maps that another program might have computed."""
    city = open_city(str(FOLDER / "buildings.geojson"), spacing_m=4.0)
    places = np.array([(WEST_M + x, SOUTH_M + y, z) for x, y, z in CELLS.values()])
    gain = trace_truth(city, places, [10.0], frequency_hz=FREQUENCY_HZ).gain_db[:, 0]
    np.savez_compressed(
        FOLDER / "gain.npz",
        gain_db=np.where(city.obstructed(10.0), np.nan, np.round(gain, 1)).astype(np.float16),
        height_m=city.height_m.astype(np.float16),
        transmitter_m=places - (*city.grid.origin_m, 0.0),
        spacing_m=4.0,
        altitude_m=10.0,
        frequency_hz=FREQUENCY_HZ,
    )


def walk(built: np.ndarray) -> list[tuple[int, int]]:
    """Every second cell of a walk along the streets that run through, to and fro."""
    clear = ~built
    lanes = [[(r, c) for c in range(built.shape[1])] for r in middles(clear.mean(axis=1))]
    lanes += [[(r, c) for r in range(built.shape[0])] for c in middles(clear.mean(axis=0))]
    return [cell for k, lane in enumerate(lanes) for cell in lane[:: (-1) ** k * 2] if clear[cell]]


def middles(share: np.ndarray) -> list[int]:
    """Middle of every run of rows or columns that are clear nearly throughout."""
    runs: list[list[int]] = []
    for k in np.flatnonzero(share > 0.9):
        if runs and runs[-1][-1] == k - 1:
            runs[-1].append(int(k))
        else:
            runs.append([int(k)])
    return [run[len(run) // 2] for run in runs]


if __name__ == "__main__":
    write_buildings()
    write_campaign()
    write_gain()
