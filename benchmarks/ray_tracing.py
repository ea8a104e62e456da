"""Time and noise of ray-traced maps: the measurements behind the default number of rays.

    python benchmarks/ray_tracing.py [--seconds-only] [--reference 100000000]

On Manhattan cities at 10 m altitude it measures
- seconds per transmitter map at 3 M and 10 M rays: a loop that sets the scene up anew for each
  transmitter, one scene with one transmitter per solver call, and ten transmitters per call; and
  what sharing a call does to the map;
- the difference of two maps of one transmitter with different seeds;
- the difference to a map of 100 M rays, on two cities, for 1 M to 30 M rays.
Differences are taken between the truths (the stronger of ray-traced and over-rooftop gain) over the
outdoor cells, because that is what surveys see, and between the bare ray-traced gains where both
maps have one. Times are of the second run, after the kernels are compiled, on one thread; processor
seconds beside wall seconds, because the machine may be shared. Results go to
benchmarks/results/ray_tracing.json and .md.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.manhattan import manhattan_city, transmitter_sites
from skygain.city import City
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.sionna import RayTraced, trace_gain_db

ALTITUDE_M = 10.0
RESULTS = Path(__file__).parent / "results"


def timed(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """What the work returned, its wall seconds and its processor seconds."""
    wall, processor = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall, time.process_time() - processor


def difference(
    city: City, transmitter: NDArray[np.float64], a: NDArray[np.float32], b: NDArray[np.float32]
) -> dict[str, float]:
    """How far two ray-traced maps ``[row, col]`` of one transmitter are apart, and the truths made
    of them."""
    outdoor = ~city.obstructed(ALTITUDE_M)
    roof = over_rooftop_gain_db(city, transmitter, [ALTITUDE_M])[0, 0]
    truth = np.abs(np.maximum(a, roof).astype(float) - np.maximum(b, roof))[outdoor]
    both = outdoor & np.isfinite(a) & np.isfinite(b)
    rays = np.abs(a[both].astype(float) - b[both])
    return {
        "truth_rmse_db": float(np.sqrt((truth**2).mean())),
        "truth_median_db": float(np.median(truth)),
        "truth_p95_db": float(np.percentile(truth, 95)),
        "rays_median_db": float(np.median(rays)),
        "rays_p95_db": float(np.percentile(rays, 95)),
        "reached": float(np.isfinite(a)[outdoor].mean()),
    }


def mean_of(rows: list[dict[str, float]]) -> dict[str, float]:
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}


def measure_seconds(city: City, sites: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Seconds per transmitter map, three ways, with the same ten transmitters."""
    rows = []
    for samples in (3_000_000, 10_000_000):
        ways: dict[str, Callable[[], list[RayTraced]]] = {
            "loop, a scene each": lambda n=samples: [
                trace_gain_db(city, site, [ALTITUDE_M], samples=n) for site in sites
            ],
            "one scene, 1 per call": lambda n=samples: [
                trace_gain_db(city, sites, [ALTITUDE_M], samples=n)
            ],
            "one scene, 10 per call": lambda n=samples: [
                trace_gain_db(city, sites, [ALTITUDE_M], samples=n, transmitters_per_call=10)
            ],
        }
        for way, work in ways.items():
            traced, wall, processor = timed(work)
            gain = np.concatenate([t.gain_db for t in traced])
            outdoor = ~city.obstructed(ALTITUDE_M)
            rows.append(
                {
                    "samples": samples,
                    "way": way,
                    "wall_s": wall / len(sites),
                    "processor_s": processor / len(sites),
                    "reached": float(np.isfinite(gain[:, 0])[:, outdoor].mean()),
                }
            )
            print(rows[-1], flush=True)
    return rows


def measure_seeds(
    city: City, sites: NDArray[np.float64], counts: list[int]
) -> list[dict[str, Any]]:
    """Difference between two seeds, mean over the transmitters."""
    rows = []
    for samples in counts:
        first, second = (
            trace_gain_db(city, sites, [ALTITUDE_M], samples=samples, seed=seed).gain_db[:, 0]
            for seed in (1, 2)
        )
        found = [
            difference(city, site, a, b) for site, a, b in zip(sites, first, second, strict=True)
        ]
        rows.append({"samples": samples, **mean_of(found)})
        print(rows[-1], flush=True)
    return rows


