"""A mission's commands can be killed at any moment and given again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from skygain.missions.folder import Mission, made
from tests.missions.test_ingest import write_log
from tests.missions.town import mission_request
from tests.robustness.processes import TRIALS

KILLS = 4 * TRIALS
"""of each command"""


def killed(folder: Path, longest_s: float, command: str, *logs: Path) -> None:
    """Kill ``command`` some times, then let it end."""
    words = [str(folder), str(longest_s), "7", str(KILLS), command, *map(str, logs)]
    subprocess.run(
        [sys.executable, str(Path(__file__).with_name("killed.py")), *words],
        check=True,
        timeout=600,
    )


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_no_reading_is_lost_or_doubled_by_kills(town, site, tmp_path: Path) -> None:
    folder = made(mission_request(town, tmp_path / "mission", planner="random-waypoint"))
    killed(folder, 2.5, "plan")
    with Mission.opened(folder) as mission:
        (sortie,) = mission.sorties()
        assert len(mission.journal.events("planned")) == 1
    names = {p.name for p in (folder / "sorties" / "001").iterdir()}
    assert {"brief.html", "uav0.plan", "uav2.kmz"} <= names
    assert [p.name for p in (folder / "sorties").iterdir()] == ["001"]
    logs = [write_log(site, f, tmp_path / f"uav{f.uav}.csv") for f in sortie.flights]
    killed(folder, 0.8, "ingest", *logs)
    expected = sum(len(log.read_text().splitlines()) - 1 for log in logs)
    with Mission.opened(folder) as mission:
        readings = mission.journal.readings()
        assert len(readings) == expected
        assert len({one.hash for one in readings}) == expected
        assert len(mission.journal.events("ingested")) == 3
        assert len(set(mission.journal.reading_events())) == 3
