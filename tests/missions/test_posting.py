"""Readings that are posted: kept before they are acknowledged, once, or refused in one line."""

from __future__ import annotations

import contextlib
import csv
import io
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import httpx
import numpy as np
import pytest

pytest.importorskip("starlette")

from skygain.missions.folder import Mission, made
from skygain.missions.journal import POSTED, Reading
from skygain.missions.next_sortie import open_sortie
from skygain.missions.posting import BusyError, Posts
from tests.missions.test_serve import PATIENT, TOKEN, WRITER, served
from tests.missions.town import SOUTH_M, TO_DEGREES, WEST_M, mission_request

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "fly-a-mission.md"


@pytest.fixture
def folder(town, sortie, tmp_path: Path) -> Path:
    folder = made(mission_request(town, tmp_path / "mission"))
    with Mission.opened(folder) as mission:
        mission.journal.add("planned", {"sortie": sortie.as_data()})
    return folder


@pytest.fixture
def address(folder: Path) -> Iterator[str]:
    with served(folder) as address:
        yield address


def reading(k: int, **changes: object) -> dict:
    lon, lat = TO_DEGREES.transform(WEST_M + 20 + k % 100, SOUTH_M + 30 + k // 100 % 100)
    moment = round(time.time() - 5.0 + 0.001 * k, 3)
    return {"time": moment, "latitude": lat, "longitude": lon, "level": -80.0 - k % 7, **changes}


def post(address: str, body: object, **head: str) -> httpx.Response:
    """A post with the token; bytes are sent as they are, all else as JSON."""
    sent = {"content": body} if isinstance(body, bytes) else {"json": body}
    return httpx.post(f"{address}/api/readings", headers={**WRITER, **head}, **sent, **PATIENT)


def kept(folder: Path) -> list:
    with Mission.opened(folder) as mission:
        return mission.journal.readings()


def test_a_post_counts_once_in_json_and_in_csv(address, folder) -> None:
    rows = [reading(k) for k in range(5)]
    told = post(address, {"uav": 1, "readings": rows}).json()
    assert told == {"readings": 5, "new": 5}
    assert post(address, [{**r, "uav": 2} for r in rows]).json()["new"] == 0
    text = io.StringIO()
    lines = csv.DictWriter(text, ["time", "latitude", "longitude", "level", "uav"])
    lines.writeheader()
    for row in (*rows, reading(7)):
        when = datetime.fromtimestamp(row["time"], UTC).isoformat()
        lines.writerow({**row, "time": when, "uav": ""})
    answer = post(address, text.getvalue().encode(), **{"Content-Type": "text/csv"})
    assert answer.json() == {"readings": 6, "new": 1}
    assert post(address, reading(8)).json() == {"readings": 1, "new": 1}
    readings = kept(folder)
    assert [r.uav for r in readings] == [1] * 5 + [-1, -1]
    assert {r.sortie for r in readings} == {1}
    with Mission.opened(folder) as mission:  # they came within seconds: one moment of the story
        assert len(mission.journal.events("ingested")) == 1


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"{", "is no JSON"),
        (b"[" * 100_000, "is no JSON"),
        (b"[3]", "reading 1 must be an object with time, latitude, longitude and level, got 3"),
        ([{"lat": 3}], "reading 1 has an unknown 'lat'; .*latitude"),
        ([reading(0), {"time": 3}], "reading 2 has no latitude"),
        ([reading(0, level=None)], "level of reading 1 must be a number from -250 to 60, got None"),
        ([reading(0, level="nan")], "level of reading 1 must be a number"),
        ([reading(0, level=True)], "level of reading 1 must be a number"),
        ([reading(0, latitude=91)], "latitude of reading 1 must be a number from -90 to 90"),
        ([reading(0, uav=3)], "uav of reading 1 must be a number from -1 to 2, got 3"),
        ([reading(0, uav=0.5)], "uav of reading 1 must be a whole number"),
        ([reading(0, time="09:00")], "time of reading 1 must be seconds since 1970, or ISO 8601"),
        ([reading(0, time="2026-05-06T09:00:03")], "ISO 8601 with a zone"),
        ([reading(0, time=time.time() - 7 * 3600)], r"dated \d\.\d h before the first plan.*clock"),
        ([reading(0, time=time.time() + 5 * 3600)], r"dated \d\.\d h after now .*clock is off"),
        ([reading(0, latitude=48.0)], "all 1 readings of the post lie off the map"),
        ([reading(k) for k in range(10_001)], "10001 readings in one post"),
        (b" " * 2_000_001, "more than 2 MB"),
        (b"\xff\xfe", "not UTF-8"),
    ],
    ids=lambda value: value[:12] if isinstance(value, str) else "",
)  # fmt: skip
def test_what_is_wrong_is_told_in_one_line_and_nothing_is_kept(
    address, folder, body: object, message: str
) -> None:
    answer = post(address, body)
    assert answer.status_code == 400
    told = answer.json()["error"]
    assert "\n" not in told
    assert re.search(message, told), told
    assert kept(folder) == []


