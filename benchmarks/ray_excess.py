"""Where ray-traced gains exceed free space by more than 6 dB, and why.

    python benchmarks/ray_excess.py [--cities 6]

For some transmitters of some Manhattan cities, at 10, 20 and 30 m and 3 M rays, it counts the outdoor cells whose gain is more than
6 dB above free space before the guard cuts them: with everything on, without diffraction, and with everything on but roofs left
where they are, that is, without moving those that nearly lie in the plane of the cells. Then it traces the cells that exceed without
diffraction again with ten times as many rays. Results go to benchmarks/results/ray_excess.json and .md.
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
from skygain.city import City
from skygain.propagation import sionna
from skygain.propagation.diffraction import free_space_gain_db

ALTITUDES_M = (10.0, 20.0, 30.0)
RESULTS = Path(__file__).parent / "results"


def excess_db(city: City, sites: NDArray[np.float64], *, move_roofs: bool = True, **settings: Any) -> NDArray[np.float64]:
    """Gain over free space before the guard, ``[site, altitude, row, col]``, -inf where no ray came or indoors."""
    clearance = sionna._clearance_m if move_roofs else lambda city: 0.0
    with mock.patch.object(sionna, "GUARD_DB", np.inf), mock.patch.object(sionna, "_clearance_m", clearance):
        gain = sionna.trace_gain_db(city, sites, ALTITUDES_M, **settings).gain_db
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    across = np.hypot(x - sites[:, 0, None, None], y - sites[:, 1, None, None])[:, None]
    up = np.array(ALTITUDES_M)[None, :, None, None] - sites[:, 2, None, None, None]
    outdoor = ~np.stack([city.obstructed(h) for h in ALTITUDES_M])
    return np.where(outdoor, gain - free_space_gain_db(np.hypot(across, up)), -np.inf)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cities", type=int, default=6)
    parser.add_argument("--samples", type=int, default=3_000_000)
    options = parser.parse_args()
    ways: dict[str, dict[str, Any]] = {
        "reflections and diffraction": {},
        "the same, roofs not moved": {"move_roofs": False},
        "reflections only": {"diffraction": False},
        "reflections only, ten times the rays": {"diffraction": False, "samples": 10 * options.samples},
    }
    found: dict[str, list[NDArray[np.float64]]] = {way: [] for way in ways}
    for seed in range(2001, 2001 + options.cities):
        city = manhattan_city(seed)
        sites = transmitter_sites(city)[::9]
        for way, settings in ways.items():
            found[way].append(excess_db(city, sites, **{"samples": options.samples, **settings}).ravel())
            print(seed, way, "largest excess", round(float(found[way][-1].max()), 1), "dB", flush=True)
    rows = []
    for way, parts in found.items():
        values = np.concatenate(parts)
        outdoor = int(np.isfinite(np.concatenate(found["reflections and diffraction"])).sum())
        above = [int((values > limit).sum()) for limit in (6.0, 10.0, 20.0)]
        rows.append({"way": way, "cells_reached": outdoor, "above_6_10_20_db": above, "largest_db": float(values.max())})
    lines = [
        f"# Gains above free space + 6 dB\n\n{options.samples / 1e6:g} M rays per transmitter, {options.cities} cities.\n",
        "| what | cells > 6 dB | > 10 dB | > 20 dB | largest |",
        "|---|---|---|---|---|",
    ]
    for r in rows:
        above = " | ".join(str(n) for n in r["above_6_10_20_db"])
        lines.append(f"| {r['way']} | {above} | {r['largest_db']:.1f} dB |")
    lines.append(f"\nOf {rows[0]['cells_reached']} cells that a ray reached.\n")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "ray_excess.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    (RESULTS / "ray_excess.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
