"""Which column of a log is which.

Logs are written by many tools, and each names its columns its own way. A column can always be
named; what is not named is guessed from a fixed list of usual names, and a guess is refused rather
than made when two columns would do.
"""

from __future__ import annotations

__all__ = [
    "GUESSES",
    "LEVEL_NAMES",
    "ROLES",
    "column_for",
    "find_columns",
    "headings",
    "level_quantity",
    "metres_each",
    "named_column",
    "normalised",
    "series_columns",
]

import difflib
import re
import unicodedata
from collections.abc import Mapping, Sequence

from skygain.ground.errors import InputError
from skygain.instruments.tables import quoted_list

LEVEL_NAMES: dict[str, str] = {
    **dict.fromkeys(
        ("rsrp", "ss_rsrp", "nr_rsrp", "lte_rsrp", "nr_ss_rsrp", "rssi", "rscp", "rxlev"), "power"
    ),
    **dict.fromkeys(
        ("level", "rx_level", "signal", "signal_level", "signal_strength", "strength"), "power"
    ),
    **dict.fromkeys(("power", "rx_power", "received_power", "rss", "1rss", "dbm"), "power"),
    **dict.fromkeys(("field_strength", "feldstarke", "asu", "champ"), "power"),
    **dict.fromkeys(("pegel", "empfangspegel", "niveau", "nivel", "livello", "уровень"), "power"),
    **dict.fromkeys(("gain", "channel_gain", "path_gain", "pathgain"), "gain"),
    **dict.fromkeys(("path_loss", "pathloss", "loss", "attenuation"), "loss"),
}
"""usual names of the level, and what each measures: power in dBm, gain in dB, or loss in dB"""

GUESSES: dict[str, tuple[str, ...]] = {
    "latitude": (
        "lat",
        "latitude",
        "gps_lat",
        "gps_latitude",
        "currentlatitude",
        "latitudee7",
        "lat_deg",
        "breite",
        "breitengrad",
        "latitud",
        "latitudine",
        "широта",
    ),
    "longitude": (
        "lon",
        "lng",
        "long",
        "longitude",
        "gps_lon",
        "gps_lng",
        "gps_long",
        "gps_longitude",
        "currentlongitude",
        "longitudee7",
        "lange",
        "langengrad",
        "laenge",
        "longitud",
        "longitudine",
        "долгота",
    ),
    "x": (
        *("x", "easting", "east", "e", "utm_x", "utm_e", "x_utm", "coord_x", "x_coord"),
        *("x_coordinate", "pos_x", "x_pos", "rx_x", "rechtswert", "ostwert", "este"),
    ),
    "y": (
        *("y", "northing", "north", "n", "utm_y", "utm_n", "y_utm", "coord_y", "y_coord"),
        *("y_coordinate", "pos_y", "y_pos", "rx_y", "hochwert", "nordwert", "norte"),
    ),
    "position": (
        "gps",
        "gps_position",
        "position",
        "location",
        "coordinates",
        "latlon",
        "lat_lon",
        "latlng",
        "lat_lng",
        "wkt",
        "geometry",
    ),
    "level": tuple(LEVEL_NAMES),
    "noise": ("noise_std",),
    "time": ("time", "timestamp", "datetime", "t", "zeit", "firstseen", "время", "heure", "hora"),
    "censored": ("censored",),
    "north_south": (
        *("ns", "n_s", "lat_ns", "lat_dir", "lat_ref", "lat_hemisphere", "latitude_dir"),
        *("latitude_ref", "latitude_direction", "latitude_hemisphere", "ns_indicator"),
    ),
    "east_west": (
        *("ew", "e_w", "lon_ew", "lon_dir", "lon_ref", "lon_hemisphere", "longitude_dir"),
        *("longitude_ref", "longitude_direction", "longitude_hemisphere", "ew_indicator"),
        *("lng_dir", "lng_ref", "long_dir", "long_ref"),
    ),
    "altitude": (
        "alt",
        "altitude",
        "altitudemeters",
        "height",
        "alt_agl",
        "altitude_agl",
        "agl",
        "height_agl",
        "relative_altitude",
        "altitude_relative",
        "alt_rel",
        "rel_alt",
        "relative_alt",
        "gps_alt",
        "gps_altitude",
        "hohe",
        "z",
        "elevation",
        "ele",
        "alt_msl",
        "alt_amsl",
        "hoehe",
    ),
}
"""usual names of each role's column, in lower case and without accents and unit"""

ROLES = tuple(GUESSES)
"""what a column can be"""

