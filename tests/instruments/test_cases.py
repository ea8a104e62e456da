"""What loggers write, after public bug reports: the right readings, or one line with a way out."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.instruments import read_recording, read_series

N = 60
LAT = 48.2 + np.arange(N) * 3e-5
LON = 16.37 + np.arange(N) * 5e-5
LEVEL = np.round(-70 - 8 * np.sin(np.arange(N) / 9), 1)


@pytest.fixture
def log(tmp_path):
    def write(header, row, name="log.csv", before="", n=N):
        lines = [row(i) for i in range(n)]
        path = tmp_path / name
        path.write_text(before + header + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


def comma(value: float, digits: int = 6) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def dms(value: float, letters: str) -> str:
    minutes = value * 60 % 60
    return f"{int(value)}°{int(minutes)}'{minutes * 60 % 60:.3f}\"{letters}"


def plain(i, level=None):
    return f"{LAT[i]:.6f},{LON[i]:.6f},{LEVEL[i] if level is None else level}"


WAYS = {
    "wigle": (
        "MAC,SSID,RSSI,CurrentLatitude,CurrentLongitude",
        lambda i: f'02:00,"lab, north",{LEVEL[i]},{LAT[i]:.6f},{LON[i]:.6f}',
        "WigleWifi-1.6,appRelease=2.80,model=Phone\n",
    ),
    "sep": (
        "lat;lon;rsrp",
        lambda i: f"{comma(LAT[i])};{comma(LON[i])};{comma(LEVEL[i], 1)}",
        "sep=;\n",
    ),
    "comments": ("lat,lon,level_dbm", plain, "# Device: SA\n# Units: deg, deg, dBm\n"),
    "units row": ("lat,lon,rsrp\ndeg,deg,dBm", plain, ""),
    "unit in value": ("lat,lon,rsrp", lambda i: plain(i, f"{LEVEL[i]} dBm"), ""),
    "German": (
        "Zeit;Breite;Länge;Pegel [dBm]",
        lambda i: f"01.05.2024 10:00:{i:02d};{comma(LAT[i])};{comma(LON[i])};{comma(LEVEL[i], 1)}",
        "",
    ),
    "Russian": (
        "Широта;Долгота;Уровень, дБм",
        lambda i: f"{comma(LAT[i])};{comma(LON[i])};{comma(LEVEL[i], 1)}",
        "",
    ),
    "degrees, minutes, seconds": (
        "Latitude;Longitude;RSSI",
        lambda i: f"{dms(LAT[i], 'N')};{dms(LON[i], 'E')};{LEVEL[i]}",
        "",
    ),
    "EdgeTX": (
        "Date,Time,1RSS(dB),2RSS(dB),GPS",
        lambda i: f'2024-05-01,10:00:{i:02d}.000,{LEVEL[i]},0,"{LAT[i]:.6f} {LON[i]:.6f}"',
        "",
    ),
    "degrees as X and Y": ("X,Y,rsrp", lambda i: f"{LON[i]:.6f},{LAT[i]:.6f},{LEVEL[i]}", ""),
}


@pytest.mark.parametrize("way", WAYS)
def test_ways_of_writing_the_same(log, way):
    header, row, before = WAYS[way]
    recording = read_recording(log(header, row, before=before))
    np.testing.assert_allclose(recording.latlon, np.column_stack([LAT, LON]), atol=1.1e-6)
    np.testing.assert_allclose(recording.level_db, LEVEL)
    assert recording.quantity == "power"


@pytest.mark.parametrize("mark", ["-200", "-164", "-340", "100", "2147483647", "-", "Unavailable"])
def test_marks_are_left_out_and_told(log, mark):
    path = log("lat,lon,Level", lambda i: plain(i, mark if i % 4 == 0 else None))
    recording = read_recording(path)
    assert len(recording) == N - N // 4
    assert any(str(N // 4) in note and mark.lstrip("-")[:6] in note for note in recording.notes)


@pytest.mark.parametrize(
    ("level", "why"),
    [
        (lambda i: str(20 + i), "per cent"),
        (lambda i: f"{0.5 + i / 200:.3f}", "a fraction"),
        (lambda i: str(80 + 2 * i), "no receiver survives"),
        (lambda i: f"{-150.5 - i}", "cannot be a"),
    ],
)
def test_what_is_no_power_is_refused(log, level, why):
    with pytest.raises(InputError, match=why):
        read_recording(log("lat,lon,rssi", lambda i: plain(i, level(i))))


def test_limits_take_the_place_of_what_can_be(log):
    path = log("lat,lon,rsrp", lambda i: plain(i, f"{-120.0 - i}"))
    with pytest.raises(InputError, match="level_min_db=-156"):
        read_recording(path)
    recording = read_recording(path, level_min_db=-150.0)
    assert recording.level_db.min() == -150.0
    assert "29 levels outside" in " ".join(recording.notes)


def test_two_cells_at_the_same_places_are_two_maps(log):
    path = log(
        "lat,lon,pci,rsrp",
        lambda i: "\n".join(
            f"{LAT[i]:.6f},{LON[i]:.6f},{pci},{LEVEL[i] - off:.1f}"
            for pci, off in ((101, 0), (257, 25))
        ),
    )
    with pytest.raises(InputError, match=r"2 values of 'pci': 101 \(60 lines\), 257.*where=pci="):
        read_recording(path)
    np.testing.assert_allclose(read_recording(path, where={"pci": "101"}).level_db, LEVEL)
    assert len(read_recording(path, where={"pci": "*"})) == 2 * N
    series = read_series(path, "pci")
    assert sorted(series) == ["101", "257"]
    np.testing.assert_allclose(series["257"].level_db, LEVEL - 25, atol=1e-9)


def test_a_serving_cell_that_changes_is_told(log):
    path = log(
        "lat,lon,CellID,rsrp",
        lambda i: f"{LAT[i] + (i > 30) * 0.01:.6f},{LON[i]:.6f},{1 + (i > 30)},{LEVEL[i]}",
    )
    recording = read_recording(path)
    assert len(recording) == N
    assert any("2 values of 'CellID'" in note for note in recording.notes)


def test_two_altitudes_are_two_maps(log):
    path = log(
        "lat,lon,alt_agl_m,rsrp",
        lambda i: "\n".join(
            f"{LAT[i]:.6f},{LON[i]:.6f},{alt},{LEVEL[i] - off:.1f}"
            for alt, off in ((30, 0), (110, 14))
        ),
    )
    with pytest.raises(InputError, match=r"several altitudes.*30 m \(60 lines\), 110 m"):
        read_recording(path)
    low = read_recording(path, where={"altitude": "25..35"})
    np.testing.assert_allclose(low.level_db, LEVEL)
    with pytest.raises(InputError, match="cannot read the range"):
        read_recording(path, where={"altitude": "35..25"})


def test_hills_are_not_several_altitudes(log):
    path = log("lat,lon,altitude,rsrp", lambda i: f"{LAT[i]:.6f},{LON[i]:.6f},{200 + i},{LEVEL[i]}")
    recording = read_recording(path)
    assert any("from place to place" in note for note in recording.notes)


def test_metres_named_as_degrees_say_so(log):
    path = log("lat,lon,rsrp", lambda i: f"{5339495 + i},{601946 + i},{LEVEL[i]}")
    with pytest.raises(InputError, match=r"if these are metres.*columns=x=NAME,y=NAME"):
        read_recording(path)
