"""One small mission, shared by the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skygain.missions.planning import plan_sortie
from skygain.missions.site import Site, open_site
from skygain.missions.sortie import Sortie
from skygain.survey.methods import planner, predictor
from tests.missions.town import BLOCKS, box, mission_request, write_polygons


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three blocks, an area of 160 x 160 m around them, and a no-fly zone."""
    folder = tmp_path_factory.mktemp("town")
    rings = [box(*block[:4]) for block in BLOCKS]
    corner = box(-10, -10, -8, -8)  # something low, so that the map reaches beyond the area
    far = box(175, 175, 177, 177)
    heights = [{"height": block[4]} for block in BLOCKS]
    write_polygons(
        folder / "town.geojson",
        [*rings, corner, far],
        [*heights, {"height": 3.0}, {"height": 3.0}],
    )
    write_polygons(folder / "area.geojson", [box(0, 0, 160, 160)])
    write_polygons(folder / "zones.geojson", [box(0, 80, 30, 100)])
    return folder


@pytest.fixture(scope="session")
def site(town: Path) -> Site:
    return open_site(mission_request(town))


@pytest.fixture(scope="session")
def sortie(site: Site) -> Sortie:
    belief = predictor("kriging-blind").begin(site.scenario)
    chooser = planner("sequential-greedy:horizon=16")
    return plan_sortie(site, belief, chooser, np.random.default_rng(0))
