"""Levels are read out of flight logs at the places where they were heard."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.instruments import read_recording

N = 40
LAT, LON = 48.2 + np.arange(N) * 1e-5, 16.37 + np.arange(N) * 2e-5


def ulog(path, topics):
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


def position():
    rows = [(int(i * 1e6), float(LAT[i]), float(LON[i]), 300.0) for i in range(N)]
    return "Qddf", "uint64_t timestamp;double lat;double lon;float alt", rows


def test_px4_cellular_status_is_found_and_its_zeros_are_left_out(tmp_path):
    pytest.importorskip("pyulog")
    level = [0.0 if i % 10 == 0 else -80.0 - i for i in range(N - 1)]
    rows = [(int(i * 1e6 + 5e5), level[i]) for i in range(N - 1)]
    log = ulog(
        tmp_path / "flight.ulg",
        {
            "vehicle_global_position": position(),
            "cellular_status": ("Qf", "uint64_t timestamp;float rx_level", rows),
        },
    )
    recording = read_recording(log)
    assert recording.quantity == "power"
    assert len(recording) == sum(v != 0 for v in level)
    assert any("has no value" in note for note in recording.notes)
    heard = [i for i in range(N - 1) if level[i] != 0]
    np.testing.assert_allclose(recording.level_db, np.array(level)[heard], rtol=1e-6)
    np.testing.assert_allclose(recording.latlon[:, 0], LAT[heard] + 0.5e-5, atol=1e-9)
    np.testing.assert_allclose(recording.time_s[:2], [0.0, 1.0])


def test_any_field_can_be_the_level(tmp_path):
    pytest.importorskip("pyulog")
    rows = [(int(i * 1e6), 100 + i, 7) for i in range(N)]
    log = ulog(
        tmp_path / "flight.ulg",
        {
            "vehicle_global_position": position(),
            "radio_status": ("QBB", "uint64_t timestamp;uint8_t rssi;uint8_t noise", rows),
        },
    )
    with pytest.raises(InputError, match=r"no CELLULAR_STATUS.*level=MESSAGE.field.*radio_status"):
        read_recording(log)
    with pytest.raises(InputError, match=r"no field 'radio_status\.snr'"):
        read_recording(log, columns={"level": "radio_status.snr"})
    recording = read_recording(log, columns={"level": "RADIO_STATUS.rssi"})
    np.testing.assert_allclose(recording.level_db, (100 + np.arange(N)) / 1.9 - 127)
    assert any("SiK" in note for note in recording.notes)


def test_no_position_is_made_up(tmp_path):
    pytest.importorskip("pyulog")
    code, fields, rows = position()
    gap = [row for row in rows if not 10 <= row[0] / 1e6 < 20]
    levels = [(int(i * 1e6), -80.0) for i in range(N)]
    log = ulog(
        tmp_path / "gap.ulg",
        {
            "vehicle_global_position": (code, fields, gap),
            "modem": ("Qf", "uint64_t timestamp;float rsrp", levels),
        },
    )
    recording = read_recording(log, columns={"level": "modem.rsrp"})
    assert len(recording) == N - 10
    assert any("10 of 40 levels left out" in note for note in recording.notes)


def test_mavlink_radio_status(tmp_path):
    pytest.importorskip("pymavlink")
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    log = bytearray()
    for i in range(N):
        for message in (
            sender.global_position_int_encode(
                i * 1000, int(LAT[i] * 1e7), int(LON[i] * 1e7), 300_000, 30_000, 0, 0, 0, 0
            ),
            sender.radio_status_encode(150 - i, 140, 100, 20, 20, 0, 0),
        ):
            log += struct.pack(">Q", 1_700_000_000_000_000 + i * 1_000_000)
            log += message.pack(sender)
    path = tmp_path / "flight.tlog"
    path.write_bytes(bytes(log))
    recording = read_recording(path, columns={"level": "RADIO_STATUS.rssi"})
    np.testing.assert_allclose(recording.latlon[:, 1], np.trunc(LON * 1e7) / 1e7, atol=2e-7)
    np.testing.assert_allclose(recording.level_db, (150 - np.arange(N)) / 1.9 - 127)


def dataflash(path, rows):
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


def test_ardupilot_log(tmp_path):
    pytest.importorskip("pymavlink")
    rows = [(i * 1_000_000, LAT[i], LON[i], -70.0 - i) for i in range(N)]
    log = dataflash(tmp_path / "flight.bin", rows)
    recording = read_recording(log, columns={"level": "MODM.RSRP"})
    np.testing.assert_allclose(recording.level_db, -70.0 - np.arange(N), rtol=1e-6)
    np.testing.assert_allclose(recording.latlon[:, 0], LAT, atol=2e-7)


@pytest.mark.parametrize("suffix", [".ulg", ".bin", ".tlog"])
def test_rubbish_is_one_line(tmp_path, suffix):
    pytest.importorskip("pyulog")
    pytest.importorskip("pymavlink")
    path = tmp_path / f"log{suffix}"
    path.write_bytes(bytes(range(256)) * 20)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
