"""Which reader a log's file needs: one function from a path to a table."""

from __future__ import annotations

__all__ = ["open_table"]

from pathlib import Path

from skygain.ground.errors import InputError
from skygain.instruments.deepmimo import is_scenario, open_scenario
from skygain.instruments.delimited import open_delimited
from skygain.instruments.flight_logs import LOG_SUFFIXES, open_flight_log
from skygain.instruments.insite import open_p2m
from skygain.instruments.points import POINT_SUFFIXES, open_points
from skygain.instruments.tables import Table


def open_table(path: Path, max_bytes: int, level: str | None) -> Table:
    """The table in a log, by the ending of its file; any other ending is text.

    Args:
        path: the file.
        max_bytes: refuse larger files.
        level: the level's column, which a flight log needs to know.

    Raises:
        InputError: there is no file, it is too large, or it cannot be read.
    """
    if is_scenario(path):
        return open_scenario(path, max_bytes)
    if not path.is_file():
        raise InputError(f"no file {str(path)!r}; give the path of a log (CSV, GeoPackage, …)")
    try:
        size = path.stat().st_size
        with path.open("rb") as raw:
            head = raw.read(65536)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if size > max_bytes:
        raise InputError(
            f"{path.name} has {size / 1e6:,.0f} MB, more than {max_bytes / 1e6:,.0f} MB; split it, "
            "or raise max_bytes"
        )
    suffix = path.suffix.lower()
    if head and suffix in LOG_SUFFIXES:
        return open_flight_log(path, level)
    if head and suffix in POINT_SUFFIXES:
        return open_points(path)
    if head and suffix == ".p2m":
        return open_p2m(path)
    return open_delimited(path, head)
