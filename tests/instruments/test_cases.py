"""What loggers write, after public bug reports: the right readings, or one line with a way out."""

from __future__ import annotations

import json
import re

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
    "spaces": ("lat lon   rsrp", lambda i: f"{LAT[i]:.6f}  {LON[i]:.6f} {LEVEL[i]}", ""),
    "words in the names": (
        "Time,All-Latitude,All-Longitude,Serving Cell RSRP (dBm),RSRP (LTE detected),cell lat",
        lambda i: f"10:00:{i:02d},{plain(i)},-99,40",
        "",
    ),
    "letters of their own": (
        "lat,lat_dir,lon,lon_dir,rsrp",
        lambda i: f"{LAT[i]:.6f},N,{LON[i]:.6f},E,{LEVEL[i]}",
        "",
    ),
    "steps of 1e-7": (
        "latitudeE7,longitudeE7,rsrp",
        lambda i: f"{round(LAT[i] * 1e7)},{round(LON[i] * 1e7)},{LEVEL[i]}",
        "",
    ),
    "milliwatts": ("lat,lon,power_mw", lambda i: plain(i, f"{10 ** (LEVEL[i] / 10):.9e}"), ""),
    "dBW": ("lat,lon,power [dBW]", lambda i: plain(i, f"{LEVEL[i] - 30:.1f}"), ""),
    "degrees as X and Y": ("X,Y,rsrp", lambda i: f"{LON[i]:.6f},{LAT[i]:.6f},{LEVEL[i]}", ""),
}


@pytest.mark.parametrize("way", WAYS)
def test_ways_of_writing_the_same(log, way):
    header, row, before = WAYS[way]
    recording = read_recording(log(header, row, before=before))
    np.testing.assert_allclose(recording.latlon, np.column_stack([LAT, LON]), atol=1.1e-6)
    np.testing.assert_allclose(recording.level_db, LEVEL)
    assert recording.quantity == "power"


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "utf-8-sig"])
def test_encodings_of_spreadsheets(tmp_path, encoding):
    lines = [
        f"{comma(a)};{comma(o)};{comma(v, 1)}" for a, o, v in zip(LAT, LON, LEVEL, strict=True)
    ]
    text = "Breite;Länge;Pegel\n" + "\n".join(lines)
    (tmp_path / "log.csv").write_bytes(text.encode(encoding))
    recording = read_recording(tmp_path / "log.csv")
    np.testing.assert_allclose(recording.level_db, LEVEL)


@pytest.mark.parametrize("name", ["log.json", "log.jsonl"])
def test_plain_objects(tmp_path, name):
    rows = [
        {"gps": {"lat": a, "lon": o}, "rsrp": v} for a, o, v in zip(LAT, LON, LEVEL, strict=True)
    ]
    text = json.dumps(rows) if name == "log.json" else "\n".join(map(json.dumps, rows))
    (tmp_path / name).write_text(text, encoding="utf-8")
    recording = read_recording(tmp_path / name)
    np.testing.assert_allclose(recording.latlon, np.column_stack([LAT, LON]))
    np.testing.assert_allclose(recording.level_db, LEVEL)


def test_letters_of_south_and_west_turn_the_sign(log):
    row = lambda i: f"{LAT[i]:.6f},S,{LON[i]:.6f},W,{LEVEL[i]}"  # noqa: E731
    recording = read_recording(log("lat,N/S,lon,E/W,rsrp", row))
    np.testing.assert_allclose(recording.latlon, -np.column_stack([LAT, LON]), atol=1.1e-6)


def test_lengths_in_feet_and_kilometres_become_metres(log):
    path = log("x_ft,y_ft,rsrp", lambda i: f"{i * 10},{i * 20},{LEVEL[i]}")
    np.testing.assert_allclose(read_recording(path).xy_m[-1], [590 * 0.3048, 1180 * 0.3048])
    path = log("X [km],Y [km],rsrp", lambda i: f"{i * 0.01},{i * 0.02},{LEVEL[i]}")
    np.testing.assert_allclose(read_recording(path).xy_m[-1], [590, 1180])


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
        (lambda i: f"{40 + i // 2}%", "no numbers but '40%'.*per cent"),
    ],
)
def test_what_is_no_power_is_refused(log, level, why):
    with pytest.raises(InputError, match=why):
        read_recording(log("lat,lon,rssi", lambda i: plain(i, level(i))))


