"""Combined paths at points: the launcher beside Sionna RT's path solver."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.launcher import ALTITUDE_M, DEFAULT, cleared, places
from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.city import City
from skygain.grid import Grid
from skygain.propagation.launching.launch import launch_gain_db

SIDE_M = 2.0


def chosen(city: City, count: int) -> NDArray[np.int64]:
    """Random cells of the finer grid whose surroundings are outdoors."""
    rng = np.random.default_rng(5)
    most = round(486 / SIDE_M)
    found: list[tuple[int, int]] = []
    beside = (-0.75 * SIDE_M, 0.75 * SIDE_M)
    while len(found) < count:
        row, col = (int(v) for v in rng.integers(2, most - 2, 2))
        x, y = (col + 0.5) * SIDE_M, (row + 0.5) * SIDE_M
        if not any(b.covers(x + a, y + c) for b in city.buildings for a in beside for c in beside):
            found.append((row, col))
    return np.array(found)


def solved(
    city: City, site: NDArray[np.float64], xy: NDArray[np.float64], millions: int
) -> NDArray[np.float64]:
    """Power at each point by the path solver: single diffraction only, and every path with up to
    three reflections and one diffraction."""
    from skygain.propagation import sionna

    rt = sionna.load_backend()
    import mitsuba

    origin = np.array([243.0, 243.0, 0.0])
    scene = sionna._scene(rt, city, ALTITUDE_M, site[None], origin, sionna.RayTracing())
    scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="VH")
    sionna._place(rt, scene, (site - origin)[None])
    for k, (x, y) in enumerate(xy - origin[:2]):
        position = mitsuba.Point3f(float(x), float(y), ALTITUDE_M)
        scene.add(rt.Receiver(f"receiver-{k}", position=position))
    with sionna._threads(1):
        paths = rt.PathSolver()(
            scene,
            max_depth=4,
            max_num_paths_per_src=4_000_000,
            samples_per_src=millions * 1_000_000,
            refraction=False,
            diffraction=True,
            seed=1,
        )
        power = (paths.a[0].numpy() ** 2 + paths.a[1].numpy() ** 2).sum(axis=(1, 2, 3))
        kind = paths.interactions.numpy().reshape(4, len(xy), -1)
    bent = (kind == rt.constants.InteractionType.DIFFRACTION).sum(axis=0)
    mirrored = (kind == rt.constants.InteractionType.SPECULAR).sum(axis=0)
    wanted = (bent <= 1) & (mirrored <= 3)
    alone = wanted & ((bent == 0) | (mirrored == 0))
    return np.array([(power * alone).sum(axis=1), (power * wanted).sum(axis=1)])


@study(
    "combined_paths",
    cities=Option((1,), "seeds of the cities"),
    points=Option(100, "points of each city"),
    millions=Option((1, 4), "millions of samples of the path solver"),
)
def combined_paths(run: Run) -> list[Table]:
    """The launcher at points against Sionna RT's path solver, with and without combined paths."""
    o = run.options
    rows = []
    here = [(city, site) for city, site, name in places(o.cities) if name.endswith("mid")]

    def ours(city: City, site: NDArray[np.float64], combined: bool) -> dict[str, object]:
        side = round(486 / SIDE_M)
        grid = Grid((side, side), SIDE_M, (SIDE_M / 2, SIDE_M / 2))
        fine = City(grid, np.zeros(grid.shape, dtype=np.float32), cleared(city).buildings)
        start = time.process_time()
        settings = replace(DEFAULT, combined=combined, wedge="sionna")
        gain = launch_gain_db(fine, site, [ALTITUDE_M], settings=settings).gain_db[0, 0]
        cells = chosen(city, o.points)
        power = 10 ** (gain[cells[:, 0], cells[:, 1]].astype(float) / 10)
        return {"power": power, "seconds": time.process_time() - start}

    for millions in o.millions:
        gaps: dict[bool, list[NDArray[np.float64]]] = {False: [], True: []}
        alone = {False: [0, 0], True: [0, 0]}
        for city, site in here:
            cells = chosen(city, o.points)
            xy = (cells[:, ::-1] + 0.5) * SIDE_M
            key = (city.name, o.points, millions)
            theirs = np.array(
                run.once(key, lambda c=city, s=site, p=xy, m=millions: solved(c, s, p, m))
            )
            for combined in (False, True):
                key = (city.name, o.points, "ours", combined)
                mine = np.array(
                    run.once(key, lambda c=city, s=site, b=combined: ours(c, s, b))["power"]
                )
                other = theirs[int(combined)]
                both = (mine > 0) & (other > 0)
                gaps[combined].append(10 * np.log10(mine[both] / other[both]))
                alone[combined][0] += int(((mine > 0) & (other <= 0)).sum())
                alone[combined][1] += int(((mine <= 0) & (other > 0)).sum())
        for combined, found in gaps.items():
            gap = np.concatenate(found)
            rows.append(
                [
                    f"{millions} M samples",
                    "combined" if combined else "one or the other",
                    f"{np.median(np.abs(gap)):.2f}",
                    f"{np.percentile(np.abs(gap), 90):.2f}",
                    f"{gap.mean():+.2f}",
                    f"{int((np.abs(gap) > 6).sum())} of {len(gap)}",
                    f"{alone[combined][0]}",
                    f"{alone[combined][1]}",
                ]
            )
    head = ["path solver with", "paths", "median dB", "90 % dB", "mean dB", "> 6 dB"]
    return [
        Table(
            "Launcher against Sionna RT's path solver at points, 10 m, 5 GHz: means over cells of "
            f"{SIDE_M:g} m against points in their middle.",
            [*head, "only launcher", "only Sionna"],
            rows,
        )
    ]
