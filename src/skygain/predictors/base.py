"""The seam every predictor implements: begin a survey, take measurements in, say what is
believed."""

from __future__ import annotations

__all__ = ["Belief", "Predictor"]

from abc import ABC, abstractmethod
from typing import ClassVar, Literal

from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.scenario import Scenario

MAPS_BYTES = 300.0
"""per cell, of the maps that any survey holds"""


class Belief(ABC):
    """The state of a predictor in one survey. Immutable: `updated` returns a new belief and the old
    one stays valid."""

    scenario: Scenario
    """what was known before the first measurement"""
    measurements: Measurements
    """everything taken in so far"""

    @abstractmethod
    def updated(self, measurements: Measurements) -> Belief:
        """The belief after ``measurements`` as well; they may repeat cells and may be empty."""

    @abstractmethod
    def posterior(self) -> Posterior:
        """Mean and variance of the gain at every cell, indoor cells included (there they mean
        nothing but are finite)."""


class Predictor(ABC):
    """A method that predicts the gain everywhere from sparse measurements. Holds settings and
    weights, never a survey's state."""

    interpolates: ClassVar[bool] = True
    """whether the mean equals an exact measurement at its cell, with no variance left there"""

    transmitter: Literal["required", "optional", "unused"] = "unused"
    """whether the method needs to be told where the transmitter is, can make use of it, or never
    looks"""

    needs_gain: ClassVar[bool] = False
    """whether the level of a reading tells the method something, so that it must be a gain in dB"""

    @abstractmethod
    def begin(self, scenario: Scenario) -> Belief:
        """The belief before the first measurement."""

    def outside_training(
        self, scenario: Scenario, *, uavs: int | None = None, quantity: str = "gain"
    ) -> str:
        """One line that says in what a survey is unlike all that the method was trained for; empty
        where it is not, and for a method that adapts to its readings.

        Args:
            scenario: of the survey.
            uavs: how many fly; ``None`` where nobody does.
            quantity: what the readings are of, see `GriddedRecording.quantity`.
        """
        return ""

    def memory_bytes(self, cells: int, readings: int) -> float:
        """About what a survey takes at most that reads ``readings`` of a map's ``cells``; a method
        that holds more than some maps says so."""
        return MAPS_BYTES * cells
