"""Campaigns logged in many ways are read alike, and what could spoil a map is refused by name."""

from __future__ import annotations

import re

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.instruments import read_recording
from skygain.instruments.columns import level_quantity

ROWS = ((36.0010, -78.9400, -91), (36.0012, -78.9404, -97.5), (36.0014, -78.9408, -104))


@pytest.fixture
def csv_file(tmp_path):
    def write(text: str | bytes, name: str = "campaign.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def table(header="lat,lon,rsrp", rows=ROWS, sep=",", decimal=".") -> str:
    lines = [header.replace(",", sep)] + [
        sep.join(str(v).replace(".", decimal) for v in row) for row in rows
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "header",
    [
        "lat,lon,rsrp",
        "Latitude,LONGITUDE,RSRP (dBm)",
        "gps_lat,gps_lng,Signal Strength",
        " lat , lng ,level",
    ],
)
@pytest.mark.parametrize(
    ("sep", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]
)
def test_names_delimiters_and_decimal_commas(csv_file, header, sep, decimal):
    recording = read_recording(csv_file(table(header, sep=sep, decimal=decimal)))
    np.testing.assert_allclose(recording.latlon, [row[:2] for row in ROWS])
    np.testing.assert_allclose(recording.level_db, [row[2] for row in ROWS])
    assert recording.quantity == "power"
    assert recording.line.tolist() == [2, 3, 4]


@pytest.mark.parametrize(
    "wrap",
    [
        lambda t: "\ufeff" + t,
        lambda t: t.replace("\n", "\r\n"),
        lambda t: t.replace("\n", "\r"),
        lambda t: "\n\n" + t.replace("\n", "\n\n"),
        lambda t: t.replace("\n", ",\n"),
        lambda t: t.replace("-91\n", '"-91"\n'),
    ],
    ids=[
        "byte-order mark",
        "Windows line ends",
        "old Mac line ends",
        "empty lines",
        "trailing delimiters",
        "quotes",
    ],
)
def test_harmless_differences_are_harmless(csv_file, wrap):
    recording = read_recording(csv_file(wrap(table())))
    np.testing.assert_allclose(recording.level_db, [-91, -97.5, -104])


def test_line_numbers_count_the_lines_of_the_file(csv_file):
    recording = read_recording(csv_file("\n\nlat,lon,rsrp\n\n36,-78,-90\n\n36.1,-78,-91\n"))
    assert recording.line.tolist() == [5, 7]


def test_columns_may_be_named_and_are_reported(csv_file):
    path = csv_file("a,b,c,d\n36,-78,-90,-95\n")
    recording = read_recording(path, columns={"latitude": "a", "longitude": "B", "level": "d"})
    assert recording.level_db.tolist() == [-95.0]
    assert recording.columns == {"latitude": "a", "longitude": "b", "level": "d"}


def test_naming_one_role_settles_only_that_one(csv_file):
    path = csv_file("lat,lon,rsrp,rssi\n36,-78,-90,-65\n")
    with pytest.raises(InputError, match="'rsrp', 'rssi' could each be the level"):
        read_recording(path)
    assert read_recording(path, columns={"level": "rssi"}).level_db.tolist() == [-65.0]


def test_metres_are_read_as_metres(csv_file):
    recording = read_recording(csv_file("x_m,y_m,gain_db\n2,6,-80\n10,6,-90\n"))
    assert recording.latlon is None
    assert recording.crs is None
    assert recording.xy_m.tolist() == [[2.0, 6.0], [10.0, 6.0]]
    assert recording.quantity == "gain"


def test_degrees_go_before_metres_when_both_are_there(csv_file):
    path = csv_file("x,y,lat,lon,gain\n2,6,36,-78,-80\n")
    assert read_recording(path).latlon.tolist() == [[36.0, -78.0]]
    assert read_recording(path, columns={"x": "x"}).xy_m.tolist() == [[2.0, 6.0]]


def test_filter_reads_only_the_lines_asked_for(csv_file):
    path = csv_file("PCI,lat,lon,rsrp\nA,36,-78,-90\nB,36,-78,bad\nA,36,-78,-92\n")
    assert read_recording(path, where={"pci": "A"}).level_db.tolist() == [-90.0, -92.0]
    with pytest.raises(InputError, match=r"PCI=C.*'A', 'B'"):
        read_recording(path, where={"PCI": "C"})
    with pytest.raises(InputError, match=r"no column 'site'.*'PCI'"):
        read_recording(path, where={"site": "A"})


@pytest.mark.parametrize(
    ("name", "expected"),
    [("path_loss", "loss"), ("PathLoss_dB", "loss"), ("gain_db", "gain"), ("rx power", "power")],
)
def test_quantity_follows_from_the_name(name, expected):
    assert level_quantity(name) == expected


def test_loss_becomes_a_gain_and_power_with_eirp_too(csv_file):
    loss = read_recording(csv_file("x,y,path_loss\n0,0,91\n4,0,120.5\n"))
    assert loss.level_db.tolist() == [-91.0, -120.5]
    power = read_recording(csv_file("x,y,rsrp\n0,0,-91\n"), eirp_dbm=47.0)
    assert power.level_db.tolist() == [-138.0]
    assert {loss.quantity, power.quantity} == {"gain"}


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("x,y,path_loss\n0,0,-91\n", {}, "quantity=gain"),
        ("x,y,gain\n0,0,91\n", {}, "quantity=loss"),
        ("x,y,rsrp\n0,0,91\n", {}, "no receiver survives"),
        ("x,y,gain\n0,0,-91\n", {"eirp_dbm": 30.0}, "leave the EIRP out"),
        ("x,y,rsrp\n0,0,-91\n", {"eirp_dbm": float("nan")}, "eirp_dbm. must be"),
        ("x,y,rsrp\n0,0,-91\n", {"quantity": "dB"}, "'power', 'gain' or 'loss'"),
    ],
    ids=[
        "negative loss",
        "positive gain",
        "positive power",
        "gain with EIRP",
        "EIRP is NaN",
        "unknown quantity",
    ],
)
def test_levels_with_the_wrong_sign_or_reference(csv_file, text, options, message):
    with pytest.raises(InputError, match=message):
        read_recording(csv_file(text), **options)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("36,-78,oops", "line 3: the level \\(rsrp\\) is 'oops', expected a finite number"),
        ("36,-78,-inf", "line 3: the level .* '-inf'"),
        ("36,-78,42 %", "line 3: the level .* '42 %'"),
        ("36°75'N,-78,-90", "line 3: the latitude .*"),
        ("36,-78,-90,5", "line 3: has more fields than the 3 column names"),
        ("-98.94,36,-90", "line 3: .* swapped"),
        ("36,-378,-90", "line 3: the longitude is -378"),
        ("5339495,601946,-90", "line 3: .* if these are metres"),
    ],
)
def test_a_bad_line_is_named_or_skipped_and_counted(csv_file, bad, message):
    good = "36,-78,-90\n"
    path = csv_file("lat,lon,rsrp\n" + good + bad + "\n" + good)
    with pytest.raises(InputError, match=message + r".*skip_bad=True"):
        read_recording(path)
    recording = read_recording(path, skip_bad=True)
    assert (len(recording), recording.skipped) == (2, 1)
    assert "1 lines that cannot be understood" in recording.notes[-1]


