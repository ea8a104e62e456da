"""What a path may be paid for, by name."""

from __future__ import annotations

__all__ = ["OBJECTIVES", "Objective"]

from enum import IntEnum

from skygain.ground.errors import InputError


class Objective(IntEnum):
    """An objective; compiled code compares members, options give names."""

    VARIANCE = 0
    """the fall of the weighted variance, summed over the target cells"""
    ENTROPY = 1
    """½ log det(I + K/σ²), the information of the readings"""
    MUTUAL_INFORMATION = 2
    """the information of the readings about the target cells"""

    @classmethod
    def named(cls, name: str) -> Objective:
        """The objective called ``name``.

        Raises:
            InputError: there is none of that name.
        """
        if name not in OBJECTIVES:
            raise InputError(
                f"unknown objective {name!r}; expected objective to be one of "
                f"{', '.join(OBJECTIVES)}"
            )
        return OBJECTIVES[name]


OBJECTIVES = {member.name.lower().replace("_", "-"): member for member in Objective}
"""objectives by the names that options use"""