def test_a_post_needs_the_token_and_a_plan(address, folder, town, tmp_path: Path) -> None:
    assert post(address, [reading(0)], Authorization="Bearer guess").status_code == 401
    assert kept(folder) == []
    with served(made(mission_request(town, tmp_path / "unplanned"))) as other:
        assert "nothing is planned" in post(other, [reading(0)]).json()["error"]


def test_posts_are_taken_while_another_command_holds_the_folder(address, folder) -> None:
    """A live flight does, and it reads the journal."""
    with Mission.opened(folder) as mission, mission.writing("skygain mission fly"):
        assert post(address, [reading(0)]).json()["new"] == 1


def test_many_senders_and_readers_at_once_lose_nothing(address, folder) -> None:
    def send(uav: int) -> int:
        new = 0
        with httpx.Client(base_url=address, headers=WRITER, **PATIENT) as client:
            for k in range(20):
                rows = [reading(1000 * uav + 10 * k + i) for i in range(10)]
                answer = client.post("/api/readings", json={"uav": uav, "readings": rows})
                new += answer.raise_for_status().json()["new"]
        return new

    def read(_: int) -> int:
        return httpx.get(f"{address}/api/story", **PATIENT).status_code

    with ThreadPoolExecutor(53) as pool:
        readers = [pool.submit(read, k) for k in range(50)]
        sent = list(pool.map(send, range(3)))
        assert {one.result() for one in readers} == {200}
    assert sent == [200, 200, 200]
    assert len(kept(folder)) == 600


def test_what_waits_is_bounded(folder) -> None:
    some = [Reading(49.9977, 9.0101, -80.0, None, False, 1e9 + k, 1, 0, "posted") for k in range(4)]
    posts = Posts(folder / "journal.sqlite", most=3)
    waiting = posts.add(some[:3])
    with pytest.raises(BusyError):
        posts.add(some[3:])
    with posts:
        assert waiting.result(timeout=10) == 3
        while True:  # what was written makes room
            with contextlib.suppress(BusyError):
                assert posts.add(some[3:]).result(timeout=10) == 1
                break
    with pytest.raises(BusyError):
        posts.add(some[3:])
    assert len(kept(folder)) == 4


def test_posts_before_the_take_off_leave_the_sortie_open(folder, sortie) -> None:
    with Mission.opened(folder) as mission:
        places = mission.site.latlon(mission.site.grid.xy_m(sortie.cells))
    some = [
        Reading(lat, lon, -80.0, None, False, 1e9 + k, 1, 0, POSTED)
        for k, (lat, lon) in enumerate(places.tolist())
    ]
    early = len(some) // 20
    for first, last, stays_open in ((0, early, True), (early, len(some), False)):
        with Posts(folder / "journal.sqlite") as posts:
            assert posts.add(some[first:last]).result(timeout=10) == last - first
        with Mission.opened(folder) as mission:
            assert (open_sortie(mission) is not None) == stays_open


def test_the_client_of_the_docs_loses_nothing(address, folder) -> None:
    (client,) = re.findall(r"```python\n(import json.*?)```", HOW_TO.read_text(), re.S)
    space: dict = {}
    exec(client, space)
    rows = [reading(k) for k in range(700)]
    space["waiting"].extend(rows)
    assert not space["post"]("http://127.0.0.1:9", TOKEN, 0)
    assert len(space["waiting"]) == 700
    while space["waiting"]:
        assert space["post"](address, TOKEN, 0)
    readings = kept(folder)
    assert len(readings) == 700
    assert np.ptp([r.time_s for r in readings]) > 0.5
    assert {r.uav for r in readings} == {0}
