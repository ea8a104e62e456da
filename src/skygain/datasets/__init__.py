"""The data-set store, its builder, and what is drawn from it."""

from __future__ import annotations

__all__ = [
    "BuildConfig",
    "Case",
    "ChannelDataset",
    "Link",
    "Links",
    "build_dataset",
    "cropped_link",
    "dataset_info",
    "describe_dataset",
    "load_links",
    "open_sample",
    "random_crop",
    "survey_cases",
    "turned_link",
    "write_dataset",
]

from skygain.datasets.builder import build_dataset
from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.crops import cropped_link, random_crop, turned_link
from skygain.datasets.link import Link
from skygain.datasets.links import Links, load_links
from skygain.datasets.presets import BuildConfig
from skygain.datasets.sample import open_sample
from skygain.datasets.store import ChannelDataset
from skygain.datasets.summary import dataset_info, describe_dataset
from skygain.datasets.writer import write_dataset
