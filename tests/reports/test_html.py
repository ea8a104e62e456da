"""The report holds the survey, needs nothing else, and can be stepped through in a real browser."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import re
import shutil
import subprocess
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.reports import page_data
from skygain.reports.html import write_report
from skygain.reports.outcome import Outcome

Make = Callable[..., Outcome]

HOSTILE = "</script><img src=x onerror=alert(1)>\"'&\x00\ud800 \u2028{{data}} 東京"
VOID = {"meta", "link", "input", "br", "img", "hr"}


class Page(HTMLParser):
    """Checks that elements nest, and keeps what the tests ask about."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: dict[str, str] = {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words[self.open[-1] if self.open else ""] = (
            self.words.get(self.open[-1] if self.open else "", "") + data
        )

    def ids(self) -> list[str]:
        return [str(attrs["id"]) for _, attrs in self.tags if "id" in attrs]


def written(outcome: Outcome, folder: Path) -> str:
    write_report(outcome, folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def payload(text: str) -> dict[str, Any]:
    """The survey as the page's script gets it, unpacked after the description in
    `skygain.reports.html`."""
    found = re.search(
        r'<script type="application/json" id="survey">(.*?)</script>', text, re.DOTALL
    )
    assert found
    survey = json.loads(found[1], parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    raw, offset = zlib.decompress(base64.b64decode(survey["blob"])), 0
    for name, kind, length in survey["sections"]:
        dtype = np.dtype(f"<{kind}")
        survey[name] = np.frombuffer(raw, dtype, length, offset)
        offset += length * dtype.itemsize
    assert offset == len(raw)
    for name in ("mean", "std"):
        survey[name] = np.cumsum(
            survey[name].reshape(-1, survey["rows"], survey["cols"]), axis=0, dtype=np.uint8
        )
    return survey


@pytest.mark.parametrize("truth", ["full", "partial", None])
def test_the_page_is_well_formed_and_loads_nothing(
    make_outcome: Make, tmp_path: Path, truth: str | None
) -> None:
    text = written(make_outcome(truth=truth, crs="EPSG:32617"), tmp_path)
    page = Page(text)
    assert len(page.ids()) == len(set(page.ids()))
    assert not re.search(r"https?:|//[a-z]+\.[a-z]|@import|url\(", text)
    for _, attrs in page.tags:
        assert attrs.get("src") is None
        assert attrs.get("href") in (None, "data:,")
    assert ("default-src 'none'") in text
    shown = [
        attrs["value"] for tag, attrs in page.tags if tag == "input" and attrs.get("name") == "view"
    ]
    assert shown == (["mean", "std"] if truth is None else ["mean", "std", "error", "truth"])


def test_every_control_has_a_name(make_outcome: Make, tmp_path: Path) -> None:
    page = Page(written(make_outcome(), tmp_path))
    for tag, attrs in page.tags:
        if (
            tag == "button"
            or attrs.get("type") == "range"
            or attrs.get("role") in ("img", "region")
        ):
            assert attrs.get("aria-label"), (tag, attrs)


def test_maps_survive_to_within_half_a_code(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome()
    survey = payload(written(outcome, tmp_path))
    outdoor = outcome.scenario.outdoor
    for name, (low, high) in {
        "mean": survey["gain_range"],
        "std": (0.0, survey["std_high"]),
    }.items():
        step = (high - low) / 254
        for frame, codes in zip(outcome.frames, survey[name], strict=True):
            assert (codes[~outdoor] == 0).all()
            decoded = low + (codes[outdoor].astype(float) - 1) * step
            assert np.abs(decoded - getattr(frame, f"{name}_db")[outdoor]).max() <= step / 2 + 1e-4
    assert (
        survey["paths"].reshape(outcome.result.swarm.history.shape) == outcome.result.swarm.history
    ).all()
    assert survey["reading_step"].tolist() == np.repeat(np.arange(31), 2).tolist()
    assert np.allclose(survey["reading_gain"], outcome.result.measurements.gain_db)
    assert survey["steps"] == [0, 5, 10, 15, 20, 25, 30]


def test_unknown_truth_is_shown_as_nothing(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome(truth="partial")
    survey = payload(written(outcome, tmp_path))
    known = np.isfinite(outcome.truth_db) & outcome.scenario.outdoor
    assert ((survey["truth"].reshape(known.shape) > 0) == known).all()


def test_hostile_names_stay_text(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome(title=HOSTILE, name=HOSTILE, config={HOSTILE: {HOSTILE: HOSTILE}})
    for frame in outcome.frames:
        frame.scores[HOSTILE] = 1.0
    text = written(outcome, tmp_path)
    page = Page(text)
    assert [tag for tag, _ in page.tags].count("script") == 2
    assert "img" not in [tag for tag, _ in page.tags]
    assert "<img src=x onerror=alert(1)>" in page.words["h1"]
    assert payload(text)["groups"][-1]["title"] == HOSTILE


def test_a_survey_without_frames_shows_its_end(make_outcome: Make, tmp_path: Path) -> None:
    survey = payload(written(replace(make_outcome(), frames=(), config=None), tmp_path))
    assert survey["steps"] == [30]
    assert survey["groups"] == []


def test_a_huge_survey_is_thinned_but_keeps_its_ends(
    make_outcome: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = make_outcome()
    monkeypatch.setattr(page_data, "_MOST_MAP_BYTES", 2 * outcome.grid.size * 4)
    survey = payload(written(outcome, tmp_path))
    assert survey["steps"] == [0, 10, 20, 30]
    assert survey["score_steps"] == outcome.steps  # the chart keeps every point


def test_same_survey_same_page_but_for_its_timings(make_outcome: Make, tmp_path: Path) -> None:
    first, second = (
        re.sub(
            r'<dd class="value"><span>[\d.]+</span><small> m?s</small>',
            "",
            written(make_outcome(), tmp_path),
        )
        for _ in range(2)
    )
    assert first == second


class Browser:
    """A headless Chromium driven over its debugging pipe: messages are JSON, each ended by a zero
    byte."""

    def __init__(self, program: str, folder: Path) -> None:
        self._read_from, answers = os.pipe()
        commands, self._write_to = os.pipe()
        inherited = [fcntl.fcntl(end, fcntl.F_DUPFD, 50) for end in (commands, answers)]

        def attach() -> None:  # the browser expects its commands on descriptor 3 and answers on 4
            os.dup2(inherited[0], 3)
            os.dup2(inherited[1], 4)

        options = (
            "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run "
            "--disable-background-networking"
        )
        options += (
            f" --disable-component-update --disable-sync --window-size=1200,1000"
            f" --user-data-dir={folder} --remote-debugging-pipe"
        )
        self._process = subprocess.Popen(
            [program, *options.split(), "about:blank"],
            preexec_fn=attach,
            close_fds=False,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for end in (*inherited, commands, answers):
            os.close(end)
        self._pending, self._count, self.events = b"", 0, []
        self._session: dict[str, str] = {}
        target = next(t for t in self("Target.getTargets")["targetInfos"] if t["type"] == "page")[
            "targetId"
        ]
        self._session = {
            "sessionId": self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        }
        for domain in ("Runtime", "Page", "Log", "Network"):
            self(f"{domain}.enable")

    def __call__(self, method: str, **params: Any) -> dict[str, Any]:
        self._count += 1
        message = {"id": self._count, "method": method, "params": params, **self._session}
        os.write(self._write_to, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._pending:
                chunk = os.read(self._read_from, 65536)
                assert chunk, "the browser ended"
                self._pending += chunk
            text, self._pending = self._pending.split(b"\0", 1)
            answer = json.loads(text)
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def run(self, expression: str) -> Any:
        answer = self(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression: str) -> None:
        for _ in range(600):
            if self.run(expression):
                return
            time.sleep(0.05)
        pytest.fail(
            f"waited 30 s for {expression}; the page says: {self.run('document.body.innerText')}"
        )

    def press(self, key: str) -> None:
        text = {"text": key} if len(key) == 1 else {}
        self("Input.dispatchKeyEvent", type="keyDown", key=key, code=key, **text)
        self("Input.dispatchKeyEvent", type="keyUp", key=key, code=key)

    def click(self, selector: str) -> None:
        self.run(f"document.querySelector({json.dumps(selector)}).click()")

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._write_to)
        os.close(self._read_from)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    program = (
        shutil.which("chromium")
        or shutil.which("chromium-browser")
        or shutil.which("google-chrome")
    )
    if program is None:
        pytest.skip("no Chromium to open the report with; install chromium to run this test")
    opened = Browser(program, tmp_path_factory.mktemp("browser"))
    yield opened
    opened.close()


@pytest.mark.parametrize("truth", ["full", None])
def test_the_survey_can_be_stepped_in_a_browser(
    make_outcome: Make, tmp_path: Path, browser: Browser, truth: str | None
) -> None:
    write_report(make_outcome(truth=truth, title=HOSTILE), tmp_path / "report.html")
    browser.events.clear()
    browser("Page.navigate", url=(tmp_path / "report.html").as_uri() + "#step=12")
    browser.wait("document.readyState === 'complete' && document.body.dataset.ready")

    def at() -> list[str]:
        return browser.run("[document.body.dataset.view, document.body.dataset.step]")

    assert at() == ["mean", "10"]  # the link's step, rounded down to a frame
    for key, step in {"ArrowRight": "15", "ArrowLeft": "10", "End": "30", "Home": "0"}.items():
        browser.press(key)
        assert at()[1] == step, key
    browser.press("2")
    assert at()[0] == "std"
    browser.press("3")
    assert at()[0] == ("std" if truth is None else "error")
    browser.click("#forward")
    assert at()[1] == "5"
    assert (
        browser.run("document.querySelector('#slider').getAttribute('aria-valuetext')")
        == "step 5 of 30"
    )
    assert browser.run("document.querySelector('#status').textContent").startswith("Step 5 of 30. ")

    # the figures follow the step shown, and the address the state
    def figure(name: str) -> str:
        return browser.run(f"document.querySelector('[data-live={name}] .value span').innerText")

    assert 0 < float(figure("flown")) <= 20  # five steps of 4 m at most
    before = figure("readings")
    browser.press("End")
    assert figure("readings") != before
    browser.run(
        "(() => { const t = document.querySelector('#threshold'); t.value = -999; "
        "t.dispatchEvent(new Event('input')) })()"
    )
    assert figure("covered") == "100"
    assert "threshold=-999" in browser.run("location.hash")

    # the pointer on a cell that was measured from the start: the UAV's first, in the south-west
    # corner
    browser.press("1")
    browser.run("document.querySelector('#canvas').scrollIntoView({ block: 'end' })")
    x, y = browser.run(
        "(() => { const r = document.querySelector('#canvas').getBoundingClientRect(); return "
        "[r.left, r.bottom] })()"
    )
    browser("Input.dispatchMouseEvent", type="mouseMoved", x=x + 55, y=y - 46)
    assert "x 2 m, y 2 m" in browser.run("document.querySelector('#readout').textContent")
    assert "by UAV 0 at step" in browser.run("document.querySelector('#readout').textContent")

    browser.run("document.querySelector('#speed').value = '4'")
    browser.press(" ")
    assert browser.run("document.querySelector('#play').getAttribute('aria-label')") == "Pause"
    browser.wait("document.body.dataset.step === '30'")
    browser.wait("document.querySelector('#play').getAttribute('aria-label') === 'Play'")

    kinds = [event["method"] for event in browser.events]
    assert "Runtime.exceptionThrown" not in kinds
    assert "Log.entryAdded" not in kinds
    assert kinds.count("Network.requestWillBeSent") == 1  # the page itself


def test_the_figures_are_those_of_the_survey(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome(config={"threshold_db": -100.0, "speed_mps": 4.0})
    text = written(outcome, tmp_path)
    assert 'id="threshold" step="any" value="-100"' in text
    mean = outcome.mean_db[outcome.scenario.outdoor]
    assert f"<span>{100 * (mean >= -100).mean():.0f}</span><small> %" in text
    way_m = max(np.abs(np.diff(path, axis=0)).sum() * 4.0 for path in outcome.result.swarm.history)
    assert f"<span>{way_m:.0f}</span><small> m</small>" in text
    assert f"{way_m / 4.0 / 60:.1f} min at 4 m/s" in text
    assert "roof below the flight" in text  # one is 6 m high