_SERIES: tuple[str, ...] = (
    "pci",
    "pc",
    "physical_cell_id",
    "physical_cell_identity",
    "cell_id",
    "cellid",
    "cell",
)
_SERIES += ("cellid", "cell", "ci", "eci", "nci", "cgi", "ecgi", "ncgi", "psc", "cellname")
_SERIES += (
    "cell_name",
    "mac",
    "bssid",
    "ssid",
    "mac_address",
    "earfcn",
    "arfcn",
    "nrarfcn",
    "nr_arfcn",
    "uarfcn",
)
_SIGNALS: tuple[str, ...] = ("cell_tower_id", "channel_number", "modem")
_SIGNALS += ("band", "lte_band", "nr_band", "frequency", "freq", "center_frequency", "channel")
_SIGNALS += ("ssb", "ssb_index", "ssb_id", "beam", "beam_id", "beam_index", "sector", "sector_id")
_SIGNALS += ("operator", "network", "plmn", "mnc", "mccmnc", "technology", "tech", "rat")
_SIGNALS += ("network_type", "tx", "tx_id", "txid", "transmitter", "transmitter_id", "site")
_SIGNALS += ("site_id", "base_station", "bs_id", "enb", "enodeb", "enb_id", "enodeb_id", "gnb_id")
_SIGNALS += ("gateway", "gateway_id", "ap", "ap_name", "anchor", "anchor_id", "beacon")
_UNIT = re.compile(
    r"_(dbm|db|dbw|mw|nw|dbuv|dbuv_m|dbμv|dbμv_m|m|metres|meters|ft|feet|km|deg|degrees|s|sec|"
    r"seconds|ms|hz|khz|mhz|ghz|дбм|дб|м)$"
)
_WORDS: dict[str, tuple[frozenset[str], frozenset[str]]] = {
    "latitude": (frozenset(("lat", "latitude", "breitengrad")), frozenset()),
    "longitude": (frozenset(("lon", "lng", "long", "longitude", "langengrad")), frozenset()),
    "level": (
        frozenset(("rsrp", "rssi", "rscp", "rxlev", "rss")),
        frozenset(("rsrq", "detected", "neighbour", "neighbor", "nbr", "ncell", "std", "count")),
    ),
    "altitude": (
        frozenset(("alt", "altitude", "height", "agl", "hohe")),
        frozenset(("accuracy", "error", "std", "building", "geoid", "antenna")),
    ),
}
"""a name with such a word has the role where no usual name does, unless another word forbids it"""
_OTHERS = frozenset(("tx", "bs", "site", "enb", "gnb", "cell", "station", "tower", "start", "home"))
"""words of what stands elsewhere than the receiver"""


def normalised(name: str) -> str:
    """A column name in lower case, without accents, with underscores: ``"RSRP [dBm]"`` becomes
    ``"rsrp_dbm"``, ``"Länge"`` becomes ``"lange"``."""
    plain = unicodedata.normalize("NFC", name.casefold())
    plain = "".join(
        unicodedata.normalize("NFKD", c)[0] if c.isalpha() and c not in "йё" else c for c in plain
    )
    return re.sub(r"[\W_]+", "_", plain).strip("_")


def _plain(name: str) -> tuple[str, str]:
    plain = normalised(name)
    return plain, _UNIT.sub("", plain)


def _fits(role: str, name: str) -> bool:
    return any(form in GUESSES[role] for form in _plain(name))


def _fits_loosely(role: str, name: str) -> bool:
    words, forbidden = _WORDS.get(role, (frozenset(), frozenset()))
    said = set(normalised(name).split("_"))
    others = frozenset() if role == "level" else _OTHERS
    return bool(said & words) and not said & (forbidden | others)


def metres_each(name: str) -> float:
    """Metres in the unit that ends a length's column name; 1 where none does.

    >>> metres_each("altitude_ft"), metres_each("X [km]"), metres_each("height(meters)")
    (0.3048, 1000.0, 1.0)
    """
    last = normalised(name).rpartition("_")[2]
    return {"ft": 0.3048, "feet": 0.3048, "km": 1000.0}.get(last, 1.0)


def headings(fields: Sequence[str]) -> bool:
    """Whether a line's fields look like the names of a log's columns: a position and more."""
    has = {role: bool(_guessed(fields, role)) for role in ROLES}
    pair = (has["latitude"] and has["longitude"]) or (has["x"] and has["y"]) or has["position"]
    return pair and len(fields) >= 2


def level_quantity(name: str) -> str:
    """``"power"``, ``"gain"`` or ``"loss"``: what a level column of this name holds; power when the
    name does not tell.

    >>> level_quantity("Path Loss (dB)"), level_quantity("RSRP"), level_quantity("my column")
    ('loss', 'power', 'power')
    """
    plain, without_unit = _plain(name)
    known = LEVEL_NAMES.get(plain) or LEVEL_NAMES.get(without_unit)
    if known:
        return known
    if "loss" in plain or "attenuation" in plain:
        return "loss"
    return "gain" if "gain" in plain else "power"


def series_columns(header: Sequence[str], level: str) -> list[int]:
    """Columns that tell one signal from another: cell, network or channel.

    A neighbour's cell beside a serving cell's level is not that level's.
    """
    found = []
    for i, name in enumerate(header):
        plain, without_unit = _plain(name.rpartition(".")[2])
        beside = any(w in plain and w not in normalised(level) for w in ("detected", "neighb"))
        named = bool({plain, without_unit} & {*_SERIES, *_SIGNALS}) or plain.startswith(
            ("physical_cell_id", "pci_", "cell_id_")
        )
        if named and not beside:
            found.append(i)
    return found


