"""What the studies of the ray launcher share: places, maps of both programs, differences."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.cities import open_city
from skygain.cities.manhattan import manhattan_city, transmitter_sites
from skygain.city import City
from skygain.propagation.base import wavelength_m
from skygain.propagation.diffraction import free_space_gain_db, over_rooftop_gain_db
from skygain.propagation.launching.antenna import Antenna
from skygain.propagation.launching.corners import edge_windows
from skygain.propagation.launching.geometry import city_geometry
from skygain.propagation.launching.launch import Launching, _Launch, launch_gain_db
from skygain.propagation.launching.materials import (
    GROUND_THICKNESS_M,
    WALL_THICKNESS_M,
    slab_table,
)
from skygain.propagation.launching.sight import edge_rows
from skygain.propagation.mesh import city_buildings, clear_of_plane

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


def each_edge(city: City, site: NDArray[np.float64], settings: Launching) -> list[Map]:
    """The power ``[row, col]`` that each diffracting edge brings alone."""
    buildings = city_buildings(city)
    kinds = sorted({b.material for b in buildings} | {"concrete"})
    geometry = city_geometry(city, buildings, [kinds.index(b.material) for b in buildings])
    thickness = [WALL_THICKNESS_M] * len(kinds) + [GROUND_THICKNESS_M]
    slabs = slab_table([*kinds, settings.ground], thickness, settings.frequency_hz)
    altitudes = np.array([ALTITUDE_M])
    job = _Launch(city, geometry, altitudes, settings, Antenna(), slabs)
    edges, seen = geometry.edges, np.asarray(site, dtype=float)
    windows, found = edge_windows(
        seen, edges.origin_m, edges.along, edges.length_m, edges.normals, job._world
    )
    scale = (wavelength_m(settings.frequency_hz) / (4 * np.pi)) ** 2
    rows = edge_rows(seen, edges, windows, found)
    return [
        scale * job._edge_power(rows[number : number + 1], altitudes)[0]
        for number in np.flatnonzero(found)
    ]


def edge_ratios(city: City, site: NDArray[np.float64], theirs: Map) -> list[float]:
    """Launcher over reference: power in the cells of each edge that dominates 20 or more."""
    rays, _ = launched(city, site, replace(BESIDE, diffraction=False))
    edges = each_edge(city, site, BESIDE)
    total = 10 ** (rays / 10) + sum(edges)
    outdoor = ~city.obstructed(ALTITUDE_M)
    power = 10 ** (theirs / 10)
    found = []
    for edge in edges:
        cells = outdoor & (edge > 0.9 * total)
        if cells.sum() >= 20:
            found.append(float(total[cells].sum() / power[cells].sum()))
    return found


def elsewhere(name: str) -> tuple[City, NDArray[np.float64]]:
    """400 m of a scene of Sionna RT as boxes, or a town of footprints; a site near the middle."""
    if name == "town":
        city = open_city("examples/data/buildings.geojson")
    else:
        city = open_city(name, box=(-200.0, -200.0, 200.0, 200.0))
        city = City(city.grid, city.height_m, city_buildings(city), name)
    west, south, east, north = city.grid.bounds_m
    free = np.argwhere((city.height_m == 0) & ~city.obstructed(ALTITUDE_M))
    x, y = city.grid.xy_m(free).T
    nearest = int(np.argmin(np.hypot(x - (west + east) / 2, y - (south + north) / 2)))
    return city, np.array([x[nearest], y[nearest], 1.5])


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
    rays = ours[mine & other] - theirs[mine & other]
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
        "theirs_decides": int((other & ~mine & (theirs > roof)).sum()),
        "power": power[0] / power[1],
    }
