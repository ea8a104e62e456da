"""Missions live: readings that come in over HTTP, and the page that shows them."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.ground.errors import require
from skygain.missions.folder import Mission

CITY, HOME = "examples/data/buildings.geojson", "49.9977,9.0101"


@contextlib.contextmanager
def served(folder: Path) -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    """A mission over the example's buildings with one sortie planned, its server, port and
    token."""
    for words in (
        ["new", folder, "--city", CITY, "--home", HOME, "--altitude", "30", "--battery", "8",
         "--outlook", "0"],
        ["plan", folder],
    ):  # fmt: skip
        told = [sys.executable, "-m", "skygain", "mission", *map(str, words)]
        subprocess.run(told, check=True, capture_output=True)
    server = subprocess.Popen(
        [sys.executable, "-m", "skygain", "mission", "serve", str(folder), "--port", "0"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert server.stderr is not None
    found = None
    for line in server.stderr:
        found = re.search(r"http://127\.0\.0\.1:(\d+)/#token=(\S+)", line)
        if found:
            break
    assert found, "the server said no address"
    drain = threading.Thread(target=server.stderr.read, daemon=True)
    drain.start()
    try:
        yield server, int(found[1]), found[2]
    finally:
        server.terminate()
        server.wait(timeout=20)


def resident_mb(process: subprocess.Popen[str]) -> float:
    """Memory that a process has now; Linux only."""
    text = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    return int(re.findall(r"VmRSS:\s+(\d+)", text)[0]) / 1024


class Sender:
    """One vehicle's companion computer: posts a lot of readings every so often."""

    def __init__(self, uav: int, port: int, token: str, places: np.ndarray, rate: float) -> None:
        self.uav, self.port, self.token = uav, port, token
        self.places, self.rate = places, rate
        self.delays_ms: list[float] = []
        self.sent = self.new = self.again = 0

    def run(self, seconds: float, lot: int) -> None:
        """Send for so long, ``lot`` readings a post; a post that is not taken is sent again."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        head = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        began, wall = time.monotonic(), time.time()
        for k in range(round(seconds * self.rate / lot)):
            due = began + (k + 1) * lot / self.rate
            time.sleep(max(0.0, due - time.monotonic()))
            number = k * lot + np.arange(lot)
            rows = [
                {
                    "time": round(wall + n / self.rate, 4),
                    "latitude": self.places[n % len(self.places), 0],
                    "longitude": self.places[n % len(self.places), 1],
                    "level": -80.0 - n % 17,
                }
                for n in number.tolist()
            ]
            body = json.dumps({"uav": self.uav, "readings": rows})
            while True:
                at = time.monotonic()
                link.request("POST", "/api/readings", body, head)
                answer = link.getresponse()
                told = json.loads(answer.read())
                if answer.status == 200:
                    break
                if answer.status != 503:
                    raise RuntimeError(told["error"])
                self.again += 1
                time.sleep(0.1)
            self.delays_ms.append(1e3 * (time.monotonic() - at))
            self.sent += lot
            self.new += told["new"]
        link.close()


def senders(folder: Path, port: int, token: str, vehicles: int, rate: float) -> list[Sender]:
    """One for each vehicle, along its planned cells."""
    with Mission.opened(folder) as mission:
        (sortie,) = mission.sorties()
        places = [mission.site.grid.latlon(flight.cells) for flight in sortie.flights]
    return [Sender(k, port, token, places[k % len(places)], rate) for k in range(vehicles)]


@study(
    "mission_readings_in",
    vehicles=Option(3, "vehicles"),
    rate=Option(200.0, "readings a second of each; 10 Hz at 20 times the pace"),
    seconds=Option(30.0, "seconds; 10 minutes at 20 times the pace"),
    lot=Option(50, "readings of one post"),
)
def mission_readings_in(run: Run) -> list[Table]:
    """Readings that companion computers post to a mission's server, all at once: what is kept, how
    long an answer takes, and the server's memory before and after."""
    o = run.options
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "mission"
        with served(folder) as (server, port, token):
            fleet = senders(folder, port, token, o.vehicles, o.rate)
            before = resident_mb(server)
            began = time.monotonic()
            threads = [threading.Thread(target=s.run, args=(o.seconds, o.lot)) for s in fleet]
            for thread in threads:
                thread.start()
            peak = before
            while any(thread.is_alive() for thread in threads):
                peak = max(peak, resident_mb(server))
                time.sleep(0.2)
            took = time.monotonic() - began
        with Mission.opened(folder) as mission:
            kept = mission.journal.count
    sent = sum(s.sent for s in fleet)
    delays = np.concatenate([s.delays_ms for s in fleet])
    row = [
        f"{sent}",
        f"{sent / took:.0f}",
        f"{sent - kept}",
        f"{sum(s.again for s in fleet)}",
        f"{np.median(delays):.0f}",
        f"{np.percentile(delays, 99):.0f}",
        f"{before:.0f}",
        f"{peak:.0f}",
    ]
    title = f"{o.vehicles} vehicles, {o.rate:g} readings a second each, {o.lot} a post."
    head = ["sent", "a second", "lost", "posted again", "answer, ms", "99 %, ms", "MB before",
            "MB at most"]  # fmt: skip
    return [Table(title, head, [row])]


