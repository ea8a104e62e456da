"""Imports point one way, lazy ones included: from the rooms that use to the rooms that are used."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import skygain

ROOT = Path(skygain.__file__).parent
NOUNS = {"grid", "frames", "city", "scenario", "measurements", "posterior"}
FLOORS = (
    {"ground"},
    {"nouns"},
    {"cities", "fields"},
    {"propagation", "instruments", "flight"},
    {"datasets", "networks"},
    {"predictors"},
    {"planners"},
    {"survey", "testing"},
    {"environments", "evaluation"},
    {"training", "reports"},
    {"missions"},
    {"app"},
    {"__main__"},
)
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
FACE = "skygain"  # the face of the package shows things of every room


def modules() -> dict[str, Path]:
    """Dotted name to file of every module."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = ("skygain", *path.relative_to(ROOT).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def imports(name: str) -> Iterator[tuple[str, int]]:
    """Modules of the package that ``name`` imports anywhere in its code, with the line."""
    for node in ast.walk(ast.parse(MODULES[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import in line {node.lineno}"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            targets = [full if full in MODULES else str(node.module) for full in whole]
        else:
            continue
        yield from ((t, node.lineno) for t in targets if t in MODULES and t != name)


def room(name: str) -> str:
    """The room a module is in; the nouns share one."""
    first = name.split(".")[1] if "." in name else FACE
    return "nouns" if first in NOUNS else first


@pytest.mark.parametrize("name", [name for name in MODULES if name != FACE])
def test_no_import_points_up(name: str) -> None:
    assert room(name) in FLOOR, f"{name} is in no room of the plan: give its room a floor"
    wrong = [
        f"{target} in line {line}"
        for target, line in imports(name)
        if target != FACE
        and room(target) != room(name)
        and FLOOR[room(target)] >= FLOOR[room(name)]
    ]
    assert not wrong, f"{name} imports from its own floor or above: {'; '.join(wrong)}"


def test_no_circle() -> None:
    graph = {name: {target for target, _ in imports(name)} - {FACE} for name in MODULES}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("modules import each other: " + " -> ".join(error.args[1]))