@pytest.mark.parametrize(
    ("mark", "told"),
    [
        ("36,-78,", "the level .rsrp. has no value"),
        ("36,-78,NaN", "has no value .'NaN' 1 times"),
        ("36,-78,Unavailable", "'Unavailable' 1 times"),
        ("36,-78,-", "'-' 1 times"),
        ("36,-78", "the level .rsrp. has no value"),
        ("36,,-90", "the longitude .lon. has no value"),
        ("0,0,-90", "the position is 0, 0"),
        ("36,-78,2147483647", "a mark for no value"),
        ("36,-78,-164", "a mark for no value"),
        ("36,-78,-340", "a mark for no value"),
        ("36,-78,100", "a mark for no value"),
    ],
)
def test_a_mark_for_no_value_is_left_out_and_told(csv_file, mark, told):
    good = "36,-78,-90\n"
    recording = read_recording(csv_file("lat,lon,rsrp\n" + good + mark + "\n" + good))
    assert recording.line.tolist() == [2, 4]
    assert recording.skipped == 0
    _, note = recording.notes
    assert re.search(told, note)
    assert "line 3" in note


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"  \n \n", "is empty"),
        (b"lat,lon,rsrp\n", "header but no readings"),
        (b"lat,lon,rsrp\n\n \n", "header but no readings"),
        (b"36,-78,-90\n36,-78,-91\n", "holds numbers"),
        (b"lat lon quality\n36 -78 9\n", "no column for the level"),
        (b"latlonrsrp\n36\n", "has 1 column"),
        (b"lat,lon,quality\n36,-78,9\n", "no column for the level.*'quality'"),
        (b"north,rsrp,c\n36,-78,9\n", "no pair of columns for the position.*'north'"),
        (b"lat,lat,lon,rsrp\n1,2,3,-4\n", "2 columns are called 'lat'"),
        (b"lat,latitude,lon,rsrp\n1,2,3,-4\n", "could each be the latitude"),
        (b"lat,lon,rsrp\n" + b"36,-78,-90\n" * 9000 + b"36,-78,\xe4\n", "not UTF-8"),
        (b"PK\x03\x04\x00\x00rest of a spreadsheet", "not text"),
        (b'lat,lon,rsrp\n36,-78,"' + b"9" * 200_000, "quotation mark"),
        (b"lat,lon,rsrp\n36,-78,oops\n36,-78,x\n", "line 2"),
    ],
)
def test_files_that_are_no_campaign(csv_file, content, message):
    with pytest.raises(InputError, match=message):
        read_recording(csv_file(content))


