"""Hostile names in a stranger's log stay text in every file that comes out of it.

Surveys are tested so in tests/reports/test_html.py and test_export.py.
"""

from __future__ import annotations

import csv
import json
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from .processes import ended, skygain

NAMES = (
    "=HYPERLINK(1)",
    "@SUM(1)",
    "</script><img src=x onerror=alert(1)>\"'&{{data}} ${x} \u2028\x0b東京",
)


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The maps of a campaign whose signals bear those names."""
    log, rng = tmp_path_factory.mktemp("hostile") / "log.csv", np.random.default_rng(0)
    with log.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["latitude", "longitude", "rsrp_dbm", "cell"])
        for k in range(90):
            north, east = rng.uniform(0, 2e-3, 2)
            level = round(-80 + rng.normal(0, 6), 1)
            out.writerow([f"{48 + north:.6f}", f"{11 + east:.6f}", level, NAMES[k % 3]])
    maps = log.parent / "maps"
    code, _, err = ended(
        skygain("map", log, "--by", "cell", "--next", "2", "--threshold", "-85", "--out", maps)
    )
    assert code == 0, err
    return maps


def test_the_page_shows_them_as_text(folder: Path) -> None:
    page = Tags((folder / "report.html").read_text(encoding="utf-8"))
    pictures = [attrs for tag, attrs in page.found if tag == "img"]
    assert all(str(attrs["src"]).startswith("data:image/png") for attrs in pictures)
    assert not any(name.startswith("on") for _, attrs in page.found for name in attrs)
    assert "script" not in [tag for tag, _ in page.found]


def test_no_cell_of_a_table_is_a_formula(folder: Path) -> None:
    with (folder / "measurements.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len({row["series"] for row in rows}) == 3
    assert not any(row["series"].startswith(("=", "+", "-", "@")) for row in rows)


def test_every_other_file_can_be_read(folder: Path) -> None:
    read = 0
    for path in folder.iterdir():
        if path.suffix in (".json", ".geojson"):
            json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix in (".kml", ".gpx"):
            ElementTree.fromstring(path.read_text(encoding="utf-8"))
        else:
            continue
        read += 1
    assert read >= 4
