"""Write the measured tables of README.md and docs/ from benchmarks/results:  python
benchmarks/document_tables.py [--check]

A table stands between the lines ``<!-- REQUEST -->`` and ``<!-- end -->``; everything else in a
page is left as it is. From ``test_cities_NAME.json`` come ``scores NAME``, ``errors NAME: A; B``
(the RMSE of some methods), ``differences NAME: A - B; C - D`` and ``saved NAME: A; B``; ``file
NAME.md table K columns N`` is the first N columns of the K-th table of that file. With ``--check``
nothing is written, and the exit code is 1 if a page is not what it should be.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGES = [HERE.parent / "README.md", *sorted((HERE.parent / "docs").glob("*.md"))]
STEPS = (50, 100, 200)


@cache
def comparison(name: str) -> dict[str, Any]:
    """The committed numbers."""
    return json.loads((HERE / "results" / f"test_cities_{name}.json").read_text())


def at(found: dict[str, Any], curve: list[dict[str, float]], step: int) -> dict[str, float]:
    """The entry of a curve at ``step``."""
    return curve[found["steps"].index(step)]


def scores(name: str) -> list[str]:
    """One row per method."""
    found = comparison(name)
    lines = [
        "| method | T = 50 | T = 100 | T = 200 | ray-traced | rest | GoF | 90 % cover |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for method, entry in sorted(found["methods"].items()):
        curves = entry["scores"]
        cells = [
            f"{v['mean']:.2f} [{v['low']:.2f}, {v['high']:.2f}]"
            for v in (at(found, curves["rmse_db"], t) for t in STEPS)
        ]
        cells += [
            f"{at(found, curves[key], 200)['mean']:.2f}"
            for key in ("rmse_ray_traced_db", "rmse_rest_db")
        ]
        cover = at(found, curves["coverage90"], 200)["mean"]
        lines.append(
            f"| {method} | {' | '.join(cells)} | {entry['gof']:+.2f} | {100 * cover:.1f} % |"
        )
    return lines


def errors(name: str, methods: list[str]) -> list[str]:
    """RMSE of ``methods``, a row each."""
    found = comparison(name)
    lines = [
        "| predictor / planner | " + " | ".join(f"RMSE T={t}" for t in STEPS) + " |",
        "|---" * (len(STEPS) + 1) + "|",
    ]
    for method in methods:
        values = [at(found, found["methods"][method]["scores"]["rmse_db"], t) for t in STEPS]
        cells = " | ".join(f"{v['mean']:.2f} [{v['low']:.2f}, {v['high']:.2f}]" for v in values)
        lines.append(f"| {method} | {cells} |")
    return lines


def part_of_file(name: str, number: int, columns: int) -> list[str]:
    """The first ``columns`` columns of the ``number``-th table of a file, counted from 1."""
    blocks = re.findall(
        r"(?:^\|.*\n)+", (HERE / "results" / name).read_text(encoding="utf-8"), re.MULTILINE
    )
    rows = [row.strip().strip("|").split("|") for row in blocks[number - 1].splitlines()]
    return ["|" + "|".join(cells[:columns]) + "|" for cells in rows]


def differences(name: str, pairs: list[str]) -> list[str]:
    """One row per pair: paired difference and its share of the second method's mean; ray-traced
    cells at T = 200 last."""
    found = comparison(name)
    lines = [
        "| difference | T = 50 | T = 100 | T = 200 | ray-traced, T = 200 |",
        "|---|---|---|---|---|",
    ]
    for pair in pairs:
        one, other = pair.split(" - ")
        entry = next(
            (p for p in found["paired"] if (p["method"], p["minus"]) == (one, other)), None
        )
        sign = 1.0
        if entry is None:
            entry, sign = (
                next(p for p in found["paired"] if (p["method"], p["minus"]) == (other, one)),
                -1.0,
            )
        cells = []
        for key, step in [("rmse_db", t) for t in STEPS] + [("rmse_ray_traced_db", 200)]:
            value = at(found, entry[key], step)
            low, high = sorted((sign * value["low"], sign * value["high"]))
            base = at(found, found["methods"][other]["scores"][key], step)["mean"]
            cells.append(
                f"{sign * value['mean']:+.2f} [{low:+.2f}, {high:+.2f}] "
                f"({100 * sign * value['mean'] / base:+.0f} %)"
            )
        lines.append(f"| {one} − {other} | {' | '.join(cells)} |")
    return lines


def saved(name: str, methods: list[str]) -> list[str]:
    """Flight saved against the three simple planners."""
    found = comparison(name)
    rivals = {
        "random-waypoint": "random waypoints",
        "greedy-variance": "greedy variance",
        "lawnmower": "lawnmower",
    }
    lines = ["| method | against " + " | ".join(rivals.values()) + " |", "|---|---|---|---|"]
    for method in methods:
        predictor, planner = method.split(" / ")
        ratio = {
            r["rival"]: r["flight_saved"]
            for r in found["flight_saved"]
            if (r["predictor"], r["planner"]) == (predictor, planner)
        }
        lines.append(
            f"| {method} | "
            + " | ".join(f"{ratio[r]:.2f}×" if ratio.get(r) else "not reached" for r in rivals)
            + " |"
        )
    return lines


def table(request: str) -> list[str]:
    """What stands under ``<!-- request -->``."""
    if found := re.fullmatch(r"file (\S+) table (\d+) columns (\d+)", request):
        return part_of_file(found[1], int(found[2]), int(found[3]))
    head, _, rest = request.partition(":")
    kind, name = head.split()
    wanted = [part.strip() for part in rest.split(";") if part.strip()]
    return {
        "scores": lambda: scores(name),
        "errors": lambda: errors(name, wanted),
        "differences": lambda: differences(name, wanted),
        "saved": lambda: saved(name, wanted),
    }[kind]()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; fail if a page would change"
    )
    check = parser.parse_args().check
    block = re.compile(
        r"<!-- ((?:scores|errors|differences|saved|file) [^>]*?) -->\n.*?<!-- end -->", re.DOTALL
    )
    stale = 0
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found = block.sub(
            lambda m: "\n".join([f"<!-- {m[1]} -->", "", *table(m[1]), "", "<!-- end -->"]), text
        )
        if found != text:
            stale += 1
            print(
                f"{page.name}: "
                f"{'not what the results say; run this without --check' if check else 'written'}"
            )
            if not check:
                page.write_text(found, encoding="utf-8")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
