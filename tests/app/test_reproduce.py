"""`skygain reproduce` leaves pages whose links lead somewhere, and goes on with what is there."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from skygain.app.reproduce import _command, _draw, run_reproduce
from skygain.evaluation.paper.claims import claims_of
from skygain.evaluation.paper.flying import Reproduction
from skygain.evaluation.paper.request import NAMES, ReproduceRequest
from skygain.evaluation.paper.settings import FIGURES, SETTINGS, Figure
from skygain.ground.errors import InputError
from skygain.reports.paper_site import write_site

SPEC = importlib.util.spec_from_file_location(
    "paper_figures", Path(__file__).parents[1] / "evaluation" / "test_paper.py"
)
paper = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(paper)

ASKED = ReproduceRequest(figure="gain-bins", steps=3, crop=24, max_surveys=2, quick=True, workers=1)


def dead_links(folder: Path) -> list[str]:
    """Links and pictures of all pages that lead nowhere; nothing may come from a network."""
    dead = []
    for page in folder.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"""(?:href|src)=["']([^"']+)["']""", text):
            here = page.name if target.startswith("#") else target.partition("#")[0]
            if not (page.parent / here).is_file():
                dead.append(f"{page.name}: {target}")
            if target.startswith("#") and f'id="{target[1:]}"' not in text:
                dead.append(f"{page.name}: {target}")
        assert "<script" not in text
    return dead


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One figure flown with methods that need no network, so that it takes seconds."""
    out = tmp_path_factory.mktemp("paper")
    light = {"network": ("knn / lawnmower",), "kriging": ("idw / lawnmower",)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FIGURES, "gain-bins", Figure("Error by true gain", {"three": light}))
        yield _flown(out)


def _flown(out: Path) -> Path:
    told = run_reproduce(replace(ASKED, out=out))
    assert told.endswith(f"Pages: {out / 'index.html'}")
    return out


def test_the_pages_are_whole(folder: Path) -> None:
    assert dead_links(folder) == []
    results = json.loads((folder / "results.json").read_text())
    assert results["config"]["quick"] is True
    (rollouts,) = folder.glob("rollouts/*/rollouts.jsonl")
    flown = rollouts.read_text().splitlines()[1:]
    pictures = list(folder.glob("surveys/three/*.png"))
    assert len(pictures) == len(flown) == 2
    index = (folder / "index.html").read_text(encoding="utf-8")
    assert results["data_digest"] in index
    assert f"--out {folder.name}</code>" in index, "the command makes this folder again"
    assert str(folder) not in index, "no page says where it was made"
    assert "undecided" in index, "one city decides nothing"


def test_the_command_says_what_was_asked_for_and_not_who_computed() -> None:
    asked = replace(ASKED, cluster="tcp://10.0.0.7:8786", out=Path("some/where/paper"))
    words = "--figure gain-bins --quick --max-surveys 2 --steps 3 --crop 24 --out paper"
    assert _command(asked) == f"skygain reproduce {words}"


def test_it_goes_on_and_mixes_with_nothing_else(folder: Path) -> None:
    (rollouts,) = folder.glob("rollouts/*/rollouts.jsonl")
    before = rollouts.read_bytes()
    run_reproduce(replace(ASKED, out=folder))
    assert rollouts.read_bytes() == before, "nothing is flown twice"
    with pytest.raises(InputError, match=r"steps changed; to begin anew, delete .*rollouts\.jsonl"):
        run_reproduce(replace(ASKED, out=folder, steps=4))


def test_every_figure_is_drawn_and_linked(tmp_path: Path) -> None:
    """Of numbers as the paper has them; a stranger's name stays text."""
    figures = {name: paper.flown_figure(name, n=2, cities=2) for name in NAMES}
    comparisons = {}
    for flown in figures.values():
        for setting, comparison in flown.comparisons.items():
            held = comparisons.setdefault(setting, comparison)
            for part in ("scores", "delays", "by_gain"):
                getattr(held, part).update(getattr(comparison, part))
    request = ReproduceRequest(out=tmp_path, data="<b>cities.zarr.zip")
    found = Reproduction(
        request, figures, comparisons, dict(SETTINGS), ["<b>left out"], "0123", {"a.onnx": "45"}
    )
    claims = {name: claims_of(name, flown) for name, flown in figures.items()}
    pictures = {name: tmp_path / "figures" / f"{name}.png" for name in figures}
    for name, path in pictures.items():
        _draw(found, name, path)
        assert path.read_bytes()[:4] == b"\x89PNG"
    for setting in comparisons:  # what flying leaves
        (tmp_path / "rollouts" / setting).mkdir(parents=True)
        (tmp_path / "rollouts" / setting / "rollouts.jsonl").touch()
    (tmp_path / "results.json").touch()
    index = write_site(found, claims, pictures, "skygain reproduce").read_text(encoding="utf-8")
    assert dead_links(tmp_path) == []
    assert "<b>" not in index
    for claim in (c for of_figure in claims.values() for c in of_figure):
        assert claim.found in index
