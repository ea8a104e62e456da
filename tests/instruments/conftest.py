"""Logs in the formats of autopilots, written as these write them."""

from __future__ import annotations

import struct

import pytest


def _ulog(path, topics):
    """A minimal ULog: ``{topic: (C format, field types, rows)}``, each row begins with the time in
    µs."""
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]

    def message(kind, body):
        out.append(struct.pack("<HB", len(body), ord(kind)) + body)

    message("B", bytes(40))
    for name, (_, fields, _) in topics.items():
        message("F", f"{name}:{fields};".encode())
    for number, name in enumerate(topics):
        message("A", struct.pack("<BH", 0, number) + name.encode())
    for number, (code, _, rows) in enumerate(topics.values()):
        for row in rows:
            message("D", struct.pack("<H", number) + struct.pack("<" + code, *row))
    path.write_bytes(b"".join(out))
    return path


def _dataflash(path, rows):
    """A minimal ArduPilot log: its own description, GPS and RSSI messages."""

    def fmt(number, length, name, code, labels):
        return b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, length, name.encode(), code.encode(), labels.encode()
        )

    out = [
        fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
        fmt(
            130,
            31,
            "GPS",
            "QBIHBLLf",
            "TimeUS,Status,GMS,GWk,NSats,Lat,Lng,Alt",
        ),
        fmt(131, 3 + 8 + 4, "MODM", "Qf", "TimeUS,RSRP"),
    ]
    for time_us, lat, lon, level in rows:
        gps = (time_us, 3, time_us // 1000, 2300, 12, int(lat * 1e7), int(lon * 1e7), 30.0)
        out.append(b"\xa3\x95\x82" + struct.pack("<QBIHBiif", *gps))
        out.append(b"\xa3\x95\x83" + struct.pack("<Qf", time_us, level))
    path.write_bytes(b"".join(out))
    return path


@pytest.fixture(scope="session")
def ulog():
    """Writes a PX4 log."""
    return _ulog


@pytest.fixture(scope="session")
def dataflash():
    """Writes an ArduPilot log."""
    return _dataflash
