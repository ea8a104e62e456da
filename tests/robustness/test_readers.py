"""Damaged files of every format: a sound city or recording, or one line; never a traceback, a crash
or a hang, in bounded memory.

Some hundreds by default; ``SKYGAIN_TRIALS=100`` reads a hundred thousand.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from .processes import TRIALS

CITIES = Path(__file__).parents[1] / "cities" / "data"
N = 40
MUTANTS = 500 * TRIALS if TRIALS > 1 else 150
"""of cities, and as many of logs"""


@pytest.fixture(scope="module")
def cities(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("rasterio")
    geopandas = pytest.importorskip("geopandas")
    folder = tmp_path_factory.mktemp("cities")
    for path in CITIES.iterdir():
        if path.suffix != ".gfs" and path.stat().st_size < 30_000:
            shutil.copy(path, folder)
    frame = geopandas.read_file(CITIES / "city.geojson")
    frame.to_file(folder / "city.gpkg")
    if shutil.which("true") and _has("pyarrow"):
        frame.to_parquet(folder / "city.parquet")
    return folder


def _has(module: str) -> bool:
    import importlib.util

    return importlib.util.find_spec(module) is not None


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    lat, lon = 48.2 + np.arange(N) * 3e-5, 16.37 + np.arange(N) * 5e-5
    rows = [(a, o, -70 - i % 9, i) for i, (a, o) in enumerate(zip(lat, lon, strict=True))]

    def text(name: str, head: str, row: str) -> None:
        lines = [row.format(a=a, o=o, v=v, i=i) for a, o, v, i in rows]
        (folder / name).write_text("\n".join([*head.split("|"), *lines]) + "\n", encoding="utf-8")

    text("plain.csv", "time,lat,lon,rsrp,pci", "2026-05-01T10:00:{i:02d}Z,{a:.6f},{o:.6f},{v},7")
    text("sep.csv", "sep=;|lat;lon;rsrp", "{a:.6f};{o:.6f};{v},5")
    text("units.tsv", "# a log|lat\tlon\trsrp|deg\tdeg\tdBm", "{a:.6f}\t{o:.6f}\t{v}")
    text("metres.txt", "x y level", "{i}.5 {i}.25 {v}")
    text("wkt.csv", "geometry,rsrp,censored,noise_std_db", '"POINT ({o} {a})",{v},0,1.5')
    text("lines.jsonl", "", '{{"lat": {a}, "lon": {o}, "rsrp": {v}}}')
    (folder / "lines.jsonl").write_text((folder / "lines.jsonl").read_text().lstrip())
    text("power.t001_01.r002.p2m", "# Power (dBm)", "{i} {i}.0 2.0E+01 1.5 30.0 {v}.5")
    mark = "<Placemark><ExtendedData><Data name='rsrp'><value>{v}</value></Data></ExtendedData>"
    mark += "<Point><coordinates>{o},{a},30</coordinates></Point></Placemark>"
    text("points.kml", "<kml xmlns='http://www.opengis.net/kml/2.2'><Document>", mark)
    point = "<trkpt lat='{a}' lon='{o}'><ele>30</ele><extensions><rsrp>{v}</rsrp></extensions>"
    text("track.gpx", "<gpx><trk><trkseg>", point + "</trkpt>")
    for name, end in (("points.kml", "</Document></kml>"), ("track.gpx", "</trkseg></trk></gpx>")):
        (folder / name).write_text((folder / name).read_text() + end)
    if _has("geopandas"):
        import geopandas
        import shapely

        frame = geopandas.GeoDataFrame(
            {"rsrp": [v for *_, v, _ in rows]}, geometry=shapely.points(lon, lat), crs=4326
        )
        frame.to_file(folder / "p.gpkg")
        frame.to_file(folder / "p.geojson")
        frame.to_file(folder / "p.fgb")
    if _has("pymavlink") and _has("pyulog"):
        _flight_logs(folder, lat, lon)
    return folder


def _flight_logs(folder: Path, lat: np.ndarray, lon: np.ndarray) -> None:
    import struct

    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    from tests.instruments.conftest import _dataflash, _ulog

    sender, log = mavlink.MAVLink(None, srcSystem=1), bytearray()
    for i in range(N):
        place = (i * 1000, int(lat[i] * 1e7), int(lon[i] * 1e7), 300_000, 30_000, 0, 0, 0, 0)
        for message in (
            sender.global_position_int_encode(*place),
            sender.radio_status_encode(150 - i, 140, 100, 20, 20, 0, 0),
        ):
            log += struct.pack(">Q", 1_700_000_000_000_000 + i * 1_000_000) + message.pack(sender)
    (folder / "flight.tlog").write_bytes(bytes(log))
    _dataflash(folder / "flight.bin", [(i * 10**6, lat[i], lon[i], -70.0 - i) for i in range(N)])
    at = [(i * 10**6, float(lat[i]), float(lon[i]), 300.0) for i in range(N)]
    level = [(i * 10**6, -80.0 - i) for i in range(N)]
    _ulog(
        folder / "flight.ulg",
        {
            "vehicle_global_position": (
                "Qddf", "uint64_t timestamp;double lat;double lon;float alt", at
            ),
            "cellular_status": ("Qf", "uint64_t timestamp;float rx_level", level),
        },
    )  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
@pytest.mark.parametrize("kind", ["city", "log"])
def test_damaged_files(
    kind: str, request: pytest.FixtureRequest, record_property: Callable[[str, object], None]
) -> None:
    folder = request.getfixturevalue({"city": "cities", "log": "logs"}[kind])
    words = [sys.executable, "-m", "tests.robustness.mutants", str(folder), kind, "0", str(MUTANTS)]
    child = subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2]
    )
    *bad, last = child.stdout.splitlines() or [""]
    assert last.startswith("done: "), (last, child.stderr[-1000:])
    record_property("trials", f"{kind}: {last.removeprefix('done: ')}")
    assert not bad, "\n".join(bad)