def test_a_file_of_bad_lines_only_says_what_is_wrong_with_the_first(csv_file):
    with pytest.raises(InputError, match=r"all 2 lines .* line 2: the level"):
        read_recording(csv_file("lat,lon,rsrp\n36,-78,oops\n36,-78,x\n"), skip_bad=True)


def test_missing_and_huge_files(csv_file, tmp_path):
    with pytest.raises(InputError, match="no file"):
        read_recording(tmp_path / "absent.csv")
    with pytest.raises(InputError, match="no file"):
        read_recording(tmp_path)
    with pytest.raises(InputError, match="more than 0 MB"):
        read_recording(csv_file(table()), max_bytes=10)


def test_unusable_column_requests(csv_file):
    path = csv_file(table())
    with pytest.raises(InputError, match="unknown column role 'power'; known: latitude"):
        read_recording(path, columns={"power": "rsrp"})
    with pytest.raises(InputError, match="no column 'rssp' for the level; did you mean 'rsrp'"):
        read_recording(path, columns={"level": "rssp"})
    with pytest.raises(InputError, match="cannot be both"):
        read_recording(path, columns={"level": "lat"})
    with pytest.raises(InputError, match="name one pair"):
        read_recording(path, columns={"latitude": "lat", "x": "lon"})


def test_coordinate_reference_systems(csv_file):
    pytest.importorskip("pyproj")
    metric, geographic = csv_file("x,y,rsrp\n0,0,-91\n", "m.csv"), csv_file(table(), "g.csv")
    far = csv_file("x,y,rsrp\n601946,5339495,-91\n", "f.csv")
    assert read_recording(metric, recording_crs="EPSG:32617").crs == "EPSG:32617"
    degrees = csv_file("x,y,rsrp\n16,48,-91\n", "d.csv")
    assert read_recording(degrees, recording_crs="EPSG:4326").latlon.tolist() == [[48.0, 16.0]]
    assert read_recording(metric, recording_crs="local").crs is None
    assert read_recording(geographic, recording_crs="EPSG:4326").crs is None
    for path, crs, message in (
        (metric, "EPSG:999999", "unknown coordinate reference system"),
        (far, "EPSG:4326", "is in degrees"),
        (metric, "EPSG:2264", "not a projection in metres"),
        (geographic, "EPSG:32617", "taken as WGS 84"),
    ):
        with pytest.raises(InputError, match=message):
            read_recording(path, recording_crs=crs)


