"""Whatever bytes a file holds, the reader gives a sound recording or says in one line why not."""

from __future__ import annotations

import io
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import currently_in_test_context, event, given, settings
from hypothesis import strategies as st

from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments import GriddedRecording, grid_for, on_grid, read_recording
from skygain.instruments.levels import MAX_LEVEL_DB

NAMES = st.sampled_from(
    [
        "lat",
        "lon",
        "Latitude",
        "longitude",
        "x",
        "y",
        "rsrp",
        "rsrp",
        "RSSI",
        "path_loss",
        "gain_db",
        "time",
        "censored",
        "noise_std_db",
        "PCI",
        "",
    ]
)
FIELDS = st.one_of(
    st.floats(-200, 200).map(lambda v: f"{v:.5g}"),
    st.integers(-180, 180).map(str),
    st.sampled_from(
        [
            "",
            "nan",
            "inf",
            "-inf",
            "1e400",
            "1_0",
            "0",
            "1",
            "-90,5",
            '"',
            "'",
            "a;b",
            "2147483647",
            "NULL",
            "\x00",
            "٣",
            "2024-05-01",
        ]
    ),
    st.text(max_size=6),
)
LINES = st.lists(FIELDS, max_size=7)
OPTIONS = st.fixed_dictionaries(
    {},
    optional={
        "skip_bad": st.booleans(),
        "eirp_dbm": st.one_of(st.none(), st.floats()),
        "quantity": st.sampled_from([None, "power", "gain", "loss", "watts"]),
        "where": st.dictionaries(
            st.sampled_from(["PCI", "lat", "nothing"]),
            st.sampled_from(["", "1", 1, "A"]),
            max_size=2,
        ),
        "columns": st.dictionaries(
            st.sampled_from(["level", "latitude", "x", "time", "colour"]), NAMES, max_size=2
        ),
        "recording_crs": st.sampled_from([None, "local", "EPSG:32617", "EPSG:4326", "nonsense"]),
    },
)


