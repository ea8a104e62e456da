"""Combined paths at points: the launcher beside Sionna RT's path solver."""

from __future__ import annotations

from dataclasses import asdict, astuple, dataclass, replace
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
CELL_M = 0.5
SAME_M = 0.3
"""two paths whose interactions are nearer than this are one"""


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


@dataclass(frozen=True)
class Paths:
    """Paths with up to three reflections and one diffraction, of all points."""

    point: NDArray[np.int64]
    """``[path]`` number of the point"""
    power: NDArray[np.float64]
    """``[path]`` |a|² of both polarisations of the receiver"""
    kind: NDArray[np.int64]
    """``[path, interaction]`` 0 none, 1 reflection, 2 diffraction"""
    places: NDArray[np.float64]
    """``[path, interaction, (x, y, z)]``"""

    def united(self, other: Paths) -> Paths:
        """The paths of either, each once."""
        both = [np.concatenate(pair) for pair in zip(astuple(self), astuple(other), strict=True)]
        return Paths(*both).once()

    def once(self) -> Paths:
        """Without what the solver lists twice: the same interactions within a hand's breadth."""
        kept = np.ones(len(self.point), dtype=bool)
        places = np.where(self.kind[..., None] > 0, self.places, 0.0)
        for number in np.unique(self.point):
            here = np.flatnonzero(self.point == number)
            same = (self.kind[here, None] == self.kind[None, here]).all(axis=-1)
            same &= np.abs(places[here, None] - places[None, here]).max(axis=(-2, -1)) < SAME_M
            kept[here[np.tril(same, -1).any(axis=1)]] = False
        return Paths(*(part[kept] for part in astuple(self)))

    def powers(self, chosen: NDArray[np.bool_], points: int) -> NDArray[np.float64]:
        """``[point]`` sum of the power of the chosen paths."""
        return np.bincount(self.point, self.power * chosen, minlength=points)


def solved(
    folder: Path, city: City, site: NDArray[np.float64], xy: NDArray[np.float64], run: str
) -> Paths:
    """What the path solver finds with a number of samples and a seed ("4M1"), solved once and
    kept."""
    path = folder / f"{city.name}_{len(xy)}_paths_{run}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        millions, seed = (int(part) for part in run.split("M"))
        np.savez(path, **asdict(_solve(city, site, xy, millions, seed)))
    with np.load(path) as kept:
        return Paths(**{name: kept[name] for name in Paths.__dataclass_fields__}).once()


def _solve(
    city: City, site: NDArray[np.float64], xy: NDArray[np.float64], millions: int, seed: int
) -> Paths:
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
            seed=seed,
        )
        power = (paths.a[0].numpy() ** 2 + paths.a[1].numpy() ** 2).sum(axis=(1, 2, 3))
        met = paths.interactions.numpy().reshape(4, len(xy), -1)
        places = paths.vertices.numpy().reshape(4, len(xy), -1, 3)
    bent = met == rt.constants.InteractionType.DIFFRACTION
    mirrored = met == rt.constants.InteractionType.SPECULAR
    wanted = (bent.sum(axis=0) <= 1) & (mirrored.sum(axis=0) <= 3) & (power > 0)
    point, which = np.nonzero(wanted)
    return Paths(
        point,
        power[point, which].astype(float),
        (2 * bent + mirrored)[:, point, which].T.astype(np.int64),
        np.moveaxis(places[:, point, which], 0, 1) + origin,
    )


def ours(
    city: City, site: NDArray[np.float64], xy: NDArray[np.float64], combined: bool
) -> NDArray[np.float64]:
    """``[4, point]`` the launcher's mean power in the four small cells that meet at a point."""
    side = round(486 / CELL_M)
    grid = Grid((side, side), CELL_M, (CELL_M / 2, CELL_M / 2))
    fine = City(grid, np.zeros(grid.shape, dtype=np.float32), cleared(city).buildings)
    settings = replace(DEFAULT, combined=combined, wedge="sionna", azimuths=16384, fans=4096)
    gain = launch_gain_db(fine, site, [ALTITUDE_M], settings=settings).gain_db[0, 0]
    col, row = np.round(xy / CELL_M).astype(int).T
    quarters = [gain[row - a, col - b] for a in (0, 1) for b in (0, 1)]
    return 10 ** (np.array(quarters, dtype=float) / 10)