@pytest.mark.parametrize("column", ["level_dbuv", "Field strength (dBµV/m)"])
def test_a_voltage_is_no_power(log, column):
    with pytest.raises(InputError, match="dBµV"):
        read_recording(log(f"lat,lon,{column}", lambda i: plain(i, LEVEL[i] + 107)))


@pytest.mark.parametrize(
    "column", ["Band", "frequency_mhz", "SSB index", "operator", "tx_id", "technology", "gateway"]
)
def test_signals_told_apart_by_any_column_are_several_maps(log, column):
    path = log(
        f"lat,lon,{column},rssi",
        lambda i: "\n".join(f"{LAT[i]:.6f},{LON[i]:.6f},{v},{LEVEL[i] - v}" for v in (3, 20)),
    )
    with pytest.raises(InputError, match=f"2 values of '{column}'"):
        read_recording(path)


@pytest.mark.parametrize(
    ("column", "values", "choice"),
    [
        ("height_above_takeoff(meters)", (30, 110), "25..35"),
        ("altitude_ft", (100, 360), "84..116"),
        ("alt [m] (relative)", ("30 m", "110 m"), "25..35"),
    ],
)
def test_altitudes_by_other_names_and_units(log, column, values, choice):
    path = log(
        f"lat,lon,{column},rsrp",
        lambda i: "\n".join(f"{LAT[i]:.6f},{LON[i]:.6f},{v},{LEVEL[i]}" for v in values),
    )
    with pytest.raises(InputError, match=re.escape(choice)):
        read_recording(path)
    assert len(read_recording(path, where={column: choice})) == N


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


def kml(body: str) -> str:
    return f"<kml xmlns='http://www.opengis.net/kml/2.2'><Document>{body}</Document></kml>"


PLACES = {
    "remark.kml": (
        kml,
        lambda i: (
            f"<Placemark><description>PCI: 7; RSRP: {LEVEL[i]} dBm</description><Point>"
            f"<coordinates>{LON[i]},{LAT[i]}</coordinates></Point></Placemark>"
        ),
    ),
    "table.kml": (
        kml,
        lambda i: (
            "<Placemark><description><![CDATA[<table><tr><td>RSRP</td><td>"
            f"{LEVEL[i]}</td></tr></table>]]></description><Point>"
            f"<coordinates>{LON[i]},{LAT[i]}</coordinates></Point></Placemark>"
        ),
    ),
    "attributes.gpx": (
        "<gpx><trk><trkseg>{}</trkseg></trk></gpx>".format,
        lambda i: (
            f"<trkpt lat='{LAT[i]}' lon='{LON[i]}'><extensions><cell rsrp='{LEVEL[i]}' "
            "pci='7'/></extensions></trkpt>"
        ),
    ),
}


@pytest.mark.parametrize("name", PLACES)
def test_levels_in_remarks_and_attributes(tmp_path, name):
    whole, row = PLACES[name]
    (tmp_path / name).write_text(whole("".join(map(row, range(N)))), encoding="utf-8")
    recording = read_recording(tmp_path / name)
    np.testing.assert_allclose(recording.latlon, np.column_stack([LAT, LON]))
    np.testing.assert_allclose(recording.level_db, LEVEL)


@pytest.mark.parametrize("points", [False, True])
def test_columns_of_parquet(tmp_path, points):
    pytest.importorskip("pyarrow")
    pandas, shapely = pytest.importorskip("pandas"), pytest.importorskip("shapely")
    place = {"lat": LAT, "lon": LON}
    if points:
        place = {"geometry": shapely.to_wkb(shapely.points(LON, LAT))}
    pandas.DataFrame({**place, "rsrp": LEVEL}).to_parquet(tmp_path / "p.parquet")
    recording = read_recording(tmp_path / "p.parquet")
    np.testing.assert_allclose(recording.latlon, np.column_stack([LAT, LON]))
    np.testing.assert_allclose(recording.level_db, LEVEL)