_WATCH = """() => {
  window.lags = []; window.maps = 0;
  let count = -1, map = "";
  const look = () => {
    const drawn = Number(document.body.dataset.drawn || 0);
    const shown = document.getElementById("map").dataset.count;
    if (drawn !== count) { count = drawn; window.lags.push([Date.now(), drawn]); }
    if (shown !== map) { map = shown; window.maps += 1; }
    requestAnimationFrame(look);
  };
  look();
}"""


@study(
    "mission_page",
    rate=Option(60.0, "readings a second, of three vehicles together"),
    seconds=Option(60.0, "seconds"),
)
def mission_page(run: Run) -> list[Table]:
    """The live page in headless Chromium: time to the first map, and how far what is drawn is
    behind the readings that come."""
    o = run.options
    sync = require("playwright.sync_api", "dev")
    browser_path = shutil.which("chromium") or shutil.which("chromium-browser")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "mission"
        with served(folder) as (_, port, token), sync.sync_playwright() as play:
            browser = play.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
            firsts = [first_map_s(browser, port, token) for _ in range(5)]
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.goto(f"http://127.0.0.1:{port}/#token={token}")
            page.wait_for_selector("body[data-ready=yes]")
            page.evaluate(_WATCH)
            fleet = senders(folder, port, token, 3, o.rate / 3)
            wall = time.time()
            threads = [threading.Thread(target=s.run, args=(o.seconds, 2)) for s in fleet]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            sent = sum(s.sent for s in fleet)
            page.wait_for_selector(f"body[data-drawn='{sent}']")
            seen: list[Any] = page.evaluate("window.lags")
            maps = page.evaluate("window.maps")
            browser.close()
    # when the reading with each number was taken, against when it was drawn
    lags = [at / 1e3 - (wall + count / o.rate) for at, count in seen if count]
    row = [
        f"{np.median(firsts):.2f}",
        f"{sent}",
        f"{np.median(lags):.1f}",
        f"{max(lags):.1f}",
        f"{maps / o.seconds:.1f}",
    ]
    head = ["first map, s", "readings", "behind, s", "at most, s", "new maps a second"]
    return [Table(f"{o.rate:g} readings a second, {o.seconds:g} s.", head, [row])]


def first_map_s(browser: Any, port: int, token: str) -> float:
    """Seconds from the address to the first map, in a browser that knows nothing yet."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    began = time.monotonic()
    page.goto(f"http://127.0.0.1:{port}/#token={token}", wait_until="commit")
    page.wait_for_selector("body[data-ready=yes]")
    took = time.monotonic() - began
    context.close()
    return took
