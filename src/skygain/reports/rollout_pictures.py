"""A small picture of every rollout of a comparison: truth, estimate with paths, error, uncertainty.

Scales are the same for all, so that surveys and methods can be held beside each other.
"""

from __future__ import annotations

__all__ = ["SCALES", "RolloutPictures"]

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from skygain.flight.swarm import Swarm
from skygain.ground.files import atomic_write
from skygain.predictors.base import Belief
from skygain.reports.pictures import uav_colours
from skygain.survey.methods import MethodSpec

if TYPE_CHECKING:
    from PIL import Image

    from skygain.datasets.cases import Case
    from skygain.evaluation.rollout import Observer

SCALES = {
    "truth": ("viridis", -180.0, -60.0),
    "estimate": ("viridis", -180.0, -60.0),
    "error": ("RdBu_r", -30.0, 30.0),
    "uncertainty": ("magma", 0.0, 30.0),
}
"""panel, left to right → colours and ends of the scale in dB"""
_PANEL = 192
_GAP = 6
_ROOF = (176, 184, 192)


@dataclass(frozen=True)
class RolloutPictures:
    """Draws each rollout at its end, in the process that flies it; see
    `skygain.evaluation.comparison.Watch`."""

    folder: Path
    """where the pictures go"""
    steps: int
    """the last step"""

    def path(self, link: int, label: str) -> Path:
        """Where the picture of a survey by one method is."""
        words = re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-")[:60]
        return self.folder / f"{link}-{words}-{crc32(label.encode()):08x}.png"

    def __call__(self, case: Case, method: MethodSpec) -> Observer:
        """The observer of one rollout."""
        path = self.path(case.link, method.label)

        def draw(step: int, swarm: Swarm, belief: Belief) -> None:
            if step == self.steps:
                with atomic_write(path) as tmp:
                    _picture(case, swarm, belief).save(tmp, format="png", optimize=True)

        return draw


def _picture(case: Case, swarm: Swarm, belief: Belief) -> Image.Image:
    from PIL import Image, ImageDraw

    posterior, outdoor = belief.posterior(), belief.scenario.outdoor
    truth = case.truth_db.astype(float)
    maps = {
        "truth": truth,
        "estimate": posterior.mean_db,
        "error": posterior.mean_db - truth,
        "uncertainty": posterior.std_db,
    }
    rows, cols = outdoor.shape
    zoom = max(1, _PANEL // max(rows, cols))
    width, height = zoom * cols, zoom * rows
    whole = Image.new("RGB", (len(maps) * (width + _GAP) - _GAP, height), "white")
    for number, (name, values) in enumerate(maps.items()):
        colours = _coloured(name, values, outdoor)
        panel = Image.fromarray(np.kron(colours, np.ones((zoom, zoom, 1), dtype=np.uint8)))
        if name == "estimate":
            pen = ImageDraw.Draw(panel)
            for cells, colour in zip(swarm.history, uav_colours(swarm.n_uavs), strict=False):
                at = [(zoom * (c + 0.5), zoom * (rows - r - 0.5)) for r, c in cells.tolist()]
                pen.line(at, fill=colour, width=2)
        whole.paste(panel, (number * (width + _GAP), 0))
    return whole.quantize(128, dither=Image.Dither.NONE)


def _coloured(
    name: str, values: NDArray[np.floating], outdoor: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """``[row, col, RGB]`` with north up."""
    from matplotlib import colormaps

    colours, low, high = SCALES[name]
    rgb = colormaps[colours]((values - low) / (high - low), bytes=True)[..., :3]
    rgb[~outdoor] = _ROOF
    return np.ascontiguousarray(rgb[::-1])
