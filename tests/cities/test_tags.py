"""Attributes of buildings, in the spellings people use."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygain.cities.tags import parse_length_m, parse_tags, plain_name, read_tags

anything = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.binary()
    | st.lists(st.integers())
)


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("12", 12.0),
        ("12 m", 12.0),
        ("12m", 12.0),
        ("12.5 metres", 12.5),
        ("7,5", 7.5),
        ("~15", 15.0),
        ("40 ft", 12.192),
        ("39'", 11.8872),
        ("6'6\"", 1.9812),
        (3, 3.0),
        (2.5, 2.5),
        ("0", 0.0),
        ("-3", None),
        ("12;15", 15.0),
        ("3-4", 4.0),
        ("3 m - 4 m", 4.0),
        ("12;tall", None),
        ("10\u2032", 3.048),
        ("1200 cm", 12.0),
        ("12 barns", None),
        ("high", None),
        ("", None),
        ("1e400", None),
        (float("nan"), None),
        (float("inf"), None),
        (10**400, None),
        (2000, None),
        (None, None),
    ],
)
def test_lengths(text: Any, metres: float | None) -> None:
    assert parse_length_m(text) == metres


@given(anything)
def test_lengths_never_fail(value: Any) -> None:
    length = parse_length_m(value)
    assert length is None or 0 <= length <= 1000


@given(st.dictionaries(st.text(min_size=1), st.text()))
def test_hstore_round_trip(tags: dict[str, str]) -> None:
    def quoted(text: str) -> str:
        return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'

    assert parse_tags(",".join(f"{quoted(k)}=>{quoted(v)}" for k, v in tags.items())) == tags


def test_tags_as_json() -> None:
    assert parse_tags('{"height": 12, "building:part": "yes"}') == {
        "height": "12",
        "building:part": "yes",
    }


@given(st.text() | st.none() | st.floats())
def test_other_tags_never_fail(text: Any) -> None:
    parse_tags(text)
    parse_tags("{" + str(text))


def tags(**attributes: Any) -> dict[str, Any]:
    return {plain_name(name): value for name, value in attributes.items()}


def test_height_counts_before_levels() -> None:
    both = read_tags(tags(building="yes", height="20", building_levels="3"))
    assert (both.height_m, both.from_levels) == (20.0, False)
    levels = read_tags(tags(building="yes", building_levels="3"))
    assert (levels.height_m, levels.from_levels) == (9.0, True)
    assert read_tags(tags(building="yes")).height_m is None
    assert (
        read_tags(tags(building="yes", height=0.0, num_floors=2)).height_m == 6.0
    )  # 0 is how producers write unknown


def test_base_from_height_or_level() -> None:
    assert read_tags(tags(min_height="3 m", building_min_level="7")).base_m == 3.0
    assert read_tags(tags(building_min_level="2")).base_m == 6.0
    assert read_tags(tags(height="9")).base_m == 0.0


def test_what_counts_as_a_building() -> None:
    assert read_tags(tags(building="house")).is_building
    assert read_tags({plain_name("building:part"): "yes"}).is_part
    assert not read_tags(tags(building="no")).is_building
    assert not read_tags(tags(landuse="grass")).is_building
    assert read_tags(tags(building="yes", location="underground")).is_underground


def test_a_height_that_cannot_be_understood_is_said() -> None:
    tag = read_tags(tags(building="yes", height="very", building_levels="4"))
    assert (tag.height_m, tag.misread) == (12.0, True)
    assert not read_tags(tags(building="yes", height=float("nan"), levels="")).misread


@given(
    st.dictionaries(
        st.sampled_from(["height", "buildinglevels", "minheight", "buildingpart", "building"]),
        anything,
    )
)
def test_tags_never_fail(attributes: dict[str, Any]) -> None:
    tag = read_tags(attributes)
    assert tag.base_m >= 0
    assert tag.height_m is None or tag.height_m > 0
