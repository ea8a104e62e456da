"""Write the tables of docs/test-cities.md from benchmarks/results/test_cities_*.json:  python benchmarks/test_cities_tables.py

A table stands between the lines ``<!-- NAME -->`` and ``<!-- end -->``, where NAME is ``scores COMPARISON``,
``differences COMPARISON: A - B; C - D`` or ``saved COMPARISON: A; B``; everything else in the page is left as it is.
"""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "test-cities.md"
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
        cells = [f"{v['mean']:.2f} [{v['low']:.2f}, {v['high']:.2f}]" for v in (at(found, curves["rmse_db"], t) for t in STEPS)]
        cells += [f"{at(found, curves[key], 200)['mean']:.2f}" for key in ("rmse_ray_traced_db", "rmse_rest_db")]
        cover = at(found, curves["coverage90"], 200)["mean"]
        lines.append(f"| {method} | {' | '.join(cells)} | {entry['gof']:+.2f} | {100 * cover:.1f} % |")
    return lines


def differences(name: str, pairs: list[str]) -> list[str]:
    """One row per pair: paired difference and its share of the second method's mean; ray-traced cells at T = 200 last."""
    found = comparison(name)
    lines = ["| difference | T = 50 | T = 100 | T = 200 | ray-traced, T = 200 |", "|---|---|---|---|---|"]
    for pair in pairs:
        one, other = pair.split(" - ")
        entry = next((p for p in found["paired"] if (p["method"], p["minus"]) == (one, other)), None)
        sign = 1.0
        if entry is None:
            entry, sign = next(p for p in found["paired"] if (p["method"], p["minus"]) == (other, one)), -1.0
        cells = []
        for key, step in [("rmse_db", t) for t in STEPS] + [("rmse_ray_traced_db", 200)]:
            value = at(found, entry[key], step)
            low, high = sorted((sign * value["low"], sign * value["high"]))
            base = at(found, found["methods"][other]["scores"][key], step)["mean"]
            cells.append(f"{sign * value['mean']:+.2f} [{low:+.2f}, {high:+.2f}] ({100 * sign * value['mean'] / base:+.0f} %)")
        lines.append(f"| {one} − {other} | {' | '.join(cells)} |")
    return lines


def saved(name: str, methods: list[str]) -> list[str]:
    """Flight saved against the three simple planners."""
    found = comparison(name)
    rivals = {"random-waypoint": "random waypoints", "greedy-variance": "greedy variance", "lawnmower": "lawnmower"}
    lines = ["| method | against " + " | ".join(rivals.values()) + " |", "|---|---|---|---|"]
    for method in methods:
        predictor, planner = method.split(" / ")
        ratio = {
            r["rival"]: r["flight_saved"] for r in found["flight_saved"] if (r["predictor"], r["planner"]) == (predictor, planner)
        }
        lines.append(f"| {method} | " + " | ".join(f"{ratio[r]:.2f}×" if ratio.get(r) else "not reached" for r in rivals) + " |")
    return lines


def table(request: str) -> list[str]:
    """What stands under ``<!-- request -->``."""
    head, _, rest = request.partition(":")
    kind, name = head.split()
    wanted = [part.strip() for part in rest.split(";") if part.strip()]
    return {
        "scores": lambda: scores(name),
        "differences": lambda: differences(name, wanted),
        "saved": lambda: saved(name, wanted),
    }[kind]()


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    block = re.compile(r"<!-- ((?:scores|differences|saved) [^>]*?) -->\n.*?<!-- end -->", re.DOTALL)
    found = block.sub(lambda m: "\n".join([f"<!-- {m[1]} -->", "", *table(m[1]), "", "<!-- end -->"]), text)
    PAGE.write_text(found, encoding="utf-8")
    print(f"{len(block.findall(text))} tables in {PAGE.name}")


if __name__ == "__main__":
    main()
