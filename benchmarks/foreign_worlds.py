"""Worlds that no network was trained on, each drawn by its name and a number.

A world is a window of 96 × 96 cells of 4 m with one transmitter. What takes long to trace is kept
in the user's cache.
"""

from __future__ import annotations

__all__ = ["MAPS", "WORLDS", "ForeignWorld", "drawn"]

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.unseen import ALTITUDE_M, INNER, MARGIN, SIDE, SPACING_M, drawn_window
from skygain.cities.scenes import scene_city
from skygain.city import City
from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.grid import Grid
from skygain.networks.weights import runs_folder
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.gudmundson import gudmundson_gain_db
from skygain.propagation.launching.antenna import Antenna, sector_gain_dbi
from skygain.propagation.launching.launch import launch_gain_db
from skygain.propagation.sionna import trace_gain_db
from skygain.propagation.truth import trace_truth
from skygain.scenario import Scenario

RAYS = 30_000_000
"""of Sionna RT, for one transmitter"""
MISSING = 0.3
"""share of the buildings that the map lacks"""
MAST_M, EIRP_DBM, TILT_DEG = 25.0, 37.0, 6.0
"""of the sector antenna"""
SCENES = ("munich", "etoile", "florence", "san_francisco")


@dataclass(frozen=True, eq=False)
class ForeignWorld:
    """What is surveyed, and what is believed of it beforehand."""

    scenario: Scenario
    """with the map as the predictor has it; real walls that it lacks are no-fly cells"""
    truth_db: NDArray[np.float32]
    """``[row, col]`` gain in dB, or level in dBm"""
    level: str
    """``"gain"``, or ``"power"`` where the radiated power is not known"""


def _kept(name: str, make: Callable[[], dict[str, NDArray]]) -> dict[str, NDArray]:
    path = runs_folder().parent / "foreign" / f"{name}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **make())
    with np.load(path) as found:
        return dict(found)


@cache
def _scene(name: str) -> City:
    return scene_city(name, spacing_m=SPACING_M)


def _window(scene: str, number: int) -> tuple[City, NDArray[np.float64]]:
    """A window of a scene in the scene's own metres, and a transmitter on open ground in it or up
    to 104 m outside."""
    whole = _scene(scene)
    height, corner, cell = drawn_window(whole, np.random.default_rng([number, len(scene)]))
    x, y = whole.grid.xy_m(corner)
    grid = Grid(height.shape, SPACING_M, (float(x), float(y)))
    city = City(grid, height, name=f"scene:{scene}")
    tx, ty = grid.xy_m(cell)
    return city, np.array([float(tx), float(ty), 1.5])


def _scene_world(scene: str, number: int, rays: bool) -> ForeignWorld:
    def make() -> dict[str, NDArray]:
        city, transmitter = _window(scene, number)
        if rays:
            traced = trace_gain_db(city, [transmitter], [ALTITUDE_M], samples=RAYS, seed=number)
            roof = over_rooftop_gain_db(city, [transmitter], [ALTITUDE_M])
            gain = np.maximum(traced.gain_db, roof)
        else:
            gain = trace_truth(replace(city, name=scene), [transmitter], [ALTITUDE_M]).gain_db
        corner = np.array([*city.grid.xy_m((MARGIN, MARGIN)), 0.0])
        return {
            "height_m": city.height_m[INNER],
            "gain_db": gain[0, 0][INNER],
            "transmitter_m": transmitter - corner,
        }

    found = _kept(f"{scene}-{'rt' if rays else 'launched'}-{number}", make)
    city = City(Grid((SIDE, SIDE), SPACING_M), found["height_m"], name=scene)
    return ForeignWorld(_scenario(city, found["transmitter_m"]), found["gain_db"], "gain")