def measure_reference(
    cities: list[City], counts: list[int], reference: int
) -> list[dict[str, Any]]:
    """Difference to a map of many rays; one transmitter in each city."""
    found: dict[int, list[dict[str, float]]] = {n: [] for n in counts}
    reached = []
    for city in cities:
        sites = transmitter_sites(city)
        site = sites[len(sites) // 2]
        best, wall, _ = timed(
            lambda c=city, s=site: trace_gain_db(
                c, s, [ALTITUDE_M], samples=reference, seed=9
            ).gain_db[0, 0]
        )
        reached.append(float(np.isfinite(best)[~city.obstructed(ALTITUDE_M)].mean()))
        print(f"reference of {city.name}: {wall:.0f} s, reached {reached[-1]:.3f}", flush=True)
        for samples in counts:
            traced, wall, processor = timed(
                lambda c=city, s=site, n=samples: trace_gain_db(
                    c, s, [ALTITUDE_M], samples=n, seed=1
                )
            )
            row = difference(city, site, traced.gain_db[0, 0], best)
            found[samples].append(
                {**row, "processor_s": processor, "guarded": float(traced.guarded)}
            )
            print(city.name, samples, found[samples][-1], flush=True)
    rows = [{"samples": n, **mean_of(per_city)} for n, per_city in found.items()]
    return [*rows, {"samples": reference, "reached": float(np.mean(reached))}]


def markdown(found: dict[str, Any]) -> str:
    """The tables."""
    lines = [
        "# Ray tracing",
        "",
        f"{found['machine']}; Sionna RT {found['sionna-rt']}, one thread, 10 m altitude, 121 × "
        "121 cells.",
        "",
    ]
    if "seconds" in found:
        lines += [
            "| rays | way | wall s per map | processor s per map | cells reached |",
            "|---|---|---|---|---|",
        ]
        for r in found["seconds"]:
            lines.append(
                f"| {r['samples'] / 1e6:g} M | {r['way']} | {r['wall_s']:.2f} | "
                f"{r['processor_s']:.2f} | {100 * r['reached']:.1f} % |"
            )
        lines.append("")
    for key, title in (("seeds", "Two seeds"), ("reference", "Against the largest map")):
        if key in found:
            lines += [
                f"{title}:",
                "",
                "| rays | truth RMSE dB | median | 95 % | rays only, median | 95 % | cells "
                "reached |",
                "|---|---|---|---|---|---|---|",
            ]
            for r in found[key]:
                values = [
                    f"{r[k]:.2f}" if k in r else "–"
                    for k in (
                        "truth_rmse_db",
                        "truth_median_db",
                        "truth_p95_db",
                        "rays_median_db",
                        "rays_p95_db",
                    )
                ]
                lines.append(
                    f"| {r['samples'] / 1e6:g} M | {' | '.join(values)} | {100 * r['reached']:.1f} "
                    "% |"
                )
            lines.append("")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds-only", action="store_true", help="leave out the comparisons of noise"
    )
    parser.add_argument(
        "--reference", type=int, default=100_000_000, help="rays of the map taken as converged"
    )
    options = parser.parse_args()
    cities = [manhattan_city(seed) for seed in (1001, 1002)]
    sites = transmitter_sites(cities[0])[:10]
    found: dict[str, Any] = {
        "machine": f"{platform.processor() or platform.machine()}, {platform.system()}",
        "sionna-rt": importlib.metadata.version("sionna-rt"),
    }
    # Compiles the kernels, for one and for ten transmitters.
    for per_call in (1, 10):
        trace_gain_db(
            cities[0], sites, [ALTITUDE_M], samples=10_000, transmitters_per_call=per_call
        )
    found["seconds"] = measure_seconds(cities[0], sites)
    if not options.seconds_only:
        found["seeds"] = measure_seeds(cities[0], sites[:3], [3_000_000, 10_000_000])
        found["reference"] = measure_reference(
            cities, [1_000_000, 3_000_000, 10_000_000, 30_000_000], options.reference
        )
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "ray_tracing.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (RESULTS / "ray_tracing.md").write_text(markdown(found), encoding="utf-8")
    print(markdown(found))


if __name__ == "__main__":
    main()
