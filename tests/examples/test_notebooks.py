"""The notebooks run from the first cell to the last, and hold no results of any machine."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
import pytest

from skygain.predictors import PREDICTORS

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyogrio", reason="reads the footprints of the example")
    monkeypatch.chdir(FOLDER)  # where a notebook's own paths begin
    monkeypatch.setattr(PREDICTORS, "_factories", dict(PREDICTORS._factories))
    before = set(FOLDER.parent.rglob("*"))
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    module = ModuleType(f"notebook_{path.stem}")
    monkeypatch.setitem(sys.modules, module.__name__, module)  # where dataclasses look names up
    with mpl.rc_context({"backend": "Agg"}):
        for cell in cells:
            if cell["cell_type"] == "code":
                code = compile("".join(cell["source"]), f"{path.name}, cell {cell['id']}", "exec")
                exec(code, vars(module))
    assert set(FOLDER.parent.rglob("*")) == before


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_results(path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["cells"][0]["source"][0].startswith("# ")
    for cell in notebook["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_there_is_a_gallery() -> None:
    assert len(NOTEBOOKS) >= 3
