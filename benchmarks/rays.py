"""The ray launcher beside Sionna RT: how far apart, how converged each is, and its cost."""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.launcher import (
    ALTITUDE_M,
    BESIDE,
    COARSE,
    DEFAULT,
    FINE,
    bound,
    cleared,
    compared,
    edge_ratios,
    elsewhere,
    launched,
    places,
    reference,
)
from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.launching.launch import Launching, launch_gain_db


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


def _edges(ratios: list[float]) -> str:
    return (
        f"Of {len(ratios)} edges that dominate 20 cells or more, power over that of Sionna RT's "
        f"finest: {min(ratios):.2f} to {max(ratios):.2f}."
    )


CHEAP = {
    "launcher, 256 azimuths, 1 place": replace(COARSE, azimuths=256),
    "launcher, coarse": COARSE,
    "launcher, default": DEFAULT,
}


def _speed(run: Run) -> list[list[str]]:
    """Rows of the table of costs: Sionna RT by its rays, the launcher by its settings."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for seed in run.options.cities:
        city, site, name = places((seed,))[0]
        clear = cleared(city)
        finest, _ = launched(clear, site, BESIDE)
        finest = bound(city, site, finest)
        for millions in run.options.millions:

            def theirs(m: int = millions) -> dict[str, Any]:
                gain, seconds = reference(run.data, city, site, name, m, True)  # noqa: B023
                return compared(city, site, finest, gain) | {"seconds": seconds}  # noqa: B023

            row = run.once(("speed", name, millions), theirs)
            rows.setdefault(f"Sionna RT, {millions} M rays", []).append(row)
        for label, settings in CHEAP.items():

            def ours(s: Any = settings) -> dict[str, Any]:
                runs = [launched(clear, site, replace(s, wedge="sionna")) for _ in range(3)]  # noqa: B023
                gain = bound(city, site, runs[0][0])  # noqa: B023
                seconds = float(np.median([taken for _, taken in runs]))
                return compared(city, site, finest, gain) | {"seconds": seconds}  # noqa: B023

            rows.setdefault(label, []).append(run.once(("speed", name, label), ours))
    # Sionna RT's error falls with the root of its rays; the launcher's settings are below 1 dB
    last = rows[f"Sionna RT, {max(run.options.millions)} M rays"]
    needed = float(np.mean([r["seconds"] * r["truth_rmse"] ** 2 for r in last]))
    table = []
    for label, found in rows.items():
        seconds, error = mean(found, "seconds"), mean(found, "truth_rmse")
        enough = error <= 1.0 and label in CHEAP
        table.append(
            [
                label,
                f"{seconds:.2f}",
                f"{error:.2f}",
                f"{needed:.0f}" if found is last else f"{seconds:.2f}" if enough else "",
                f"{needed / seconds:.0f} ×" if enough else "",
            ]
        )
    return table


@study(
    "launching_speed",
    data="FOLDER",
    cities=Option((4,), "seeds of cities that nothing was tuned on"),
    millions=Option((10, 30), "millions of rays of the reference"),
)
def launching_speed(run: Run) -> list[Table]:
    """Processor seconds for a truth, launcher and Sionna RT, on cities nothing was tuned on."""
    return [
        Table(
            "Processor seconds of one thread, by the error of the truth against the launcher's "
            "finest. Sionna RT's seconds for 1.0 dB follow from its finest, for its error falls "
            f"with the root of the rays. Cities {', '.join(map(str, run.options.cities))}, 10 m.",
            ["program", "processor s per map", "truth RMSE dB", "s for 1.0 dB", "ratio"],
            _speed(run),
        )
    ]


def _other(run: Run, name: str) -> list[str]:
    """The row of one other city."""
    city, site = elsewhere(name)
    clear, millions = cleared(city), run.options.millions
    found = {}
    for diffraction in (False, True):
        theirs, _ = reference(run.data, city, site, name, millions, diffraction)
        ours, _ = launched(clear, site, replace(BESIDE, diffraction=diffraction))
        found[diffraction] = compared(city, site, bound(city, site, ours), theirs)
    plain, whole = found[False], found[True]
    return [
        name,
        f"{len(city.buildings)}",
        f"{plain['rays_rmse']:.2f}",
        f"{plain['rays_median']:.3f}",
        f"{whole['truth_rmse']:.2f}",
        f"{whole['strong_rmse']:.2f}",
        f"{whole['truth_p95']:.2f}",
        f"{whole['ours_alone']}",
        f"{whole['theirs_alone']} ({whole['theirs_decides']})",
        f"{whole['power']:.4f}",
    ]


@study(
    "launching_elsewhere",
    data="FOLDER",
    cities=Option(("etoile", "town"), "scenes of Sionna RT, or the example's footprints (town)"),
    millions=Option(30, "millions of rays of the reference"),
)
def launching_elsewhere(run: Run) -> list[Table]:
    """The launcher against Sionna RT in cities that no generator made."""
    return [
        Table(
            f"Sionna RT with {run.options.millions} M rays against the launcher, 10 m: part of a "
            "scene of Sionna RT as boxes, and the footprints of the example.",
            ["city", "buildings", "reflections: RMSE dB", "median dB", "truth RMSE dB",
             "above −110 dB", "95 % dB", "only launcher", "only Sionna", "power sum"],
            [
                run.once((name, run.options.millions), lambda n=name: _other(run, n))
                for name in run.options.cities
            ],
        )
    ]  # fmt: skip


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
    kept: dict[Any, Any] = {}

    def once(key: Any, make: Any) -> Any:
        if key not in kept:
            kept[key] = make()
        return kept[key]

    ratios: list[float] = []
    most = max(options.millions)
    for city, site, name in here:
        clear = cleared(city)
        ratios += run.once(
            (name, "edges"),
            lambda c=clear, s=site, n=name: edge_ratios(
                c, s, reference(run.data, c, s, n, most, True)[0]
            ),
        )

        def against(millions: int, diffraction: bool) -> dict[str, Any]:
            theirs, seconds = reference(run.data, city, site, name, millions, diffraction)  # noqa: B023
            beside = replace(BESIDE, diffraction=diffraction)
            ours, _ = once((name, diffraction), lambda: launched(clear, site, beside))  # noqa: B023
            return compared(city, site, bound(city, site, ours), theirs) | {"seconds": seconds}  # noqa: B023

        def itself(settings: Launching) -> dict[str, Any]:
            ours, seconds = launched(city, site, settings)  # noqa: B023
            finest, _ = once(name, lambda: launched(city, site, FINE))  # noqa: B023
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
            "With single diffraction: the truths made of Sionna RT's and of the launcher's map; in "
            "brackets the cells where Sionna RT alone is above the rooftops. "
            f"{maps} {_edges(ratios)}",
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
                    f"{sum(r['theirs_alone'] for r in rows)} "
                    f"({sum(r['theirs_decides'] for r in rows)})",
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
    settings = replace(DEFAULT, wedge="sionna")
    launched(cleared(city), site, replace(settings, azimuths=64))  # compiles
    runs = [launched(cleared(city), site, settings) for _ in range(3)]
    ours, seconds = runs[0][0], float(np.median([taken for _, taken in runs]))
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
                    image, ax=axes[row, :], label=("gain (dB)", "difference (dB)")[row], shrink=0.9
                )
            axes[row, k].set_xlabel("x (m)" if row else "")
            axes[row, k].set_ylabel("" if k else "y (m)")
        axes[0, k].set_title(f"{title}\n{taken:.1f} s of processor", fontsize=10)
        axes[1, k].set_title("minus launcher" if k else "grey: reached by rays", fontsize=10)
        axes[0, k].plot(site[0], site[1], "r*", label="transmitter")
    axes[0, 0].legend(loc="upper left", fontsize=8)
    figure.savefig("docs/images/launching.png", dpi=110)
    return []
