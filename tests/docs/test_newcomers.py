"""Three newcomers type what their pages say, nothing else, and reach their result.

A flight of a few steps over a simple truth shows that a command works; `docs/check.py --run` types
them as they stand.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from skygain.app.cli import command_line

DOCS = Path(__file__).parents[2] / "docs"
SPEC = importlib.util.spec_from_file_location("docs_check", DOCS / "check.py")
check = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(check)

NEWCOMERS = {
    "student": ["tutorial.md"],
    "researcher": ["how-to/compare-methods.md", "how-to/add-a-predictor.md"],
    "operator": ["how-to/plan-over-my-city.md", "how-to/map-my-readings.md"],
}
"""who types the commands of which pages"""
SHORT = {
    "survey": ["--steps", "4", "--predictor", "idw"],
    "evaluate": ["--steps", "4", "--workers", "1", "--max-surveys", "1"],
    "map": ["--no-validate"],
    "dataset build": ["--propagation", "over-rooftop"],
}
"""what is added to a command, so that it ends in a second or two"""


def shortened(words: list[str]) -> list[str]:
    """The words, and what makes the command short; what the page chose stays."""
    name = " ".join(words[:2]) if words[0] == "dataset" else words[0]
    more = SHORT.get(name, [])
    if name == "survey" and "--predictor" in words:
        more = more[:2]
    if name == "survey" and not {"--truth", "--replay"} & {*words} and "sample" not in str(words):
        more = [*more, "--propagation", "over-rooftop"]
    return [*words, *more]


@pytest.mark.parametrize("who", NEWCOMERS)
def test_a_newcomer_gets_there_by_the_commands_of_the_pages(
    who: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyogrio", reason="reads footprints")
    (tmp_path / "examples").symlink_to(DOCS.parent / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mymodule", raising=False)
    typed = 0
    for page in NEWCOMERS[who]:
        check.write_module(DOCS / page, tmp_path)
        for words in check.runnable(DOCS / page):
            found = CliRunner().invoke(command_line(), shortened(words))
            assert found.exit_code == 0, (words, found.exception, found.output)
            typed += 1
            if "--out" in words:
                out = tmp_path / words[words.index("--out") + 1]
                left = {"evaluate": out / "table.md", "dataset": out}.get(words[0])
                assert (left or out / "report.html").exists(), words
    assert typed >= 4
    monkeypatch.delitem(sys.modules, "mymodule", raising=False)