def _scenario(city: City, transmitter_m: NDArray[np.float64], **others: object) -> Scenario:
    x, y, z = (float(v) for v in transmitter_m)
    return Scenario(
        city,
        uav_altitude_m=ALTITUDE_M,
        prediction_altitude_m=ALTITUDE_M,
        transmitter_m=(x, y, z),
        **others,  # type: ignore[arg-type]
    )


@cache
def _cases(data: Path, split: str) -> list[Case]:
    return survey_cases(ChannelDataset.open(data), split, max_surveys=24)


def _home(case: Case, number: int) -> ForeignWorld:
    return ForeignWorld(case.scenario(), case.truth_db, "gain")


def _missing(case: Case, number: int) -> ForeignWorld:
    """Buildings are lacking whole."""
    real, rng = case.scenario(), np.random.default_rng([number, 3])
    height = np.array(real.city.height_m)
    parts, count = ndimage.label(height > 0)
    lacking = 1 + np.flatnonzero(rng.random(count) < MISSING)
    height[np.isin(parts, lacking)] = 0.0
    city = City(real.grid, height, name=f"{real.city.name}, buildings missing")
    scenario = replace(real, city=city, no_fly=~real.flyable, wanted=real.outdoor)
    return ForeignWorld(scenario, case.truth_db, "gain")


def _sector(case: Case, number: int) -> ForeignWorld:
    """A sector antenna on a mast on open ground, and readings in dBm."""
    city, rng = case.crop.city, np.random.default_rng([number, 4])
    open_cells = np.argwhere(city.height_m <= 0)
    x, y = city.grid.xy_m(open_cells[rng.integers(len(open_cells))])
    at = np.array([float(x), float(y), MAST_M])
    azimuth_deg = float(rng.uniform(0, 360))
    pattern = sector_gain_dbi(tilt_deg=TILT_DEG)

    def make() -> dict[str, NDArray]:
        antenna = Antenna(gain_dbi=pattern, azimuth_deg=azimuth_deg)
        rays = launch_gain_db(city, [at], [ALTITUDE_M], antenna=antenna)
        roof = over_rooftop_gain_db(city, [at], [ALTITUDE_M])[0, 0]
        east, north = (
            city.grid.xy_m(city.grid.cells).T.reshape(2, *city.grid.shape) - at[:2, None, None]
        )
        angle = np.rint(np.degrees(np.arctan2(north, east)) - azimuth_deg).astype(int) % 360
        down = np.degrees(np.arctan2(ALTITUDE_M - MAST_M, np.hypot(east, north)))
        turned = roof + pattern[angle, np.rint(down).astype(int) + 90]
        return {"gain_db": np.maximum(rays.gain_db[0, 0], turned)}

    found = _kept(f"sector-{case.link}-{number}", make)["gain_db"]
    return ForeignWorld(_scenario(city, at), found + EIRP_DBM, "power")


def _field(case: Case, number: int) -> ForeignWorld:
    scenario, rng = case.scenario(), np.random.default_rng([number, 5])
    gain = gudmundson_gain_db(scenario.grid, scenario.transmitter_m, ALTITUDE_M, rng)
    return ForeignWorld(scenario, gain.astype(np.float32), "gain")


AT_HOME: dict[str, Callable[[Case, int], ForeignWorld]] = {
    "home": _home,
    "buildings missing": _missing,
    "sector, dBm": _sector,
    "gudmundson": _field,
}
"""kinds of worlds made of a survey case of the data set"""
WORLDS = (
    *(f"{scene}, {how}" for how in ("launched", "Sionna RT") for scene in SCENES),
    *AT_HOME,
)
"""names of all kinds"""
MAPS = {"buildings missing": "wrong", "gudmundson": "of no use"}
"""of what worth the predictor's map is, where it is not right"""


def drawn(name: str, data: Path, split: str, number: int) -> ForeignWorld:
    """World ``number`` of a kind."""
    if name in AT_HOME:
        return AT_HOME[name](_cases(data, split)[number], number)
    scene, how = name.split(", ")
    return _scene_world(scene, number, how == "Sionna RT")