def column_for(header: Sequence[str], name: str, what: str) -> int:
    """Index of the column called ``name``, or of the one column that plays the role of that name:
    ``altitude`` finds ``alt_agl_m``, ``pci`` finds ``Physical cell identity``.

    Raises:
        InputError: there is none.
    """
    try:
        return named_column(header, name, what)
    except InputError:
        plain = normalised(name)
        if plain in GUESSES:
            found = _guessed(header, plain)
        elif plain in _SERIES:
            cells = [
                i
                for i in series_columns(header, "")
                if "arfcn" not in normalised(header[i]) and normalised(header[i]) not in _SIGNALS
            ]
            found = [i for i in cells if normalised(header[i]).startswith(plain[:2])] or cells
        else:
            found = []
        if len(found) == 1:
            return found[0]
        raise


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
    raise InputError(
        f"no column {name!r} for the {what};{hint} the columns are {quoted_list(header)}"
    )


def _guessed(header: Sequence[str], role: str) -> list[int]:
    found = [i for i, name in enumerate(header) if _fits(role, name)]
    return found or [i for i, name in enumerate(header) if _fits_loosely(role, name)]


def _required(header: Sequence[str], role: str) -> int:
    found = _guessed(header, role)
    if len(found) > 1:
        named_column(header, header[found[0]], role)
        options = ", ".join(repr(header[i]) for i in found)
        raise InputError(
            f"columns {options} could each be the {role}; name the one to use with "
            f"`columns={role}={_option(header[found[0]])}`; columns: {quoted_list(header)}"
        )
    if not found:
        raise InputError(
            f"found no column for the {role}; name it with `columns={role}=NAME`; "
            f"columns: {quoted_list(header)}; guessed names: {', '.join(GUESSES[role][:12])}"
        )
    return found[0]


def _option(name: str) -> str:
    return f'"{name}"' if re.search(r"[^\w.]", name) else name


def find_columns(
    header: Sequence[str], named: Mapping[str, str], given: Mapping[str, str] | None = None
) -> tuple[dict[str, int], list[str]]:
    """Index of the column for each role, and what was left open.

    The roles found are the position (latitude and longitude, x and y, or one column with both),
    the level, and what else there is of noise, time, censored and altitude.

    Args:
        header: column names.
        named: ``{role: column name}`` for the roles that are not to be guessed.
        given: roles that the file's format gives, below those named.

    Where both a latitude, longitude pair and an x, y pair can be guessed, latitude and longitude
    are taken. An optional role is left out when more than one column would do.

    Raises:
        InputError: a named role or column does not exist, a role that is needed has no column or
            several, or one column has two roles.
    """
    unknown = [role for role in named if role not in ROLES]
    if unknown:
        raise InputError(f"unknown column role {unknown[0]!r}; known: {', '.join(ROLES)}")
    found = {role: named_column(header, name, role) for role, name in named.items()}
    geographic, metric = ("latitude", "longitude"), ("x", "y")
    if sum(any(r in found for r in pair) for pair in (geographic, metric, ("position",))) > 1:
        raise InputError(
            "columns are named for the position in two ways; name one pair with "
            "`columns`, latitude and longitude, or x and y"
        )
    here = any(r in found for r in (*geographic, *metric, "position"))
    for role, name in (given or {}).items():
        if role not in found and not (here and role in (*geographic, *metric, "position")):
            found[role] = named_column(header, name, role)
    for role in (*_place(header, found), "level"):
        if role not in found:
            found[role] = _required(header, role)
    open_roles = []
    for role in ("noise", "time", "censored", "altitude", "north_south", "east_west"):
        guess = [i for i in _guessed(header, role) if i not in found.values()]
        if role not in found and len(guess) == 1:
            found[role] = guess[0]
        elif role not in found and guess and role != "altitude":
            names = quoted_list([header[i] for i in guess])
            open_roles.append(f"no {role} read: columns {names} would each do")
    taken: dict[int, str] = {}
    for role, index in found.items():
        if index in taken:
            raise InputError(
                f"column {header[index]!r} cannot be both the {taken[index]} and the {role}; name "
                "another for one of them"
            )
        taken[index] = role
    return found, open_roles


def _place(header: Sequence[str], found: Mapping[str, int]) -> tuple[str, ...]:
    """The roles that give the position."""
    ways = (("latitude", "longitude"), ("x", "y"), ("position",))
    for way in ways:
        if any(role in found for role in way):
            return way
    for way in ways:
        if all(_guessed(header, role) for role in way):
            return way
    raise InputError(
        "found no pair of columns for the position; name latitude and longitude, or x and y, with "
        f"`columns=latitude=NAME,longitude=NAME`; columns: {quoted_list(header)}; "
        f"guessed names: {', '.join(GUESSES['latitude'][:4])} with "
        f"{', '.join(GUESSES['longitude'][:4])}, or {', '.join(GUESSES['x'][:3])} with "
        f"{', '.join(GUESSES['y'][:3])}"
    )
