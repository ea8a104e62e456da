"""Skygain maps a radio transmitter's channel gain over a city with a swarm of UAVs that fly where
measuring teaches the most."""

from __future__ import annotations

__all__ = ["__version__"]

__version__ = "0.1.0"