@pytest.mark.parametrize(
    ("column", "times", "expected"),
    [
        ("time_s", ("10", "12.5", "11"), [0.0, 2.5, 1.0]),
        ("time_ms", ("1000", "2500", "1000"), [0.0, 1.5, 0.0]),
        ("timestamp", ("1714564800000", "1714564801000", "1714564800500"), [0.0, 1.0, 0.5]),
        (
            "timestamp",
            ("2024-05-01T12:00:00Z", "2024-05-01T12:00:01.5Z", "2024-05-01T14:00:03+02:00"),
            [0.0, 1.5, 3.0],
        ),
        (
            "Timestamp",
            ("2026.05.01_10.00.00", "2026.05.01_10.00.02", "2026.05.01_10.01.00"),
            [0.0, 2.0, 60.0],
        ),
        (
            "Zeit",
            ("01.05.2024 10:00:00", "01.05.2024 10:00:01", "02.05.2024 10:00:00"),
            [0, 1, 86400],
        ),
        ("time", ("10:00:00.250", "10:00:01.000", "10:00:00.500"), [0.0, 0.75, 0.25]),
        ("time", ("noon", "later", "latest"), None),
        ("time", ("2024-05-01T12:00:00", "", "2024-05-01T12:00:01"), None),
        ("time", ("2024-05-01T12:00:00", "2024-05-01T12:00:01Z", "2024-05-01T12:00:01"), None),
        ("time", ("1", "2", "-"), None),
    ],
)
def test_times(csv_file, column, times, expected):
    path = csv_file(
        table(f"lat,lon,rsrp,{column}", [(*row, t) for row, t in zip(ROWS, times, strict=True)])
    )
    recording = read_recording(path)
    if expected is None:
        assert recording.time_s is None
        assert "time" not in recording.columns
        assert f"times are not used: column '{column}'" in " ".join(recording.notes)
        with pytest.raises(InputError, match="is not time"):
            read_recording(path, columns={"time": column})
    else:
        np.testing.assert_allclose(recording.time_s, expected)


def test_a_survey_of_our_own_is_read_with_its_noise_and_floor(csv_file):
    recording = read_recording(
        csv_file(
            "x_m,y_m,row,col,gain_db,noise_std_db,time_s,uav,censored\n2,2,0,0,-80.123456789012345,0.0,0.0,0,0\n6,2,0,1,-150,2.5,1.0,0,1\n"
        )
    )
    assert recording.level_db.tolist() == [-80.123456789012345, -150.0]
    assert recording.noise_std_db.tolist() == [0.0, 2.5]
    assert recording.censored.tolist() == [False, True]
    assert recording.time_s.tolist() == [0.0, 1.0]


def test_taken_selects_in_every_column(csv_file):
    recording = read_recording(
        csv_file(table("lat,lon,rsrp,time", [(*row, i) for i, row in enumerate(ROWS)]))
    )
    part = recording.taken(recording.level_db < -95)
    assert part.time_s.tolist() == [1.0, 2.0]
    assert part.line.tolist() == [3, 4]
    assert part.columns == recording.columns
    with pytest.raises(ValueError, match="read-only"):
        part.level_db[0] = 0
