"""The live page, as a browser and as many readers see it, and what it refuses."""

from __future__ import annotations

import contextlib
import shutil
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import pytest
import uvicorn

from skygain.missions.folder import Mission, made
from skygain.missions.serve import application, is_loopback
from skygain.missions.sortie import flight_along
from skygain.missions.vehicle_files import write_sortie
from tests.missions.test_ingest import write_log
from tests.missions.town import mission_request

TOKEN = "of-the-test"
PATIENT = {"timeout": 60, "verify": False}
"""on a busy machine; no certificates are read for every request"""
WRITER = {"Authorization": f"Bearer {TOKEN}"}


@contextlib.contextmanager
def served(folder: Path, host: str = "127.0.0.1") -> Iterator[str]:
    """The mission on a free port of loopback; ``host`` is what the application believes."""
    listener = socket.create_server(("127.0.0.1", 0))
    app = application(folder, host, TOKEN)
    config = uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=1)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(timeout=10)


@pytest.fixture(scope="module")
def folder(town, site, sortie, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = made(mission_request(town, tmp_path_factory.mktemp("served") / "mission"))
    with Mission.opened(folder) as mission:
        mission.journal.add("planned", {"sortie": sortie.as_data()})
    write_sortie(site, sortie, folder)
    return folder


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    with served(folder) as address:
        yield address


def test_only_a_writer_with_the_token_gets_readings_in(
    address, folder, site, sortie, tmp_path: Path
) -> None:
    log = write_log(site, sortie.flights[0], tmp_path / "uav0.csv", share=0.2)
    url = f"{address}/api/readings?name=uav0.csv"
    for wrong in ({}, {"Authorization": "Bearer guess"}):
        refused = httpx.put(url, content=log.read_bytes(), headers=wrong, **PATIENT)
        assert refused.status_code == 401
    with Mission.opened(folder) as mission:
        assert mission.journal.readings() == []
    taken = httpx.put(url, content=log.read_bytes(), headers=WRITER, **PATIENT)
    assert taken.status_code == 200
    assert "UAV 0" in taken.json()["told"]
    again = httpx.put(url, content=log.read_bytes(), headers=WRITER, **PATIENT)
    assert " 0 new" in again.json()["told"]
    bad = httpx.put(url, content=b"no,log\n1,2\n", headers=WRITER, **PATIENT)
    assert bad.status_code == 400
    assert "\n" not in bad.json()["error"]


def test_files_of_a_sortie_can_be_had_and_nothing_else(address, folder) -> None:
    plan = httpx.get(f"{address}/sorties/1/uav0.plan", **PATIENT)
    assert plan.content == (folder / "sorties" / "001" / "uav0.plan").read_bytes()
    for path in ("1/..%2f..%2fmission.toml", "1/.hidden", "2/uav0.plan", "1/..%2fjournal.sqlite"):
        assert httpx.get(f"{address}/sorties/{path}", **PATIENT).status_code == 404
    assert httpx.get(f"{address}/mission.toml", **PATIENT).status_code == 404


def test_other_hosts_are_refused_and_the_page_is_sealed(address) -> None:
    """A name that points here from elsewhere is how pages of others reach a local server."""
    assert httpx.get(address, headers={"Host": "evil.example"}, **PATIENT).status_code == 400
    page = httpx.get(address, **PATIENT)
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in page.text
    assert (
        httpx.get(f"{address}/api/story", **PATIENT).headers["x-content-type-options"] == "nosniff"
    )


def test_on_another_address_reading_needs_the_token_too(folder) -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("0.0.0.0")
    with served(folder, host="0.0.0.0") as address:
        for path in ("api/story", "api/place", "api/maps/0", "sorties/1/uav0.plan"):
            assert httpx.get(f"{address}/{path}", **PATIENT).status_code == 401
            assert httpx.get(f"{address}/{path}?token={TOKEN}", **PATIENT).status_code == 200
        assert httpx.get(address, **PATIENT).status_code == 200


def test_fifty_readers_at_once_see_the_same_map(address, site) -> None:
    def read(_: int) -> bytes:
        with httpx.Client(base_url=address, **PATIENT) as client:
            client.get("/api/story").raise_for_status()
            return client.get("/api/maps/0").content

    began = time.monotonic()
    with ThreadPoolExecutor(50) as pool:
        answers = list(pool.map(read, range(50)))
    assert time.monotonic() - began < 20
    assert len(set(answers)) == 1
    values = np.frombuffer(answers[0], "<f4").reshape(2, *site.grid.shape)
    assert np.isfinite(values[0]).sum() == site.scenario.outdoor.sum()


def test_changes_are_told_as_they_happen(address, folder) -> None:
    with httpx.stream("GET", f"{address}/api/changes", timeout=20) as stream:
        lines = (line for line in stream.iter_lines() if line.startswith("data:"))
        first = next(lines)
        with Mission.opened(folder) as mission:
            mission.journal.add("advised", {"error_db": 1.0, "next_db": 1.0, "stop": True})
        assert next(lines) != first


DROP = """([name, text]) => {
  const data = new DataTransfer();
  data.items.add(new File([text], name));
  document.dispatchEvent(new DragEvent("drop", { dataTransfer: data, cancelable: true }));
}"""


def replanned(folder: Path, site, sortie) -> None:
    """What a live flight tells of a new way."""
    cells = sortie.flights[0].cells[10:20]
    flight = flight_along(site, 0, cells, site.ways_home[0], site.grid.xy_m(cells[:1]))
    with Mission.opened(folder) as mission:
        body = {"sortie": 1, "flight": flight.as_data(), "began_s": 0.0}
        offer = mission.journal.add("offered", body)
        mission.journal.add("replanned", {"sortie": 1, "uav": 0, "offer": offer})


def test_a_browser_loads_scrubs_switches_drops_and_follows(
    address, folder, site, sortie, tmp_path: Path
) -> None:
    sync = pytest.importorskip("playwright.sync_api")
    browser_path = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser_path is None:
        pytest.skip("no Chromium to open the page with; install chromium to run this test")
    log = write_log(site, sortie.flights[1], tmp_path / "uav1.csv", share=0.5)
    with sync.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.set_default_timeout(60_000)
        wrong: list[str] = []
        page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(f"{address}/#token={TOKEN}")
        page.wait_for_selector("body[data-ready=yes]", timeout=60_000)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        count = int(page.get_attribute("body", "data-readings"))
        pixels = "document.getElementById('map').toDataURL()"
        before = page.evaluate(pixels)
        page.check("input[value=std]", force=True)
        page.wait_for_selector("#map[data-view=std]")
        assert page.evaluate(pixels) != before
        page.evaluate("document.getElementById('moment').value = 0")
        page.dispatch_event("#moment", "input")
        page.wait_for_selector("#map[data-count='0']")
        assert "before the first" in page.inner_text("#moment-text")
        page.evaluate("document.getElementById('moment').value = 5")
        page.dispatch_event("#moment", "input")
        page.wait_for_selector("#moment-text:has-text('sortie 1')")
        page.evaluate(DROP, ["uav1.csv", log.read_text()])
        page.wait_for_selector(f"body:not([data-readings='{count}'])", timeout=60_000)
        assert "UAV 1" in page.inner_text("#told")
        assert page.locator("#files a").count() == 23
        page.evaluate("{ const m = document.getElementById('moment'); m.value = m.max; }")
        page.dispatch_event("#moment", "input")
        page.wait_for_selector("#moment-text:has-text('uav1.csv')")
        before = page.evaluate(pixels)
        replanned(folder, site, sortie)  # a live flight sends a vehicle a new way
        page.wait_for_selector("#moment-text:has-text('UAV 0 has a new plan')", timeout=60_000)
        until = time.monotonic() + 60
        while page.evaluate(pixels) == before and time.monotonic() < until:
            page.wait_for_timeout(100)
        assert page.evaluate(pixels) != before
        page.evaluate(DROP, ["bad.csv", "no,log\n1,2\n"])
        page.wait_for_selector("#told.bad")
        assert not [text for text in wrong if "400" not in text]
        browser.close()
