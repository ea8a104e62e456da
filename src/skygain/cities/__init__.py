"""Where cities come from."""

from __future__ import annotations

__all__ = ["ManhattanConfig", "manhattan_city", "transmitter_sites"]

from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
