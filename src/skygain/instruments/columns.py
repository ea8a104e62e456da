"""Which column of a recorded campaign is which.

Campaigns are logged by many tools, and each names its columns its own way. A column can always be
named; what is not named is guessed from a fixed list of usual names, and a guess is refused rather
than made when two columns would do.
"""

from __future__ import annotations

__all__ = [
    "GUESSES",
    "LEVEL_NAMES",
    "ROLES",
    "find_columns",
    "level_quantity",
    "named_column",
    "normalised",
]

import difflib
import re
from collections.abc import Mapping, Sequence

from skygain.ground.errors import InputError

LEVEL_NAMES: dict[str, str] = {
    **dict.fromkeys(
        ("rsrp", "ss_rsrp", "nr_rsrp", "lte_rsrp", "nr_ss_rsrp", "rssi", "rscp", "rxlev"), "power"
    ),
    **dict.fromkeys(
        ("level", "rx_level", "signal", "signal_level", "signal_strength", "strength"), "power"
    ),
    **dict.fromkeys(("power", "rx_power", "received_power", "rss", "dbm"), "power"),
    **dict.fromkeys(("gain", "channel_gain", "path_gain", "pathgain"), "gain"),
    **dict.fromkeys(("path_loss", "pathloss", "loss", "attenuation"), "loss"),
}
"""usual names of the level, and what each measures: power in dBm, gain in dB, or loss in dB"""

GUESSES: dict[str, tuple[str, ...]] = {
    "latitude": ("lat", "latitude", "gps_lat", "gps_latitude"),
    "longitude": (
        "lon",
        "lng",
        "long",
        "longitude",
        "gps_lon",
        "gps_lng",
        "gps_long",
        "gps_longitude",
    ),
    "x": ("x", "easting", "east", "utm_x", "utm_e", "x_utm"),
    "y": ("y", "northing", "north", "utm_y", "utm_n", "y_utm"),
    "level": tuple(LEVEL_NAMES),
    "noise": ("noise_std",),
    "time": ("time", "timestamp", "datetime", "t"),
    "censored": ("censored",),
}
"""usual names of each role's column, in lower case and without unit"""

ROLES = tuple(GUESSES)
"""what a column can be"""

_UNIT = re.compile(r"_(dbm|db|m|metres|meters|deg|degrees|s|sec|seconds|ms)$")


def normalised(name: str) -> str:
    """A column name in lower case with underscores: ``"RSRP [dBm]"`` becomes ``"rsrp_dbm"``."""
    return re.sub(r"[^0-9a-z]+", "_", name.casefold()).strip("_")


def _fits(role: str, name: str) -> bool:
    plain = normalised(name)
    return plain in GUESSES[role] or _UNIT.sub("", plain) in GUESSES[role]


def level_quantity(name: str) -> str:
    """``"power"``, ``"gain"`` or ``"loss"``: what a level column of this name holds; power when the
    name does not tell.

    >>> level_quantity("Path Loss (dB)"), level_quantity("RSRP"), level_quantity("my column")
    ('loss', 'power', 'power')
    """
    plain = normalised(name)
    known = LEVEL_NAMES.get(plain) or LEVEL_NAMES.get(_UNIT.sub("", plain))
    if known:
        return known
    if "loss" in plain or "attenuation" in plain:
        return "loss"
    return "gain" if "gain" in plain else "power"


def _listed(header: Sequence[str]) -> str:
    shown = ", ".join(repr(name[:40]) for name in header[:30])
    return shown + (f" and {len(header) - 30} more" if len(header) > 30 else "")


def named_column(header: Sequence[str], name: str, what: str) -> int:
    """Index of the column called ``name``, exactly or but for case.

    Raises:
        InputError: there is none, or more than one; the message lists the columns.
    """
    for same in (lambda a, b: a == b, lambda a, b: a.casefold() == b.casefold()):
        found = [i for i, column in enumerate(header) if same(column.strip(), name.strip())]
        if len(found) > 1:
            raise InputError(
                f"{len(found)} columns are called {name!r}, so the {what} is ambiguous; rename all "
                "but one in the file"
            )
        if found:
            return found[0]
    close = difflib.get_close_matches(name, header, n=1)
    hint = f" did you mean {close[0]!r}?" if close else ""
    raise InputError(f"no column {name!r} for the {what};{hint} the columns are {_listed(header)}")


def _guessed(header: Sequence[str], role: str) -> list[int]:
    return [i for i, name in enumerate(header) if _fits(role, name)]


def _required(header: Sequence[str], role: str) -> int:
    found = _guessed(header, role)
    if len(found) > 1:
        options = ", ".join(repr(header[i]) for i in found)
        raise InputError(
            f"columns {options} could each be the {role}; name the one to use (columns: "
            f"{_listed(header)})"
        )
    if not found:
        raise InputError(
            f"found no column for the {role}; name it (columns: {_listed(header)}; guessed names: "
            f"{', '.join(GUESSES[role])})"
        )
    return found[0]


def find_columns(header: Sequence[str], named: Mapping[str, str]) -> dict[str, int]:
    """Index of the column for each role: the position (two of the first four `ROLES`), the level,
    and what else there is.

    Args:
        header: column names.
        named: ``{role: column name}`` for the roles that are not to be guessed.

    Where both a latitude, longitude pair and an x, y pair can be guessed, latitude and longitude
    are taken. The optional roles (noise, time, censored) are left out when no column, or more than
    one, would do.

    Raises:
        InputError: a named role or column does not exist, a role that is needed has no column or
            several, or one column has two roles.
    """
    unknown = [role for role in named if role not in ROLES]
    if unknown:
        raise InputError(f"unknown column role {unknown[0]!r}; known: {', '.join(ROLES)}")
    found = {role: named_column(header, name, role) for role, name in named.items()}
    geographic, metric = ("latitude", "longitude"), ("x", "y")
    if any(role in found for role in geographic) and any(role in found for role in metric):
        raise InputError(
            "columns are named both for latitude or longitude and for x or y; name one pair"
        )
    if any(role in found for role in metric):
        pair = metric
    elif any(role in found for role in geographic) or all(
        _guessed(header, role) for role in geographic
    ):
        pair = geographic
    elif all(_guessed(header, role) for role in metric):
        pair = metric
    else:
        raise InputError(
            "found no pair of columns for the position; name latitude and longitude, or x and y "
            f"(columns: {_listed(header)}; "
            f"guessed names: {', '.join(GUESSES['latitude'])} with "
            f"{', '.join(GUESSES['longitude'])}, "
            f"or {', '.join(GUESSES['x'])} with {', '.join(GUESSES['y'])})"
        )
    for role in (*pair, "level"):
        if role not in found:
            found[role] = _required(header, role)
    for role in ("noise", "time", "censored"):
        guess = [i for i in _guessed(header, role) if i not in found.values()]
        if role not in found and len(guess) == 1:
            found[role] = guess[0]
    taken: dict[int, str] = {}
    for role, index in found.items():
        if index in taken:
            raise InputError(
                f"column {header[index]!r} cannot be both the {taken[index]} and the {role}; name "
                "another for one of them"
            )
        taken[index] = role
    return found
