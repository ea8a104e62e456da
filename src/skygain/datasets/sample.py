"""The small data set that ships inside the package.

It is the preset ``sample``, made with ``skygain dataset build --preset sample --out
src/skygain/data/sample.zarr.zip --no-resume``.
"""

from __future__ import annotations

__all__ = ["SAMPLE", "open_sample"]

from importlib.resources import files
from pathlib import Path

from skygain.datasets.store import ChannelDataset

SAMPLE = Path(str(files("skygain") / "data" / "sample.zarr.zip"))
"""the file"""


def open_sample() -> ChannelDataset:
    """A few small pre-traced links, for the demo, doctests and tests: no ray tracer, no download.

    >>> dataset = open_sample()
    >>> dataset.splits
    ('T1', 'T2', 'T3', 'T4', 'T4', 'T4', 'T4')
    """
    return ChannelDataset.open(SAMPLE)