def outcome(content: bytes, options: dict, suffix: str = ".csv") -> None:
    """Read ``content`` and check that the recording, if there is one, is sound and can be brought
    onto a map or is refused."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"garbage{suffix}"
        path.write_bytes(content)
        recording, message = None, ""
        try:
            recording = read_recording(path, **options)
        except InputError as error:
            message = str(error)
    if currently_in_test_context():
        event("read" if recording else f"refused: {message.split(';')[0][:30]}")
    if recording is None:
        assert message
        assert "\n" not in message
        return
    n = len(recording)
    assert n >= 1
    assert np.isfinite(recording.level_db).all()
    assert (np.abs(recording.level_db) <= 2 * MAX_LEVEL_DB).all()
    assert recording.quantity in ("power", "gain")
    assert (recording.latlon is None) != (recording.xy_m is None)
    position = recording.latlon if recording.xy_m is None else recording.xy_m
    assert position.shape == (n, 2)
    assert np.isfinite(position).all()
    if recording.latlon is not None:
        assert (np.abs(recording.latlon[:, 0]) <= 90).all()
    assert recording.line.shape == (n,)
    assert (np.diff(recording.line) > 0).all()
    for column in (recording.time_s, recording.noise_std_db, recording.censored):
        assert column is None or (column.shape == (n,) and np.isfinite(column).all())
    for make_grid in (
        lambda: Grid((20, 20), 20.0, (-200.0, -200.0), crs=recording.crs),
        lambda: grid_for(recording, 50.0),
    ):
        try:
            gridded = on_grid(recording, make_grid())
        except InputError:
            continue
        sound(gridded, n)


def sound(gridded: GriddedRecording, n: int) -> None:
    """Check the values of cells made from ``n`` readings."""
    assert gridded.count.sum() + gridded.outside == n
    assert np.isfinite(gridded.level_db).all()
    assert (gridded.noise_std_db >= 0).all()
    assert len(gridded.measurements()) == len(gridded)


@settings(max_examples=250, deadline=None)
@given(content=st.binary(max_size=300), options=OPTIONS)
def test_random_bytes(content, options):
    outcome(content, options)


@settings(max_examples=250, deadline=None)
@given(header=st.binary(max_size=60), options=OPTIONS)
def test_random_bytes_below_a_good_header(header, options):
    outcome(b"lat,lon,rsrp\n36,-78,-90\n" + header, options)


@settings(max_examples=200, deadline=None)
@given(
    header=st.lists(NAMES, min_size=1, max_size=7),
    lines=st.lists(LINES, max_size=6),
    sep=st.sampled_from([",", ";", "\t"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    mark=st.booleans(),
    options=OPTIONS,
)
def test_random_tables(header, lines, sep, end, mark, options):
    text = end.join([sep.join(header), *(sep.join(line) for line in lines)])
    outcome((b"\xef\xbb\xbf" if mark else b"") + text.encode(errors="surrogatepass"), options)


@settings(max_examples=200, deadline=None)
@given(
    rows=st.lists(st.tuples(st.floats(), st.floats(), st.floats()), min_size=1, max_size=8),
    names=st.sampled_from(["lat,lon,rsrp", "x,y,gain", "x,y,path_loss"]),
    skip_bad=st.booleans(),
)
def test_numbers_of_any_size(rows, names, skip_bad):
    text = names + "\n" + "\n".join(",".join(map(repr, row)) for row in rows)
    outcome(text.encode(), {"skip_bad": skip_bad})


GOOD = {
    "lat,lon,rsrp": ("35.{0}", "-78.{0}", "-9{0}.5"),
    "x,y,path_loss,time": ("{0}0", "-{0}5", "1{0}0", "{0}.5"),
    "x_m,y_m,gain_db,noise_std_db,censored": ("{0}00", "{0}", "-1{0}0", "0.{0}", "1"),
    "PCI,lat,lon,rssi": ("A", "36.0{0}", "-78.9{0}", "-7{0}"),
}


@settings(max_examples=300, deadline=None)
@given(
    data=st.data(),
    header=st.sampled_from(sorted(GOOD)),
    skip_bad=st.booleans(),
    sep=st.sampled_from([",", ";"]),
)
def test_damaged_campaigns(data, header, skip_bad, sep):
    lines = [header.split(",")]
    for digit in data.draw(st.lists(st.integers(0, 9), min_size=1, max_size=8)):
        lines.append([field.format(digit) for field in GOOD[header]])
    for _ in range(data.draw(st.integers(0, 3))):
        line = lines[data.draw(st.integers(0, len(lines) - 1))]
        line[data.draw(st.integers(0, len(line) - 1))] = data.draw(FIELDS)
    outcome(
        "\n".join(sep.join(line) for line in lines).encode(errors="surrogatepass"),
        {"skip_bad": skip_bad},
    )


def _kml() -> bytes:
    marks = "".join(
        f"<Placemark><name>{i}</name><ExtendedData><Data name='RSRP'><value>-7{i} dBm</value>"
        f"</Data></ExtendedData><Point><coordinates>16.37{i},48.2{i},0</coordinates></Point>"
        "</Placemark>"
        for i in range(6)
    )
    head = '<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
    return f"{head}{marks}</Document></kml>".encode()


def _gpx() -> bytes:
    points = "".join(
        f'<trkpt lat="48.2{i}" lon="16.37{i}"><ele>30</ele><time>2024-05-01T10:00:0{i}Z</time>'
        f"<extensions><rsrp>-7{i}</rsrp></extensions></trkpt>"
        for i in range(6)
    )
    head = '<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1">'
    return f"{head}<trk><trkseg>{points}</trkseg></trk></gpx>".encode()


def _kmz() -> bytes:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w") as archive:
        archive.writestr("doc.kml", _kml())
    return memory.getvalue()


def _p2m() -> bytes:
    rows = "".join(f"{i} {i * 5:.3e} 10 1.5 {i + 3} {90 + i}\n" for i in range(1, 9))
    return f"# Receiver X Y Z Distance Path Loss (dB)\n{rows}".encode()


def _vector(suffix: str) -> bytes:
    geopandas = pytest.importorskip("geopandas")
    ways = np.arange(12) * 1e-4
    frame = geopandas.GeoDataFrame(
        {"rsrp": -70.0 - np.arange(12), "pci": 101},
        geometry=geopandas.points_from_xy(16.37 + ways, 48.2 + ways),
        crs="EPSG:4326",
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"points{suffix}"
        frame.to_file(path)
        return path.read_bytes()


def _px4(ulog) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        rows = [(i * 1_000_000, -80.0 - i) for i in range(12)]
        places = [(i * 1_000_000, 48.2 + i * 1e-4, 16.37, 30.0) for i in range(12)]
        fields = "uint64_t timestamp;double lat;double lon;float alt"
        topics = {
            "vehicle_global_position": ("Qddf", fields, places),
            "cellular_status": ("Qf", "uint64_t timestamp;float rx_level", rows),
        }
        return ulog(Path(folder) / "a.ulg", topics).read_bytes()


def _ardupilot(dataflash) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        rows = [(i * 1_000_000, 48.2 + i * 1e-4, 16.37, -70.0 - i) for i in range(12)]
        return dataflash(Path(folder) / "a.bin", rows).read_bytes()


SOUND = {
    ".kml": _kml,
    ".kmz": _kmz,
    ".gpx": _gpx,
    ".p2m": _p2m,
    ".geojson": lambda: _vector(".geojson"),
    ".gpkg": lambda: _vector(".gpkg"),
    ".fgb": lambda: _vector(".fgb"),
    ".ulg": _px4,
    ".bin": _ardupilot,
    ".tlog": lambda: bytes(range(256)),
}
"""a small file of each format"""
LEVEL = {".bin": {"level": "MODM.RSRP"}, ".tlog": {"level": "RADIO_STATUS.rssi"}}


@pytest.mark.parametrize("suffix", sorted(SOUND))
def test_damaged_files_of_every_format(suffix, ulog, dataflash):
    for extra in ("pyogrio", "pyulog", "pymavlink"):
        pytest.importorskip(extra)
    writer = {".ulg": (ulog,), ".bin": (dataflash,)}.get(suffix, ())
    sound = SOUND[suffix](*writer)
    rng = np.random.default_rng(sorted(SOUND).index(suffix))
    options = {"columns": LEVEL[suffix]} if suffix in LEVEL else {}
    outcome(sound, options, suffix)
    n = int(os.environ.get("SKYGAIN_MUTATIONS", "40"))
    for _ in range(n):
        damaged = bytearray(sound)
        for _ in range(int(rng.integers(1, 8))):
            at, how = int(rng.integers(len(damaged))), rng.integers(4)
            if how == 0:
                damaged[at] = int(rng.integers(256))
            elif how == 1:
                del damaged[at : at + int(rng.integers(1, 30))]
            elif how == 2:
                damaged[at:at] = damaged[at : at + int(rng.integers(1, 30))]
            else:
                del damaged[max(at, 16) :]
            if not damaged:
                damaged = bytearray(b"x")
        outcome(bytes(damaged), {**options, "skip_bad": bool(rng.integers(2))}, suffix)
