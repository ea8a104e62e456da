"""Levels are read out of flight logs at the places where they were heard."""

from __future__ import annotations

import importlib.util
import struct

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.instruments import read_recording, read_series

N = 40
LAT, LON = 48.2 + np.arange(N) * 1e-5, 16.37 + np.arange(N) * 2e-5


def position():
    rows = [(int(i * 1e6), float(LAT[i]), float(LON[i]), 300.0) for i in range(N)]
    return "Qddf", "uint64_t timestamp;double lat;double lon;float alt", rows


def test_px4_cellular_status_is_found_and_its_zeros_are_left_out(tmp_path, ulog):
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


def test_any_field_can_be_the_level(tmp_path, ulog):
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


def test_no_position_is_made_up(tmp_path, ulog):
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


@pytest.fixture(scope="module")
def cellular_dialect(tmp_path_factory):
    """MAVLink's own definition of the message, built by pymavlink's generator."""
    pytest.importorskip("pymavlink")
    mavgen = pytest.importorskip("pymavlink.generator.mavgen")
    fields = "".join(
        f'<field type="{kind}" name="{name}">x</field>' if kind else "<extensions/>"
        for kind, name in (
            *(("uint8_t", n) for n in ("status", "failure_reason", "type", "quality")),
            *(("uint16_t", n) for n in ("mcc", "mnc", "lac")),
            (None, ""),
            ("uint8_t", "id"),
            *(("uint32_t", n) for n in ("link_tx_rate", "link_rx_rate")),
            ("char[9]", "cell_tower_id"),
            ("uint8_t", "band_number"),
            ("float", "band_frequency"),
            ("uint32_t", "channel_number"),
            *(("float", n) for n in ("rx_level", "tx_level", "rx_quality", "sinr")),
        )
    )
    folder = tmp_path_factory.mktemp("dialect")
    (folder / "cell.xml").write_text(
        '<?xml version="1.0"?><mavlink><messages><message id="334" name="CELLULAR_STATUS">'
        f"<description>x</description>{fields}</message></messages></mavlink>"
    )
    mavgen.mavgen(
        mavgen.Opts(str(folder / "cell"), wire_protocol="2.0", language="Python3", validate=False),
        [str(folder / "cell.xml")],
    )
    spec = importlib.util.spec_from_file_location("cell", folder / "cell.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_mavlink_cellular_status_is_found_by_itself(tmp_path, cellular_dialect):
    """Its message was made by pymavlink, which does not know it otherwise; 0 dBm is no level, and a
    frame with a wrong checksum is none."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    places, modem = mavlink.MAVLink(None, srcSystem=1), cellular_dialect.MAVLink(None, srcSystem=1)
    log = bytearray()
    for i in range(N):
        stamp = struct.pack(">Q", 1_700_000_000_000_000 + i * 1_000_000)
        lat, lon = round(LAT[i] * 1e7), round(LON[i] * 1e7)
        place = places.global_position_int_encode(i * 1000, lat, lon, 300_000, 30_000, 0, 0, 0, 0)
        level = 0.0 if i == 3 else -80.0 - i
        cell = modem.cellular_status_encode(
            9, 0, 4, 70, 232, 1, 11, 1, 0, 0, b"123456789" if i < 30 else b"77", 3, 1800.0, 1300,
            level, 20.0, -11.0, 12.5,
        )  # fmt: skip
        frame = bytearray(cell.pack(modem))
        if i == 5:
            frame[12] ^= 0xFF
        log += stamp + place.pack(places) + stamp + frame
    path = tmp_path / "flight.tlog"
    path.write_bytes(bytes(log))
    recording = read_recording(path)
    heard = [i for i in range(N) if i not in (3, 5)]
    np.testing.assert_allclose(recording.level_db, -80.0 - np.array(heard))
    np.testing.assert_allclose(recording.latlon[:, 0], LAT[heard], atol=1e-7)
    assert any("2 values of 'CELLULAR_STATUS.cell_tower_id'" in n for n in recording.notes)
    series = read_series(path, "CELLULAR_STATUS.cell_tower_id")
    assert {k: len(v) for k, v in series.items()} == {"123456789": 28, "77": 10}
    sinr = read_recording(path, columns={"level": "CELLULAR_STATUS.sinr"}, quantity="gain",
                          level_max_db=60.0)  # fmt: skip
    assert set(sinr.level_db) == {12.5}


def test_ardupilot_log(tmp_path, dataflash):
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
