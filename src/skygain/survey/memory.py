"""Whether a survey fits into memory, asked before anything is flown."""

from __future__ import annotations

__all__ = ["demand_memory", "free_bytes", "in_words"]

import os
from pathlib import Path

from skygain.ground.errors import InputError
from skygain.predictors.base import Predictor
from skygain.scenario import Scenario

LOCAL = "local-kriging"
"""the predictor whose memory does not grow with readings × cells"""
_GROUP = Path("/sys/fs/cgroup")


def demand_memory(predictor: Predictor, scenario: Scenario, readings: int) -> float:
    """The bytes that a survey of so many readings takes.

    Raises:
        InputError: there are not so many.
    """
    cells = scenario.outdoor.size
    needed, free = predictor.memory_bytes(cells, min(readings, cells)), free_bytes()
    if free is not None and needed > free:
        raise InputError(
            f"{type(predictor).__name__} would take about {in_words(needed)} of memory for "
            f"{cells:,} cells and {readings:,} readings, and {in_words(free)} are free; give "
            f"`predictor={LOCAL}`, or fewer cells or `steps`"
        )
    return needed


def free_bytes() -> float | None:
    """Memory that this process may still take, ``None`` where the system does not say."""
    found = []
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                found.append(1024.0 * int(line.split()[1]))
    except (OSError, ValueError):
        names = os.sysconf_names if hasattr(os, "sysconf") else {}
        if "SC_PHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
            found.append(float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")))
    try:  # a container has less than its machine
        limit, used = (
            int((_GROUP / name).read_text(encoding="ascii"))
            for name in ("memory.max", "memory.current")
        )
        stat = dict(line.split() for line in (_GROUP / "memory.stat").read_text().splitlines())
        found.append(float(limit - used + int(stat.get("inactive_file", 0))))
    except (OSError, ValueError):
        pass
    return min(found, default=None)


def in_words(size_bytes: float) -> str:
    """A size as people say it.

    >>> in_words(3.2e9), in_words(2e6)
    ('3.2 GB', '2 MB')
    """
    return f"{size_bytes / 1e9:.1f} GB" if size_bytes >= 1e9 else f"{size_bytes / 1e6:.0f} MB"
