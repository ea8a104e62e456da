"""What a map of a campaign is called: power stays power, in columns, variables and units."""

from __future__ import annotations

__all__ = ["level_limits", "named", "quantity_of", "unit_of"]

import numpy as np

from skygain.survey.mapping import RadioMap


def unit_of(chart: RadioMap) -> str:
    return "dBm" if chart.gridded.quantity == "power" else "dB"


def quantity_of(chart: RadioMap) -> str:
    return "received power" if chart.gridded.quantity == "power" else "channel gain"


def named(name: str, chart: RadioMap) -> str:
    return f"{name}_{chart.label}" if chart.label else name


def level_limits(chart: RadioMap) -> tuple[float, float]:
    """Ends of the colour scale that readings and map share."""
    low, high = np.percentile(chart.gridded.level_db, (1, 99))
    return float(low), max(float(high), float(low) + 1.0)
