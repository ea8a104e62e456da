"""The lines of a log that are still in, and what became of the others."""

from __future__ import annotations

__all__ = ["Lines", "keep_lines", "nothing_left", "too_many", "without_empty"]

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.values import texts


@dataclass(eq=False)
class Lines:
    """The lines of a table that are still in, and what became of the others."""

    name: str
    columns: dict[int, NDArray]
    line: NDArray[np.int64]
    skip_bad: bool
    notes: list[str] = field(default_factory=list)
    skipped: int = 0
    complaint: str = ""

    def keep(self, mask: NDArray[np.bool_]) -> None:
        if not mask.all():
            self.columns = {i: c[mask] for i, c in self.columns.items()}
            self.line = self.line[mask]

    def bad(self, mask: NDArray[np.bool_], problem: Any) -> NDArray[np.bool_]:
        """Lines to keep; refuses the file at the first bad line unless they are to be skipped.

        Args:
            mask: ``[n]`` bad lines.
            problem: what is wrong with line i of those still in.

        Raises:
            InputError: there is a bad line.
        """
        if mask.any():
            first = int(np.flatnonzero(mask)[0])
            text = f"{self.name} line {self.line[first]}: {problem(first)}"
            if not self.skip_bad:
                raise InputError(
                    f"{text}; mend or delete the line, or leave out bad lines with `skip_bad=True`"
                )
            self.skipped += int(mask.sum())
            self.complaint = self.complaint or text
        return ~mask

    def missing(self, mask: NDArray[np.bool_], what: str, column: NDArray | None) -> None:
        """Tell of lines left out because something has no value there."""
        if mask.any():
            shown = ""
            if column is not None and column.dtype == object:
                marks, count = np.unique(texts(column[mask]).astype(str), return_counts=True)
                shown = ", ".join(f"{m[:20]!r} {c} times" for m, c in zip(marks, count,
                                                                         strict=True))  # fmt: skip
                shown = f" ({shown})"
            first = self.line[np.flatnonzero(mask)[0]]
            self.notes.append(
                f"{int(mask.sum())} lines left out: {what} has no value{shown}, first line {first}"
            )


def without_empty(lines: Lines, index: Mapping[str, int]) -> int:
    """Pass over lines without anything in any column; the number of the others."""
    empty = np.ones(len(lines.line), dtype=bool)
    for column in lines.columns.values():
        if column.dtype != object:
            return len(lines.line)
        at = np.flatnonzero(empty)
        empty[at] = [t is not None and not str(t).strip() for t in column[at]]
    lines.keep(~empty)
    return len(lines.line)


def too_many(lines: Lines) -> NDArray[np.bool_]:
    column = next(iter(lines.columns.values()))
    if column.dtype != object:
        return np.zeros(len(lines.line), dtype=bool)
    return np.array([text is None for text in column.tolist()], dtype=bool)


def keep_lines(lines: Lines, found: dict[str, Any], keep: NDArray[np.bool_]) -> None:
    lines.keep(keep)
    for role, values in found.items():
        found[role] = values[keep]


def nothing_left(lines: Lines) -> str:
    if lines.complaint:
        return (
            f"all {lines.skipped} lines of {lines.name} are bad, the first because: "
            f"{lines.complaint}"
        )
    return f"{lines.name} holds no reading: " + "; ".join(lines.notes or ("it is empty",))
