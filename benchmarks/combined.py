"""Combined paths at points: the launcher beside Sionna RT's path solver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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
    folder: Path, city: City, site: NDArray[np.float64], xy: NDArray[np.float64], millions: int
) -> NDArray[np.float64]:
    """``[3, point]`` power by the path solver: paths that reflect or diffract, all with up to
    three reflections and one diffraction, and these without the ones that reflect and diffract at
    a roof edge. Solved once and kept."""
    path = folder / f"{city.name}_{len(xy)}_points_{millions}M.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, power=_solve(city, site, xy, millions))
    with np.load(path) as kept:
        return kept["power"]


def _solve(
    city: City, site: NDArray[np.float64], xy: NDArray[np.float64], millions: int
) -> NDArray[np.float64]:
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
        places = paths.vertices.numpy().reshape(4, len(xy), -1, 3)
    edge = kind == rt.constants.InteractionType.DIFFRACTION
    bent = edge.sum(axis=0)
    mirrored = (kind == rt.constants.InteractionType.SPECULAR).sum(axis=0)
    wanted = (bent <= 1) & (mirrored <= 3) & (power > 0)
    # the solver lists some paths twice
    for k in range(len(xy)):
        way = np.where(kind[:, k, :, None] > 0, places[:, k].round(1), 0.0)
        rows = np.concatenate([kind[:, k], *np.moveaxis(way, -1, 0)]).T
        rows[~wanted[k]] = -1
        first = np.unique(rows, axis=0, return_index=True)[1]
        once = np.zeros(len(rows), dtype=bool)
        once[first] = True
        wanted[k] &= once
    tops = np.unique([b.height_m for b in cleared(city).buildings])
    high = np.abs(places[..., 2, None] - tops).min(axis=-1) < 2e-3
    roof = (edge & high).any(axis=0) & (mirrored > 0)
    alone = wanted & ((bent == 0) | (mirrored == 0))
    return np.array([(power * part).sum(axis=1) for part in (alone, wanted, wanted & ~roof)])


def ours(
    city: City, site: NDArray[np.float64], xy: NDArray[np.float64], side_m: float, combined: bool
) -> NDArray[np.float64]:
    """The launcher's mean power in the cells of ``side_m`` that hold the points."""
    side = round(486 / side_m)
    grid = Grid((side, side), side_m, (side_m / 2, side_m / 2))
    fine = City(grid, np.zeros(grid.shape, dtype=np.float32), cleared(city).buildings)
    settings = replace(DEFAULT, combined=combined, wedge="sionna", azimuths=32768, fans=4096)
    gain = launch_gain_db(fine, site, [ALTITUDE_M], settings=settings).gain_db[0, 0]
    col, row = np.floor(xy / side_m).astype(int).T
    return 10 ** (gain[row, col].astype(float) / 10)


@study(
    "combined_paths",
    data="FOLDER",
    cities=Option((1,), "seeds of the cities"),
    points=Option(200, "points of each city"),
    millions=Option((1, 4), "millions of samples of the path solver"),
)
def combined_paths(run: Run) -> list[Table]:
    """The launcher at points against Sionna RT's path solver, with and without combined paths.

    A point is even where the launcher's means over cells of 2 m and of a third of that agree
    within 1 dB, and settled where the two numbers of samples do.
    """
    o = run.options
    found: list[dict[str, NDArray[np.float64]]] = []
    for city, site, name in places(o.cities):
        if not name.endswith("mid"):
            continue
        xy = (chosen(city, o.points)[:, ::-1] + 0.5) * SIDE_M
        here = {}
        for combined in (False, True):
            for part in (1, 3):
                key = (city.name, o.points, SIDE_M / part, combined)
                here[f"{combined}{part}"] = np.array(
                    run.once(key, lambda c=city, s=site, p=xy, m=SIDE_M / part, b=combined: ours(
                        c, s, p, m, b).tolist())
                )  # fmt: skip
        for millions in o.millions:
            here[f"{millions}"] = solved(run.data, city, site, xy, millions)
        found.append(here)

    def joined(key: str) -> NDArray[np.float64]:
        return np.concatenate([here[key] for here in found], axis=-1)

    def apart(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.nan_to_num(np.abs(10 * np.log10(a / b)), nan=0.0, posinf=99.0)

    rows = []
    most, least = max(o.millions), min(o.millions)
    for label, combined, kind in (
        ("one or the other", False, 0),
        ("combined", True, 1),
        ("combined, but for roof edges", True, 2),
    ):
        coarse, fine = joined(f"{combined}1"), joined(f"{combined}3")
        theirs = joined(f"{most}")[kind]
        even = apart(coarse, fine) < 1
        settled = apart(theirs, joined(f"{least}")[kind]) < 1
        for points, chosen_ in (
            ("all", np.ones_like(even)),
            ("even", even),
            ("even and settled", even & settled),
        ):
            mine = np.where(chosen_, fine, 0.0)
            other = np.where(chosen_, theirs, 0.0)
            both = (mine > 0) & (other > 0)
            gap = 10 * np.log10(mine[both] / other[both])
            rows.append(
                [
                    label,
                    points,
                    f"{np.median(np.abs(gap)):.2f}",
                    f"{np.percentile(np.abs(gap), 90):.2f}",
                    f"{gap.mean():+.2f}",
                    f"{int((np.abs(gap) > 6).sum())} of {len(gap)}",
                    f"{int(((mine > 0) & (other <= 0)).sum())}",
                    f"{int(((mine <= 0) & (other > 0)).sum())}",
                ]
            )
    head = ["paths", "points", "median dB", "90 % dB", "mean dB", "> 6 dB"]
    return [
        Table(
            f"Launcher against Sionna RT's path solver ({most} M samples) at points, 10 m, 5 GHz: "
            f"means over cells of {SIDE_M / 3:.2f} m against points in their middle.",
            [*head, "only launcher", "only Sionna"],
            rows,
        )
    ]
