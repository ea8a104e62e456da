"""Where ray-traced gains exceed free space by more than 6 dB, and why.

    python benchmarks/ray_excess.py [--cities 6]

For some transmitters of some Manhattan cities, at 10, 20 and 30 m and 3 M rays, it counts the
outdoor cells whose gain is more than
6 dB above free space before the guard cuts them: with everything on, without diffraction, and with
everything on but roofs left where they are, that is, without moving those that nearly lie in the
plane of the cells. Then it traces the cells that exceed without diffraction again with ten times as
many rays. Before that, it traces one long wall whose roof lies 0.26 m above the cells, with the
transmitter in front of it, and takes the largest diffracted gain over free space far from the wall,
for several seeds, with the roof moved and not. Results go to benchmarks/results/ray_excess.json and
.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from skygain.cities.manhattan import manhattan_city, transmitter_sites
from skygain.city import Building, City
from skygain.grid import Grid
from skygain.propagation import sionna
from skygain.propagation.diffraction import free_space_gain_db

ALTITUDES_M = (10.0, 20.0, 30.0)
RESULTS = Path(__file__).parent / "results"


def excess_db(
    city: City, sites: NDArray[np.float64], *, move_roofs: bool = True, **settings: Any
) -> NDArray[np.float64]:
    """Gain over free space before the guard, ``[site, altitude, row, col]``, -inf where no ray came
    or indoors."""
    clearance = sionna._clearance_m if move_roofs else lambda city: 0.0
    with (
        mock.patch.object(sionna, "GUARD_DB", np.inf),
        mock.patch.object(sionna, "_clearance_m", clearance),
    ):
        gain = sionna.trace_gain_db(city, sites, ALTITUDES_M, **settings).gain_db
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    across = np.hypot(x - sites[:, 0, None, None], y - sites[:, 1, None, None])[:, None]
    up = np.array(ALTITUDES_M)[None, :, None, None] - sites[:, 2, None, None, None]
    outdoor = ~np.stack([city.obstructed(h) for h in ALTITUDES_M])
    return np.where(outdoor, gain - free_space_gain_db(np.hypot(across, up)), -np.inf)


def wall_excess_db(seeds: int, *, move_roofs: bool) -> list[float]:
    """Largest diffracted gain over free space beyond 60 m from a wall with its roof 0.26 m above
    the cells, for each seed."""
    grid = Grid(shape=(121, 121), spacing_m=4.0, origin_m=(2.0, 2.0))
    y, x = np.meshgrid(grid.y_m, grid.x_m, indexing="ij")
    ring = np.array([[20.0, 0.0], [460.0, 0.0], [460.0, 20.0], [20.0, 20.0]])
    height = np.where((x > 20) & (x < 460) & (y < 20), 10.26, 0.0)
    city = City(grid=grid, height_m=height, buildings=(Building(ring, 10.26),), name="wall")
    site = np.array([[243.0, 40.0, 1.5]])
    friis = free_space_gain_db(np.sqrt((x - 243) ** 2 + (y - 40) ** 2 + 8.5**2))
    clearance = sionna._clearance_m if move_roofs else lambda city: 0.0
    largest = []
    for seed in range(seeds):
        with (
            mock.patch.object(sionna, "GUARD_DB", np.inf),
            mock.patch.object(sionna, "_clearance_m", clearance),
        ):
            gains = [
                sionna.trace_gain_db(
                    city,
                    site,
                    [10.0],
                    samples=1_000_000,
                    seed=seed,
                    max_reflections=1,
                    diffraction=d,
                ).gain_db[0, 0]
                for d in (True, False)
            ]
        diffracted = np.maximum(10 ** (gains[0] / 10) - 10 ** (gains[1] / 10), 1e-30)
        largest.append(float((10 * np.log10(diffracted) - friis)[y > 60].max()))
    return largest


def count_in_cities(count: int, samples: int) -> dict[str, Any]:
    """Outdoor cells above limits, for each way of tracing."""
    ways: dict[str, dict[str, Any]] = {
        "reflections and diffraction": {},
        "the same, roofs not moved": {"move_roofs": False},
        "reflections only": {"diffraction": False},
        "reflections only, ten times the rays": {"diffraction": False, "samples": 10 * samples},
    }
    found: dict[str, list[NDArray[np.float64]]] = {way: [] for way in ways}
    for seed in range(2001, 2001 + count):
        city = manhattan_city(seed)
        sites = transmitter_sites(city)[::9]
        for way, settings in ways.items():
            found[way].append(excess_db(city, sites, **{"samples": samples, **settings}).ravel())
            print(
                seed, way, "largest excess", round(float(found[way][-1].max()), 1), "dB", flush=True
            )
    rows = []
    for way, parts in found.items():
        values = np.concatenate(parts)
        above = [int((values > limit).sum()) for limit in (6.0, 10.0, 20.0)]
        reached = int(np.isfinite(values).sum())
        rows.append(
            {
                "way": way,
                "cells_reached": reached,
                "above_6_10_20_db": above,
                "largest_db": float(values.max()),
            }
        )
    return {"cities": count, "samples": samples, "rows": rows}


def markdown(found: dict[str, Any]) -> str:
    """The tables."""
    lines = ["# Gains above free space + 6 dB", ""]
    if "in_cities" in found:
        part = found["in_cities"]
        lines += [
            f"{part['cities']} Manhattan cities at 10, 20 and 30 m, {part['samples'] / 1e6:g} M "
            "rays per transmitter, before the guard:",
            "",
        ]
        lines += [
            "| traced | cells > 6 dB | > 10 dB | > 20 dB | largest |",
            "|---|---|---|---|---|",
        ]
        for r in part["rows"]:
            lines.append(
                f"| {r['way']} | {' | '.join(map(str, r['above_6_10_20_db']))} | "
                f"{r['largest_db']:.1f} dB |"
            )
        lines += [
            "",
            f"Of {part['rows'][0]['cells_reached']} outdoor cells that a ray reached.",
            "",
        ]
    if "wall_db" in found:
        lines += [
            "A wall with its roof 0.26 m above the cells, 1 M rays, 8 seeds; largest diffracted "
            "gain over free space:",
            "",
        ]
        lines += ["| roof | smallest of the seeds | median | largest |", "|---|---|---|---|"]
        for label, values in found["wall_db"].items():
            lines.append(
                f"| {label} | {min(values):.1f} dB | {float(np.median(values)):.1f} dB | "
                f"{max(values):.1f} dB |"
            )
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--cities",
        type=int,
        default=3,
        help="0 keeps the counts of an earlier run and traces only the wall",
    )
    parser.add_argument("--samples", type=int, default=3_000_000)
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    stored = RESULTS / "ray_excess.json"
    found: dict[str, Any] = (
        json.loads(stored.read_text(encoding="utf-8")) if stored.exists() else {}
    )
    if options.cities:
        found["in_cities"] = count_in_cities(options.cities, options.samples)
    found["wall_db"] = {
        label: wall_excess_db(8, move_roofs=move)
        for label, move in (("moved", True), ("not moved", False))
    }
    stored.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (RESULTS / "ray_excess.md").write_text(markdown(found), encoding="utf-8")
    print(markdown(found))


if __name__ == "__main__":
    main()
