"""CELLULAR_STATUS, what a cellular modem on board tells, of MAVLink and PX4.

The message grew in 2026: received level, quality, SINR, tower and channel stand in extension fields
of which 0 means "none". The dialects that pymavlink ships do not have the message at all, so it is
taken apart here, by the layout of ``common.xml``: fields by size, then the extensions in their
order.
"""

from __future__ import annotations

__all__ = ["MESSAGE", "NAME", "decoded", "told"]

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import require

MESSAGE, NAME = "UNKNOWN_334", "CELLULAR_STATUS"
"""what pymavlink calls a message with this number, and what it is"""

_FIELDS = "mcc mnc lac status failure_reason type quality modem link_tx_rate link_rx_rate"
_FIELDS += " cell_tower_id band_number band_frequency channel_number rx_level tx_level rx_quality"
_NAMES = (*_FIELDS.split(), "sinr")
_LAYOUT = struct.Struct("<HHHBBBBBII9sBfIffff")
_CRC_EXTRA = 72
_START, _HEADER = 0xFD, 10


def decoded(frame: bytes) -> dict[str, Any] | None:
    """The fields of a frame of MAVLink 2 with this message; ``None`` for a damaged one."""
    mavcrc = require("pymavlink.generator.mavcrc", "logs")
    if len(frame) < _HEADER + 2 or frame[0] != _START:
        return None
    size = frame[1]
    payload, check = frame[_HEADER : _HEADER + size], frame[_HEADER + size : _HEADER + size + 2]
    crc = mavcrc.x25crc(bytes(frame[1 : _HEADER + size]))
    crc.accumulate(bytes([_CRC_EXTRA]))
    if len(payload) != size or bytes(check) != struct.pack("<H", crc.crc):
        return None
    whole = bytes(payload).ljust(_LAYOUT.size, b"\0")[: _LAYOUT.size]
    values = dict(zip(_NAMES, _LAYOUT.unpack(whole), strict=True))
    values["cell_tower_id"] = tower(values["cell_tower_id"])
    return values


def tower(text: bytes) -> str:
    """The tower's name, empty where there is none."""
    name = text.split(b"\0")[0].decode("ascii", errors="replace").strip()
    return "" if name == "0" else name


def told(fields: dict[str, NDArray]) -> dict[str, NDArray]:
    """PX4's fields of the message with the letters of the tower put together and the number of the
    modem by its name."""
    letters = [
        fields.pop(f"cell_tower_id[{i}]") for i in range(9) if f"cell_tower_id[{i}]" in fields
    ]
    if letters:
        rows = np.stack(letters, axis=-1).astype(np.uint8)
        fields["cell_tower_id"] = np.array([tower(bytes(row)) for row in rows], dtype=object)
    if "id" in fields:
        fields["modem"] = fields.pop("id")
    return fields
