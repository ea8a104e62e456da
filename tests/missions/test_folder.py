"""A mission's folder survives its writers and says who holds it."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from skygain.app.progress import SILENT
from skygain.ground.errors import InputError
from skygain.missions.commands import run_new, run_plan
from skygain.missions.folder import Mission, held, made, swapped_in
from skygain.missions.journal import Journal, Reading
from skygain.missions.requests import MissionPlanRequest
from tests.missions.town import mission_request

READING = Reading(49.99, 9.01, -80.0, None, False, 1.7e9, 1, 0, "a.csv")


@pytest.fixture
def journal(tmp_path: Path):
    with Journal(tmp_path / "journal.sqlite", create=True) as opened:
        yield opened


def test_the_same_readings_count_once(journal: Journal) -> None:
    others = [replace(READING, time_s=1.7e9 + k) for k in range(5)]
    assert journal.take_in("ingested", {}, [READING, *others]) == 5  # the first two are the same
    assert journal.take_in("ingested", {}, [*others, replace(READING, level_db=-81.0)]) == 1
    assert journal.take_in("ingested", {}, others) == 0
    assert len(journal.readings()) == 6
    assert len(journal.events("ingested")) == 2
    assert journal.readings()[0] == READING


def test_a_failure_in_the_middle_keeps_nothing(journal: Journal) -> None:
    broken = replace(READING, level_db=None)  # type: ignore[arg-type]
    with pytest.raises((sqlite3.IntegrityError, TypeError)):
        journal.take_in("ingested", {}, [READING, broken])
    assert journal.readings() == []
    assert journal.events() == []
    assert journal.take_in("ingested", {}, [READING]) == 1


@pytest.mark.parametrize("table", ["events", "readings"])
@pytest.mark.parametrize("change", ["DELETE FROM {}", "UPDATE {} SET id = 99"])
def test_the_journal_only_grows(journal: Journal, table: str, change: str) -> None:
    journal.take_in("ingested", {}, [READING])
    with (
        sqlite3.connect(journal.path) as other,
        pytest.raises(sqlite3.IntegrityError, match="never"),
    ):
        other.execute(change.format(table))


def test_a_second_process_is_told_who_holds_the_folder(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib\n"
        "from skygain.missions.folder import held\n"
        "with held(pathlib.Path(sys.argv[1]), 'skygain mission plan'):\n"
        "    print('held', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        said = f"held by skygain mission plan .process {other.pid}, since "
        with pytest.raises(InputError, match=said), held(tmp_path, "skygain mission ingest"):
            pass
        other.kill()
    with held(tmp_path, "skygain mission ingest"):
        pass


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "001"
    with swapped_in(target) as draft:
        (draft / "a").write_text("1")

    def broken() -> None:
        with swapped_in(target) as draft:
            (draft / "a").write_text("2")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken()
    assert (target / "a").read_text() == "1"
    with swapped_in(target) as draft:
        (draft / "b").write_text("3")
    assert [p.name for p in tmp_path.rglob("*")] == ["001", "b"]


def test_the_request_is_the_same_after_the_way_through_the_file(town, tmp_path: Path) -> None:
    asked = mission_request(
        town, tmp_path / "m ü", transmitter="1,2", stop_std_db=3.5, box=(9.0, 49.9, 9.1, 50.0)
    )
    made(asked)
    with Mission.opened(tmp_path / "m ü") as mission:
        assert mission.request == asked
        assert [e["kind"] for e in mission.journal.events()] == ["begun"]


def test_new_plan_and_plan_again(town, tmp_path: Path) -> None:
    folder = tmp_path / "mission"
    asked = mission_request(town, folder, planner="random-waypoint", predictor="idw", outlook=1)
    told = run_new(asked, SILENT)
    assert "of its cells can be flown" in told
    assert (folder / "site.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(InputError, match="holds a mission already"):
        run_new(asked, SILENT)
    first = run_plan(MissionPlanRequest(folder=folder), SILENT)
    names = sorted(p.name for p in (folder / "sorties" / "001").iterdir())
    kinds = ("csv", "geojson", "gpx", "kml", "kmz", "plan", "waypoints")
    assert names == [
        "brief.html",
        "brief.png",
        *(f"uav{k}.{kind}" for k in range(3) for kind in kinds),
    ]
    plan = (folder / "sorties" / "001" / "uav0.plan").read_bytes()
    again = run_plan(MissionPlanRequest(folder=folder), SILENT)
    assert "the same sortie again" in again
    assert first.splitlines()[:4] == again.splitlines()[:4]
    assert (folder / "sorties" / "001" / "uav0.plan").read_bytes() == plan
    fewer = run_plan(MissionPlanRequest(folder=folder, without=(1,)), SILENT)
    assert "UAV 1" not in fewer
    with Mission.opened(folder) as mission:
        assert [s.number for s in mission.sorties()] == [1]
    ahead = run_plan(MissionPlanRequest(folder=folder, ahead=True), SILENT)
    assert ahead.startswith("sortie 2")
    with pytest.raises(InputError, match="UAV 7"):
        run_plan(MissionPlanRequest(folder=folder, without=(7,)), SILENT)


def test_a_changed_map_is_told(town, tmp_path: Path) -> None:
    city = tmp_path / "town.geojson"
    city.write_bytes((town / "town.geojson").read_bytes())
    folder = tmp_path / "mission"
    made(mission_request(town, folder, city=str(city)))
    city.write_text(city.read_text() + " ")
    with Mission.opened(folder) as mission, pytest.raises(InputError, match="changed since"):
        _ = mission.site
    with pytest.raises(InputError, match="holds no mission"), Mission.opened(tmp_path):
        pass
