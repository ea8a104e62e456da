"""What a flight did so far, kept so that it can go on after any death.

The loop asks the tape for every plan and every reading. The tape answers with what was recorded,
and once that is used up it makes new ones and records them, together with the state of every random
generator. Since beliefs follow from readings alone, the flight that goes on is the same as one that
was never cut off.
"""

from __future__ import annotations

__all__ = ["FlightTape", "Tape"]

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from skygain.ground.errors import InputError
from skygain.ground.journal import Journal
from skygain.measurements import Measurements
from skygain.planners.base import Certificate, Plan


class Tape:
    """Keeps nothing: every plan and reading is made when it is asked for."""

    def plan(self, make: Callable[[], tuple[Plan, float]]) -> tuple[Plan, float]:
        """The next plan and the seconds it took."""
        return make()

    def readings(self, make: Callable[[], Measurements]) -> Measurements:
        """The next readings."""
        return make()


class FlightTape(Tape):
    """A tape kept in a journal.

    Args:
        journal: where it is kept, opened for this survey.
        generators: every random generator that planner and instrument draw from.
    """

    def __init__(self, journal: Journal, generators: Sequence[np.random.Generator] = ()) -> None:
        self.journal = journal
        self.generators = tuple(generators)
        self._next = 0

    @property
    def steps(self) -> int:
        """Steps whose readings are kept, the start included."""
        return sum("readings" in record for record in self.journal.records)

    def plan(self, make: Callable[[], tuple[Plan, float]]) -> tuple[Plan, float]:
        record = self._recorded("plan")
        if record is not None:
            certificate = record["certificate"]
            plan = Plan(
                np.array(record["plan"], dtype=np.int64),
                record["commit"],
                Certificate(**certificate) if certificate else None,
            )
            return plan, record["seconds"]
        plan, seconds = make()
        certificate = plan.certificate
        self._keep(
            {
                "plan": plan.paths.tolist(),
                "commit": plan.commit_steps,
                "certificate": certificate
                and {f.name: getattr(certificate, f.name) for f in fields(certificate)},
                "seconds": seconds,
            }
        )
        return plan, seconds

    def readings(self, make: Callable[[], Measurements]) -> Measurements:
        record = self._recorded("readings")
        if record is not None:
            return Measurements(**{k: np.array(v) for k, v in record["readings"].items()})
        new = make()
        self._keep({"readings": {f.name: getattr(new, f.name).tolist() for f in fields(new)}})
        return new

    def _recorded(self, kind: str) -> dict[str, Any] | None:
        if self._next == len(self.journal.records):
            return None
        record = self.journal.records[self._next]
        if kind not in record or len(record.get("random", ())) != len(self.generators):
            raise InputError(
                f"record {self._next + 1} of {self.journal.path} does not fit this survey; fly it "
                "anew"
            )
        self._next += 1
        for generator, state in zip(self.generators, record["random"], strict=True):
            generator.bit_generator.state = state
        return record

    def _keep(self, record: dict[str, Any]) -> None:
        random = [generator.bit_generator.state for generator in self.generators]
        self.journal.append(record | {"random": random})
        self._next += 1
