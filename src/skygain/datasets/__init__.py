"""The data-set store, its builder and its loader."""

from __future__ import annotations

__all__ = ["Case", "ChannelDataset", "Link", "open_sample", "survey_cases", "write_dataset"]

from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.link import Link
from skygain.datasets.sample import open_sample
from skygain.datasets.store import ChannelDataset
from skygain.datasets.writer import write_dataset
