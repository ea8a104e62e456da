"""The ray launcher beside Sionna RT: how far apart, how converged each is, and its cost."""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
from skygain.city import City
from skygain.propagation.diffraction import free_space_gain_db, over_rooftop_gain_db
from skygain.propagation.launching.launch import Launching, launch_gain_db
from skygain.propagation.mesh import clear_of_plane

ALTITUDE_M = 10.0
DEFAULT = Launching()
FINE = replace(DEFAULT, azimuths=4 * DEFAULT.azimuths, points=4 * DEFAULT.points)
COARSE = replace(DEFAULT, azimuths=2048, points=1)
BESIDE = replace(FINE, wedge="sionna")
"""what stands beside Sionna RT's maps: its weights of the reflections at an edge"""

Map = NDArray[np.float64]


def places(cities: tuple[int, ...]) -> list[tuple[City, NDArray[np.float64], str]]:
    """Of each city the site nearest the middle and the fourth, unless they are one."""
    found = []
    for seed in cities:
        city = manhattan_city(seed)
        sites = transmitter_sites(city)
        west, south, east, north = city.grid.bounds_m
        away = np.hypot(sites[:, 0] - (west + east) / 2, sites[:, 1] - (south + north) / 2)
        middle = int(np.argmin(away))
        found.append((city, sites[middle], f"{seed}_mid"))
        if middle != 3:
            found.append((city, sites[3], f"{seed}_3"))
    return found


def cleared(city: City) -> City:
    """The city with roofs as far from the plane as the reference has to have them."""
    from skygain.propagation.sionna import _clearance_m

    buildings = clear_of_plane(city.buildings, ALTITUDE_M, _clearance_m(city))
    return City(city.grid, city.height_m, buildings, city.name)


def reference(
    folder: Path, city: City, site: NDArray[np.float64], name: str, millions: int, diffraction: bool
) -> tuple[Map, float]:
    """Sionna's gain ``[row, col]`` and its processor seconds, traced once and kept."""
    kind = "full" if diffraction else "refl"
    path = folder / f"{name}_{millions}M_{kind}.npz"
    if not path.exists():
        from skygain.propagation.sionna import trace_gain_db

        start = time.process_time()
        traced = trace_gain_db(
            city, site, [ALTITUDE_M], samples=millions * 1_000_000, diffraction=diffraction
        )
        folder.mkdir(parents=True, exist_ok=True)
        seconds = time.process_time() - start
        np.savez(path, gain=traced.gain_db[0, 0], cpu=seconds)
    with np.load(path) as kept:
        return kept["gain"].astype(float), float(kept["cpu"])


def launched(city: City, site: NDArray[np.float64], settings: Launching) -> tuple[Map, float]:
    """The launcher's gain ``[row, col]`` and its processor seconds."""
    start = time.process_time()
    gain = launch_gain_db(city, site, [ALTITUDE_M], settings=settings).gain_db[0, 0]
    return gain.astype(float), time.process_time() - start


def bound(city: City, site: NDArray[np.float64], gain: Map) -> Map:
    """The gain cut at 6 dB over free space, as the reference's is."""
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    away = np.sqrt((x - site[0]) ** 2 + (y - site[1]) ** 2 + (ALTITUDE_M - site[2]) ** 2)
    return np.minimum(gain, free_space_gain_db(away) + 6.0)


def compared(city: City, site: NDArray[np.float64], ours: Map, theirs: Map) -> dict[str, float]:
    """How far apart two maps of rays are, and the truths made of them."""
    outdoor = ~city.obstructed(ALTITUDE_M)
    roof = over_rooftop_gain_db(city, site, [ALTITUDE_M])[0, 0]
    mine, other = np.isfinite(ours) & outdoor, np.isfinite(theirs) & outdoor
    rays = (ours - theirs)[mine & other]
    truth = (np.maximum(ours, roof) - np.maximum(theirs, roof))[outdoor]
    strong = np.maximum(np.maximum(ours, theirs), roof)[outdoor] > -110
    power = [float((10 ** (g[outdoor] / 10)).sum()) for g in (ours, theirs)]
    return {
        "rays_rmse": float(np.sqrt((rays**2).mean())),
        "rays_median": float(np.median(np.abs(rays))),
        "rays_p95": float(np.percentile(np.abs(rays), 95)),
        "truth_rmse": float(np.sqrt((truth**2).mean())),
        "truth_p95": float(np.percentile(np.abs(truth), 95)),
        "strong_rmse": float(np.sqrt((truth[strong] ** 2).mean())),
        "ours_alone": int((mine & ~other).sum()),
        "theirs_alone": int((other & ~mine).sum()),
        "power": power[0] / power[1],
    }


