"""Scenarios of DeepMIMO, version 4: a folder with ``params.json`` and, for each transmitter and
receiver set, the paths' powers and the receivers' places.

The channel gain is the sum of the paths' powers, as everywhere in Skygain: phases are left aside.
"""

from __future__ import annotations

__all__ = ["is_scenario", "open_scenario"]

import re
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.points import table_of
from skygain.instruments.tables import Table

_POWER = re.compile(r"power_(t\d+_tx\d+)_(r\d+)\.(npz|mat)")
_WHOLE = "download or convert the scenario again"


def is_scenario(path: Path) -> bool:
    """Whether a path is the folder of a scenario."""
    return path.is_dir() and (path / "params.json").is_file()


def open_scenario(path: Path, max_bytes: int) -> Table:
    """The receivers of a scenario with the channel gain at each, from every transmitter.

    Raises:
        InputError: the folder holds no powers, or one of its files is damaged or too large.
    """
    found = [m for m in map(_POWER.fullmatch, sorted(f.name for f in path.iterdir())) if m]
    if not found:
        raise InputError(
            f"{path.name} holds no powers of paths (power_t…_tx…_r….npz or .mat); {_WHOLE}"
        )
    size = sum((path / m[0]).stat().st_size for m in found)
    if size > max_bytes:
        raise InputError(f"{path.name} has {size / 1e6:,.0f} MB, more than {max_bytes / 1e6:,.0f}")
    parts: list[NDArray[np.float64]] = []
    transmitters: list[str] = []
    for match in found:
        power = _array(path / match[0], "power")
        name = f"rx_pos_{match[1]}_{match[2]}.{match[3]}"
        place = _array(path / name, "rx_pos")
        if power.ndim != 2 or place.shape != (len(power), 3):
            raise InputError(
                f"{path.name}: {match[0]} has {power.shape} powers and {name} {place.shape} "
                f"places; expected a row of powers and x, y, z for each receiver; {_WHOLE}"
            )
        with np.errstate(divide="ignore"):
            gain = 10.0 * np.log10(np.nansum(10.0 ** (power / 10.0), axis=1))
        gain[~np.isfinite(gain)] = np.nan
        parts.append(np.column_stack([place, gain]))
        transmitters += [match[1]] * len(gain)
    rows = np.concatenate(parts)
    silent = int(np.isnan(rows[:, 3]).sum())
    columns = dict(zip(("x", "y", "z", "path_gain_db"), rows.T, strict=True))
    columns["tx"] = np.array(transmitters, dtype=object)
    notes = ["gains are sums of the paths' powers, without their phases"]
    if silent:
        notes.append(f"{silent} of {len(rows)} receivers have no path, left out")
    roles = {"x": "x", "y": "y", "level": "path_gain_db", "altitude": "z"}
    table = table_of(path.name, columns, roles, notes=notes)
    return Table(table.name, table.header, table.load, roles, quantity="gain", notes=table.notes)


def _array(path: Path, key: str) -> NDArray[np.float64]:
    """The array called ``key`` of a file."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                return np.asarray(file[key], dtype=np.float64)
        return np.asarray(loadmat(path)[key], dtype=np.float64)
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, MatReadError,
            NotImplementedError, IndexError, MemoryError) as error:  # fmt: skip
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"{path.name} is no readable part of a DeepMIMO scenario ({reason}); {_WHOLE}"
        ) from error
