"""Mutated files of every format: a city that says what it is, or one line; never a traceback, never
a city of nothing without a word.

A short run by default; ``SKYGAIN_MUTANTS=100000`` for a long one.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from skygain.cities import read_city
from skygain.ground.errors import InputError

pytest.importorskip("pyogrio")
pytest.importorskip("rasterio")

DATA = Path(__file__).parent / "data"

SOURCES = (
    "city.geojson",
    "city.fgb",
    "city.kml",
    "city.gml",
    "city.parquet",
    "city_utm.shp",
    "ms.geojsonl",
    "overpass.json",
    "tile.city.json",
    "relation.osm",
    "osm_heights.geojson",
    "polygonz.geojson",
    "dsm_dtm_two_band.tif",
    "dsm_polder.tif",
    "dsm_ftus_compound.tif",
    "ndsm_nd0.tif",
)

ODD = (
    b"",
    b"NaN",
    b"null",
    b"-1",
    b"1e400",
    b"1e30",
    b"0",
    b'"',
    b"{}",
    b"[]",
    b"<",
    b"180.5",
    b"\x00",
)
"""what a number of a text file is replaced by"""

PER_SOURCE = int(os.environ.get("SKYGAIN_MUTANTS", 12 * len(SOURCES))) // len(SOURCES)


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """The content with bytes changed, cut off, cut out, doubled, or its numbers replaced."""
    changed = bytearray(content)
    kind = rng.integers(5)
    if kind == 0:
        for i in rng.integers(len(changed), size=rng.integers(1, 9)):
            changed[i] = rng.integers(256)
    elif kind == 1:
        del changed[rng.integers(len(changed)) :]
    elif kind in (2, 3):
        start = int(rng.integers(len(changed)))
        piece = changed[start : start + int(rng.integers(1, 200))]
        changed[start : start + (len(piece) if kind == 2 else 0)] = b"" if kind == 2 else piece
    else:
        numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?", content))
        for match in reversed([m for m in numbers if rng.random() < 3 / len(numbers)]):
            changed[match.start() : match.end()] = ODD[rng.integers(len(ODD))]
    return bytes(changed)


@pytest.fixture(scope="module")
def parquet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """city.geojson as GeoParquet."""
    pytest.importorskip("pyarrow")
    geopandas = pytest.importorskip("geopandas")
    path = tmp_path_factory.mktemp("parquet") / "city.parquet"
    geopandas.read_file(DATA / "city.geojson").to_parquet(path)
    return path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", SOURCES)
def test_mutants(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    source = request.getfixturevalue("parquet") if name.endswith("parquet") else DATA / name
    content = source.read_bytes()
    path = tmp_path / f"x{''.join(source.suffixes)}"
    options = {}
    if name.endswith(".shp"):
        options["crs"] = "EPSG:32633"
        for beside in (".shx", ".dbf"):
            (tmp_path / f"x{beside}").write_bytes(source.with_suffix(beside).read_bytes())
    rng = np.random.default_rng(sum(name.encode()))
    read = 0
    for number in range(PER_SOURCE):
        path.write_bytes(mutated(content, rng))
        try:
            reading = read_city(path, spacing_m=8.0, **options)
        except InputError as error:
            text = str(error)
            assert "\n" not in text
            assert 10 < len(text) < 700, text
            continue
        except Exception as error:  # the number finds the mutant again
            raise AssertionError(f"{name}, mutant {number}: {error!r}") from error
        read += 1
        city = reading.city
        assert np.isfinite(city.height_m).all(), number
        assert np.isfinite(city.ground_m).all(), number
        assert city.height_m.min() >= 0, number
        assert city.height_m.any() or reading.remarks, (number, reading.notes)
    assert read < PER_SOURCE or PER_SOURCE < 50
