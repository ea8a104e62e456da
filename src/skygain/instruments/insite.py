"""Results of Wireless InSite: ``.p2m`` tables of one row per receiver point.

Comment lines begin with ``#``, values are split by spaces, the receiver's number comes first, and
what the last columns are is told by a comment or by the file's name (``power.t001_01.r002.p2m``).
"""

from __future__ import annotations

__all__ = ["open_p2m"]

import re
from pathlib import Path

import numpy as np

from skygain.ground.errors import InputError
from skygain.instruments.points import table_of
from skygain.instruments.tables import Table

_PLACE = ("rx", "x", "y", "z", "distance")
_KINDS = {
    "pl": ("loss", "path_loss_db"),
    "xpl": ("loss", "path_loss_db"),
    "pg": ("gain", "path_gain_db"),
    "pathgain": ("gain", "path_gain_db"),
    "pathloss": ("loss", "path_loss_db"),
    "power": ("power", "power_dbm"),
    "pwr": ("power", "power_dbm"),
}
_NO_PATH_DB = 250.0
"""InSite writes this loss, or less power than its negative, where no path arrives"""


def open_p2m(path: Path) -> Table:
    """The receivers of a ``.p2m`` table with the level at each.

    Raises:
        InputError: it is no table of path loss, path gain or received power.
    """
    comments, rows, lines = _rows(path)
    kind, level = _kind(path.name, comments)
    if not rows:
        raise InputError(f"{path.name} holds no receivers; expected a row of numbers for each")
    width = len(rows[0])
    odd = next((i for i, row in enumerate(rows) if len(row) != width), None)
    if odd is not None or width < 5:
        at = odd or 0
        raise InputError(
            f"{path.name} line {lines[at]}: {len(rows[at])} values, expected "
            f"{max(width, 6)}: number, x, y, z, distance, level; export power, path loss or path "
            "gain of a receiver set"
        )
    table = np.array(rows)
    at = 4 if width == 5 and "distance" not in comments.lower() else 5
    if at >= width:
        raise InputError(
            f"{path.name} holds {width} values a row, none after the distance; export power, path "
            "loss or path gain of a receiver set"
        )
    values = table[:, at].copy()
    missing = np.abs(values) >= _NO_PATH_DB
    values[missing] = np.nan
    columns = dict(zip(_PLACE[1:4], table[:, 1:4].T, strict=True)) | {level: values}
    notes = []
    if missing.any():
        notes.append(f"{int(missing.sum())} of {len(rows)} receivers hear nothing "
                     f"({_NO_PATH_DB:g} dB), left out")  # fmt: skip
    roles = {"x": "x", "y": "y", "level": level, "altitude": "z"}
    found = table_of(path.name, columns, roles, notes=notes)
    return Table(found.name, found.header, found.load, roles, quantity=kind, notes=found.notes)


def _rows(path: Path) -> tuple[str, list[list[float]], list[int]]:
    comments, rows, lines = [], [], []
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            plain = line.strip()
            if plain.startswith(("#", "<")):
                comments.append(plain)
            elif plain:
                try:
                    plain = re.sub(r"(?<=[\d.])[dD](?=[+-]?\d)", "e", plain)  # of Fortran
                    rows.append([float(v) for v in re.split(r"[\s,]+", plain)])
                except ValueError as error:
                    raise InputError(
                        f"{path.name} line {number}: {plain[:60]!r} is no row of numbers; expected "
                        "number, x, y, z, distance, level"
                    ) from error
                lines.append(number)
    return "\n".join(comments), rows, lines


def _kind(name: str, comments: str) -> tuple[str, str]:
    """What the level is, by the comments, else by the file's name."""
    said = comments.lower()
    for word, kind in (("loss", "pl"), ("gain", "pg"), ("power", "power"), ("dbm", "power")):
        if word in said:
            return _KINDS[kind]
    for part in re.split(r"[._\s]+", name.lower()):
        if part in _KINDS:
            return _KINDS[part]
    raise InputError(
        f"{name} tells neither in its comments nor its name whether it holds path loss, path gain "
        "or power; name it pl.p2m, pg.p2m or power.p2m"
    )
