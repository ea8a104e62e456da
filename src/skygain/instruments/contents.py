"""What a log holds, column by column, before anything is read out of it."""

from __future__ import annotations

__all__ = ["column_lines"]

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.columns import find_columns
from skygain.instruments.values import FINE, MISSING, numbers, texts

_MOST_COLUMNS = 40
_FEW_VALUES = 8
"""a column with at most so many values has them listed"""
_SHOWN = 24


def column_lines(
    path: Path, columns: Mapping[str, str], max_bytes: int = 1_000_000_000
) -> list[str]:
    """A line for each column of a log: its name, what it is taken for and what it holds; and one
    for what is missing.

    Args:
        path: the log.
        columns: ``{role: column name}`` that are named, see `skygain.instruments.read_recording`.
        max_bytes: refuse larger files.

    Raises:
        InputError: there is no such file, or it has no columns.
    """
    from skygain.instruments.formats import open_table

    table = open_table(path, max_bytes, columns.get("level"))
    named = {k: v for k, v in columns.items() if not (k == "level" and "level" in table.roles)}
    missing = ""
    try:
        index, _ = find_columns(table.header, named, table.roles)
    except InputError as error:
        index, missing = {}, str(error)
    role = {at: name for name, at in index.items()}
    shown = min(len(table.header), _MOST_COLUMNS)
    values, line = table.load(list(range(shown)))
    lines = [f"  {len(line)} lines, {len(table.header)} columns"]
    for i, column in enumerate(values):
        taken = f" ({role[i]})" if i in role else ""
        lines.append(f"  {table.header[i]!r}{taken}: {_held(column)}")
    if len(table.header) > shown:
        lines.append(f"  and {len(table.header) - shown} more")
    return [*lines, *([f"  {missing}"] if missing else [])]


def _held(column: NDArray) -> str:
    """What a column holds, in a few words."""
    if not len(column):
        return "nothing"
    parsed, kind = numbers(column)
    fine = parsed[kind == FINE]
    empty = int((kind == MISSING).sum())
    rest = f", {empty} without a value" if empty else ""
    plain = texts(column).astype(str)
    found, count = np.unique(plain, return_counts=True)
    if len(found) <= _FEW_VALUES:
        order = np.argsort(-count, kind="stable")
        return ", ".join(f"{found[k][:_SHOWN] or 'empty'} ({count[k]})" for k in order)
    if len(fine) + empty >= 0.9 * len(column) and len(fine):
        odd = len(column) - len(fine) - empty
        rest += f", {odd} not understood" if odd else ""
        return f"{fine.min():.10g} to {fine.max():.10g}, {len(np.unique(fine))} values{rest}"
    return f"text, {len(found)} values such as {found[0][:_SHOWN]!r} and {found[-1][:_SHOWN]!r}"