@study(
    "combined_paths",
    data="FOLDER",
    cities=Option((1,), "seeds of the cities"),
    points=Option(200, "points of each city"),
    runs=Option(("4M1", "1M1", "1M2"), "runs of the path solver: millions of samples, M, seed"),
)
def combined_paths(run: Run) -> list[Table]:
    """The launcher at points against Sionna RT's path solver, with and without combined paths.

    The paths of all runs of the solver are put together. A point is even where the four cells
    that meet in it are within 1 dB, and settled where the first run found all but 1 dB.
    """
    o = run.options
    parts: list[dict[str, NDArray[np.float64]]] = []
    for city, site, name in places(o.cities):
        if not name.endswith("mid"):
            continue
        xy = (chosen(city, o.points)[:, ::-1] + 0.5) * SIDE_M
        here = {
            f"ours {b}": np.array(
                run.once(
                    (city.name, o.points, CELL_M, b),
                    lambda c=city, s=site, p=xy, b=b: ours(c, s, p, b).tolist(),
                )
            )
            for b in (False, True)
        }
        first = solved(run.data, city, site, xy, o.runs[0])
        every = first
        for more in o.runs[1:]:
            every = every.united(solved(run.data, city, site, xy, more))
        tops = np.unique([b.height_m for b in cleared(city).buildings])
        for label, found in (("first", first), ("all", every)):
            bent, mirrored = (found.kind == 2).any(axis=1), (found.kind == 1).any(axis=1)
            height = np.where(found.kind == 2, found.places[..., 2], np.inf)
            roof = (np.abs(height[..., None] - tops) < 2e-3).any(axis=(1, 2))
            alone = ~bent | ~mirrored
            for kind, chosen_ in (
                ("one", alone), ("both", np.ones_like(bent)), ("not roof", alone | ~roof)
            ):  # fmt: skip
                here[f"{label} {kind}"] = found.powers(chosen_, len(xy))
        parts.append(here)

    def joined(key: str) -> NDArray[np.float64]:
        return np.concatenate([here[key] for here in parts], axis=-1)

    rows = []
    for title, combined, kind in (
        ("one or the other", False, "one"),
        ("combined", True, "both"),
        ("combined, but for roof edges", True, "not roof"),
    ):
        quarters, theirs = joined(f"ours {combined}"), joined(f"all {kind}")
        mine = quarters.mean(axis=0)
        even = quarters.max(axis=0) <= 10**0.1 * quarters.min(axis=0)
        settled = theirs <= 10**0.1 * joined(f"first {kind}")
        for points, kept in (
            ("all", np.ones_like(even)), ("even", even), ("even and settled", even & settled)
        ):  # fmt: skip
            rows.append([title, points, *_row(mine[kept], theirs[kept])])
    quarters = joined("ours True")
    mine, whole, walls = quarters.mean(axis=0), joined("all both"), joined("all not roof")
    uneven = quarters.max(axis=0) > 10**0.1 * quarters.min(axis=0)
    unsettled = whole > 10**0.1 * joined("first both")
    left = _apart(mine, whole) > 6
    causes = []
    for cause, here_ in (
        ("a roof edge with reflections, which only Sionna RT has", _apart(mine, walls) <= 6),
        ("a boundary of light within half a metre of the point", uneven),
        ("paths that one run of the solver missed", unsettled),
        ("other", np.ones_like(left)),
    ):
        level = 10 * np.log10(np.maximum(mine, whole)[left & here_])
        median = f"{np.median(level):.0f}" if len(level) else ""
        causes.append([cause, f"{int((left & here_).sum())}", median])
        left = left & ~here_
    return [
        Table(
            "Launcher against Sionna RT's path solver "
            f"({' and '.join(o.runs)}: millions of samples and seed, put together) at points, "
            f"10 m, 5 GHz: means over {2 * CELL_M:g} m around a point against the point.",
            ["paths", "points", "median dB", "90 % dB", "mean dB", "> 6 dB", "only launcher",
             "only Sionna"],
            rows,
        ),
        Table(
            "Where combined paths are more than 6 dB apart or only one program has any: the first "
            "cause that a point has, and the median of the stronger gains.",
            ["cause", "points", "gain dB"],
            causes,
        ),
    ]  # fmt: skip


def _apart(mine: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """|difference| in dB; 0 where neither has any power, large where one has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.abs(10 * np.log10(mine / theirs)), nan=0.0, posinf=999.0)


def _row(mine: NDArray[np.float64], theirs: NDArray[np.float64]) -> list[str]:
    """Differences in dB at points that both reach, and how many only one reaches."""
    both = (mine > 0) & (theirs > 0)
    gap = 10 * np.log10(mine[both] / theirs[both])
    size = np.abs(gap)
    return [
        f"{np.median(size):.2f}",
        f"{np.percentile(size, 90):.2f}",
        f"{gap.mean():+.2f}",
        f"{int((size > 6).sum())} of {len(gap)}",
        f"{int(((mine > 0) & (theirs <= 0)).sum())}",
        f"{int(((mine <= 0) & (theirs > 0)).sum())}",
    ]
