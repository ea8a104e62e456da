"""What can be chosen by name, and what each choice is."""

from __future__ import annotations

__all__ = ["run_methods"]

import inspect
import json
import sys
import textwrap
from collections.abc import Callable
from importlib.resources import files
from typing import Any

from skygain.app.progress import SILENT, Progress
from skygain.app.requests import MethodsRequest
from skygain.ground.errors import InputError, did_you_mean
from skygain.planners import PLANNERS
from skygain.predictors import PREDICTORS
from skygain.propagation import PROPAGATION
from skygain.survey.methods import options_of

_REGISTRIES = (PREDICTORS, PLANNERS, PROPAGATION)


def run_methods(request: MethodsRequest, progress: Progress = SILENT) -> str:
    """All names by kind, or one of them explained.

    Raises:
        InputError: no predictor, planner or propagation model has that name.
    """
    if request.name is None:
        lists = [f"{each.kind}: {', '.join(each.names())}" for each in _REGISTRIES]
        return "\n".join([*lists, "one of them explained: skygain methods NAME"])
    name = request.name.removesuffix("+tx")
    for registry in _REGISTRIES:
        if name in registry:
            factory = registry.factory(name)
            told = _about(factory) if registry is PROPAGATION else _explained(factory)
            return "\n\n".join([f"{registry.kind} {name}", told, *_scores(name)])
    names = [each for registry in _REGISTRIES for each in registry.names()]
    raise InputError(f"nothing is called {name!r}; {did_you_mean(name, names)}")


def _explained(factory: Callable[..., Any]) -> str:
    """What it is, what it needs, and its options."""
    lines = [_about(factory)]
    needs = _needs(factory)
    if needs:
        lines += ["", f"needs: {needs}"]
    options = options_of(factory)
    if options:
        lines += ["", "options, written name:key=value:"]
    for option in options:
        head = f"{option.name} ({option.allowed}; {option.default})"
        text = option.text.replace("``", "")
        told = textwrap.wrap(f"{head}: {text}" if text else head, 90)
        lines += [f"  {told[0]}", *(f"      {line}" for line in told[1:])]
    return "\n".join(lines)


def _scores(name: str) -> list[str]:
    """Its error on the validation cities, alone or with the method it was flown with."""
    path = files("skygain") / "data" / "scores_t2.json"
    found = json.loads(path.read_text(encoding="utf-8"))
    pairs = {label: label.split(" / ") for label in found}
    of = [label for label, parts in pairs.items() if name in parts]
    # one's options only where it was never flown as it stands
    of = of or [k for k, parts in pairs.items() if name in (p.split(":")[0] for p in parts)]
    if not of:
        return []
    wide = max(map(len, of))
    head = (
        "RMSE on T2, the validation cities, with the 95 % interval over cities: 3 UAVs from a\n"
        "cluster after 200 steps at 10 m"
    )
    rows = []
    for label in sorted(of, key=lambda label: found[label]["rmse_db"][0]):
        mean, low, high = found[label]["rmse_db"]
        rows.append(
            f"  {label:{wide}}  {mean:5.2f} dB [{low:.2f}, {high:.2f}], "
            f"{found[label]['surveys']} surveys, {found[label]['data']}"
        )
    return ["\n".join([head, *rows])]


def _about(factory: Callable[..., Any]) -> str:
    """First paragraph of its docstring, or of its module's where that says it."""
    text = inspect.getdoc(factory) or ""
    if not text or text.startswith("See the module"):
        text = inspect.getdoc(sys.modules[factory.__module__]) or ""
    paragraph = " ".join(text.split("\n\n")[0].split())
    return textwrap.fill(paragraph.replace("``", ""), 96)


def _needs(factory: Callable[..., Any]) -> str:
    """Whether a predictor has to be told the transmitter; nothing for others."""
    try:
        asked = getattr(factory(), "transmitter", None)
    except (TypeError, ImportError, InputError) as error:
        return f"cannot be made here: {error}"
    told = {
        "required": "the transmitter's position",
        "optional": "nothing; is told the transmitter's position when written with +tx",
    }
    return told.get(str(asked), "")
