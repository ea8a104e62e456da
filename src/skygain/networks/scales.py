"""Numbers that a network's definition and whoever feeds or runs it share."""

from __future__ import annotations

__all__ = [
    "FREE_SPACE_5GHZ_DB",
    "GAIN_CENTRE_DB",
    "GAIN_SCALE_DB",
    "HEIGHT_SCALE_M",
    "LARGEST_STD_DB",
    "OPEN_LOGITS",
    "PADDING_DB",
    "PAPER_LARGEST_STD_DB",
    "PAPER_SIDE",
    "SMALLEST_STD_DB",
    "TRAINED_SPACING_M",
]

FREE_SPACE_5GHZ_DB = -46.43
"""free-space gain between isotropic antennas at 1 m and 5 GHz"""
GAIN_CENTRE_DB = -120.0
GAIN_SCALE_DB = 30.0
"""gains enter and leave the U-Nets as (gain − centre) / scale"""
HEIGHT_SCALE_M = 30.0
"""heights enter the paper's U-Nets divided by this"""
PADDING_DB = -250.0
"""c_L, the paper's value at cells without a measurement: below every gain"""
PAPER_SIDE = 96
"""cells along the edge of the paper's map; its dense layer fixes it"""
SMALLEST_STD_DB = 0.5
LARGEST_STD_DB = 40.0
PAPER_LARGEST_STD_DB = 60.0
"""standard deviations that a network can answer with"""
TRAINED_SPACING_M = 4.0
"""side of the cells of all training maps"""
OPEN_LOGITS = 5.0
"""scale of the locator's correction"""
