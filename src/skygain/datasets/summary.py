"""What a data set holds, as numbers and as text."""

from __future__ import annotations

__all__ = ["dataset_info", "describe_dataset"]

import os
from typing import Any

import numpy as np

from skygain.datasets.layout import SPLITS
from skygain.datasets.store import ChannelDataset

_EDGES_DB = np.linspace(-400.0, 100.0, 5001)
"""bins of 0.1 dB, so that percentiles of any number of cells need little memory"""
_PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


def dataset_info(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Counts and statistics of a data set; every map is read once.

    Returns:
        ``file_bytes``, ``grid``, ``cities`` and ``links`` by split, ``attributes``, and under
        ``altitudes`` for each altitude the number of ``maps``, the ``outdoor_share`` of cells, the
        ``ray_traced_share`` of the outdoor cells, and ``gain_db``, the percentiles of the gain
        outdoors (resolved to 0.1 dB).

    Raises:
        InputError: the file is not a data set, or damaged.
    """
    dataset = ChannelDataset.open(path)
    splits = [s for s in SPLITS if s in dataset.splits]
    in_split = {s: set(dataset.cities(s)) for s in splits}
    return {
        "file_bytes": dataset.path.stat().st_size,
        "grid": {"shape": list(dataset.grid.shape), "spacing_m": dataset.grid.spacing_m},
        "cities": {s: len(in_split[s]) for s in splits},
        "links": {s: sum(int(i) in in_split[s] for i in dataset.city_index) for s in splits},
        "altitudes": {
            f"{altitude:g}": _statistics(dataset, altitude) for altitude in dataset.altitudes_m
        },
        "attributes": dataset.attributes,
    }


def describe_dataset(path: str | os.PathLike[str]) -> str:
    """`dataset_info` as text for people."""
    info = dataset_info(path)
    rows, cols = info["grid"]["shape"]
    lines = [
        f"{path}: {info['file_bytes'] / 1e6:.1f} MB, maps of {rows} x {cols} cells of "
        f"{info['grid']['spacing_m']:g} m",
        "",
        "split  cities  links",
        *(f"{s:5}  {info['cities'][s]:6}  {info['links'][s]:5}" for s in info["cities"]),
        "",
        f"{'':36}gain outdoors in dB, percentiles",
        "altitude   maps  outdoor  ray-traced" + "".join(f"{f'{p} %':>8}" for p in _PERCENTILES),
    ]
    for altitude, level in info["altitudes"].items():
        gains = "".join(f"{g:8.1f}" for g in level["gain_db"].values())
        shares = (
            f"{level['outdoor_share']:7.1%}  {level['ray_traced_share']:10.1%}"
            if level["maps"]
            else f"{'-':>7}  {'-':>10}"
        )
        lines.append(f"{altitude + ' m':>8}  {level['maps']:5}  {shares}{gains}")
    lines.append("")
    lines += [f"{name}: {value}" for name, value in info["attributes"].items()]
    return "\n".join(lines)


def _statistics(dataset: ChannelDataset, altitude_m: float) -> dict[str, Any]:
    """Statistics of all maps at one altitude."""
    counts = np.zeros(len(_EDGES_DB) - 1, dtype=np.int64)
    outdoor = traced = 0
    links = dataset.links(None, altitude_m)
    for index in links:
        link = dataset.link(index, altitude_m)
        gain = link.truth_db[link.outdoor]
        counts += np.histogram(gain, _EDGES_DB)[0]
        outdoor += gain.size
        traced += int(link.ray_traced[link.outdoor].sum())
    below = np.cumsum(counts)
    middle = (_EDGES_DB[:-1] + _EDGES_DB[1:]) / 2
    return {
        "maps": len(links),
        "outdoor_share": outdoor / (len(links) * dataset.grid.size) if links else None,
        "ray_traced_share": traced / outdoor if outdoor else None,
        "gain_db": {
            f"{p}%": round(float(middle[np.searchsorted(below, p / 100 * below[-1])]), 2)
            for p in _PERCENTILES
            if below[-1]
        },
    }