def grown(side: int) -> dict[str, float]:
    """One map of ``side`` × ``side`` cells with some five buildings in a thousand cells."""
    config = ManhattanConfig(extent_m=4.0 * side, blocks=max(1, round(side / 24.5)))
    city = manhattan_city(1, config)
    sites = transmitter_sites(city)
    start = time.process_time()
    launch_gain_db(city, sites[len(sites) // 2], [ALTITUDE_M])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return {
        "buildings": len(city.buildings),
        "seconds": time.process_time() - start,
        "gigabytes": peak,
    }


def mean(rows: list[dict[str, float]], key: str) -> float:
    """Mean of a number over maps."""
    return float(np.mean([row[key] for row in rows]))


def worst(rows: list[dict[str, Any]]) -> float:
    """The largest error of a truth."""
    return max(row["truth_rmse"] for row in rows)


@study(
    "launching",
    data="FOLDER",
    cities=Option((1, 2, 3), "seeds of the cities"),
    millions=Option((3, 10, 100), "millions of rays of the reference"),
    sides=Option((125, 250, 500, 1000), "sides of the maps that grow, in cells"),
)
def launching(run: Run) -> list[Table]:
    """The launcher against Sionna RT, against itself, and what it costs.

    Maps of Sionna RT are kept in FOLDER and traced, where they are missing, by one thread.
    """
    options = run.options
    here = places(options.cities)
    launched(here[0][0], here[0][1], replace(COARSE, azimuths=64))  # compiles
    reflections: dict[str, list[dict[str, Any]]] = {}
    whole: dict[str, list[dict[str, Any]]] = {}
    own: dict[str, list[dict[str, Any]]] = {}
    for city, site, name in here:
        clear = cleared(city)

        def against(millions: int, diffraction: bool) -> dict[str, Any]:
            theirs, seconds = reference(run.data, city, site, name, millions, diffraction)  # noqa: B023
            ours, _ = launched(clear, site, replace(BESIDE, diffraction=diffraction))  # noqa: B023
            return compared(city, site, bound(city, site, ours), theirs) | {"seconds": seconds}  # noqa: B023

        def itself(settings: Launching) -> dict[str, Any]:
            ours, seconds = launched(city, site, settings)  # noqa: B023
            finest, _ = launched(city, site, FINE)  # noqa: B023
            return compared(city, site, ours, finest) | {"seconds": seconds}  # noqa: B023

        def three() -> float:
            start = time.process_time()
            launch_gain_db(city, site, [10.0, 20.0, 30.0])  # noqa: B023
            return time.process_time() - start

        for millions in options.millions:
            label = f"{millions} M rays"
            ask: list[tuple[dict[str, list[dict[str, Any]]], bool]]
            ask = [(reflections, False), (whole, True)]
            for table, diffraction in ask:
                key = (name, millions, diffraction)
                row = run.once(key, lambda m=millions, d=diffraction: against(m, d))
                table.setdefault(label, []).append(row)
        for label, settings in (("coarse", COARSE), ("default", DEFAULT)):
            row = run.once((name, label), lambda s=settings: itself(s))
            if label == "default":
                row |= {"three": run.once((name, "three"), three)}
            own.setdefault(label, []).append(row)
    grow = [run.once(("grown", side), lambda s=side: grown(s)) for side in options.sides]
    maps = f"Mean of {len(here)} maps of Manhattan cities, 10 m, 5 GHz."
    return [
        Table(
            f"Reflections only, Sionna RT against the launcher. {maps} Beside the means, the sums "
            "of cells that only one of them reaches.",
            ["Sionna RT with", "RMSE dB", "median dB", "95 % dB", "only launcher", "only Sionna",
             "power sum"],
            [
                [
                    label,
                    f"{mean(rows, 'rays_rmse'):.2f}",
                    f"{mean(rows, 'rays_median'):.3f}",
                    f"{mean(rows, 'rays_p95'):.2f}",
                    f"{sum(r['ours_alone'] for r in rows)}",
                    f"{sum(r['theirs_alone'] for r in rows)}",
                    f"{mean(rows, 'power'):.4f}",
                ]
                for label, rows in reflections.items()
            ],
        ),
        Table(
            f"With single diffraction: the truths made of Sionna RT's and of the launcher's map. "
            f"{maps}",
            ["Sionna RT with", "processor s per map", "truth RMSE dB", "worst map dB",
             "above −110 dB", "95 % dB", "only launcher", "only Sionna", "power sum"],
            [
                [
                    label,
                    f"{mean(rows, 'seconds'):.1f}",
                    f"{mean(rows, 'truth_rmse'):.2f}",
                    f"{worst(rows):.2f}",
                    f"{mean(rows, 'strong_rmse'):.2f}",
                    f"{mean(rows, 'truth_p95'):.2f}",
                    f"{sum(r['ours_alone'] for r in rows)}",
                    f"{sum(r['theirs_alone'] for r in rows)}",
                    f"{mean(rows, 'power'):.4f}",
                ]
                for label, rows in whole.items()
            ],
        ),
        Table(
            "The launcher against itself with four times the azimuths and four times the places "
            f"along a cell. {maps}",
            ["launcher", "processor s per map", "three altitudes", "truth RMSE dB",
             "worst map dB", "95 % dB"],
            [
                [
                    label,
                    f"{mean(rows, 'seconds'):.2f}",
                    f"{np.mean([r['three'] / r['seconds'] for r in rows]):.2f} ×"
                    if "three" in rows[0]
                    else "",
                    f"{mean(rows, 'truth_rmse'):.2f}",
                    f"{worst(rows):.2f}",
                    f"{mean(rows, 'truth_p95'):.2f}",
                ]
                for label, rows in own.items()
            ],
        ),
        Table(
            "Growth: one map at 10 m by one thread.",
            ["cells", "buildings", "processor s", "largest memory GB"],
            [
                [
                    f"{side} × {side}",
                    f"{row['buildings']:.0f}",
                    f"{row['seconds']:.1f}",
                    f"{row['gigabytes']:.2f}",
                ]
                for side, row in zip(options.sides, grow, strict=True)
            ],
        ),
    ]  # fmt: skip


@study("launching_picture", data="FOLDER")
def launching_picture(run: Run) -> list[Table]:
    """Draw one truth by the launcher and by Sionna RT, and their differences."""
    from matplotlib import pyplot as plt

    city, site, name = places((2,))[0]
    outdoor = ~city.obstructed(ALTITUDE_M)
    roof = over_rooftop_gain_db(city, site, [ALTITUDE_M])[0, 0]
    ours, seconds = launched(cleared(city), site, replace(DEFAULT, wedge="sionna"))
    maps = [("launcher", ours, seconds)]
    for millions in (3, 10, 100):
        maps.append(
            (
                f"Sionna RT, {millions} M rays",
                *reference(run.data, city, site, name, millions, True),
            )
        )
    figure, axes = plt.subplots(
        2, 4, figsize=(13, 6.6), layout="constrained", sharex=True, sharey=True
    )
    west, south, east, north = city.grid.bounds_m
    for k, (title, gain, taken) in enumerate(maps):
        truth = np.where(outdoor, np.maximum(gain, roof), np.nan)
        shown = [(truth, "viridis", -170, -60)]
        mine = np.where(outdoor, np.maximum(ours, roof), np.nan)
        shown.append(
            (
                truth - mine if k else np.isfinite(ours) * np.where(outdoor, 1.0, np.nan),
                "RdBu_r" if k else "Greys",
                -20 if k else 0,
                20 if k else 2,
            )
        )
        for row, (values, colours, low, high) in enumerate(shown):
            image = axes[row, k].imshow(
                values,
                origin="lower",
                extent=(west, east, south, north),
                cmap=colours,
                vmin=low,
                vmax=high,
            )
            if k == 3:
                figure.colorbar(
                    image, ax=axes[row, :], label=("gain dB", "difference dB")[row], shrink=0.9
                )
        axes[0, k].set_title(f"{title}, {taken:.1f} s", fontsize=10)
        axes[1, k].set_title("minus launcher" if k else "grey: reached by rays", fontsize=10)
        axes[0, k].plot(site[0], site[1], "r*")
    figure.savefig("docs/images/launching.png", dpi=110)
    return []
