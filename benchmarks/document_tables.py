"""Write the measured tables of README.md and docs/ from the records in benchmarks/results.

    python -m benchmarks.document_tables [--check]

A table stands between ``<!-- measured REQUEST -->`` and ``<!-- end -->``, with the command that
printed it. Requests, NAME being a record:

    table NAME K [columns 1-4,7] [rows A; B]   the K-th table
    parts NAME K [columns 1-4]                 the K-th table of every part, stacked
    scores NAME                                every method of a comparison
    errors NAME: A; B                          the RMSE of some methods
    against NAME: BASE; A; B                   the same, brackets: paired difference from BASE
    differences NAME: A - B; C - D             paired differences
    saved NAME: A; B                           flight saved by some methods

``src/skygain/data/scores_t2.json``, from which `skygain methods NAME` takes a method's score on T2,
is written in the same way.

With ``--check`` nothing is written, and the exit code is 1 if a page is not what its records say,
if the Markdown of a record is not what its numbers say, or if a table of measured numbers has no
request.
"""

from __future__ import annotations

import argparse
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.record import RESULTS, Record, Table, names, part
from skygain.ground.strict_json import json_text

ROOT = Path(__file__).parents[1]
SCORES = ROOT / "src" / "skygain" / "data" / "scores_t2.json"
SETTING = re.compile(
    r"(\d+) surveys in (\d+) cities of T2, .*3 UAVs, start cluster, 200 steps, altitude 10 m, "
    r"noise 0 dB"
)
"""how a record begins whose scores belong together"""
BLOCK = re.compile(r"<!-- measured\s+([^>]*?)\s*-->\n.*?<!-- end -->", re.DOTALL)
MEASURED = re.compile(
    r"[−+-]?\d[\d,]*(\.\d+( ?(dB|ms|s|MB|MiB|%|×)| ?[\[±/].*)?| ?(dB|ms|s|MB|MiB|%|×))"
)
"""a cell that is a number with decimals, a unit, an interval or a spread"""
UNIT = re.compile(r"\b(dB|ms|s|seconds|MiB)\b")
"""a heading that makes whole numbers below it measured ones"""


def pages() -> list[Path]:
    """Every page whose tables are checked."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def triple(values: list[float]) -> str:
    """A mean with its interval, which a single city does not give."""
    if values[1] is None:
        return f"{values[0]:.2f}"
    return f"{values[0]:.2f} [{values[1]:.2f}, {values[2]:.2f}]"


def scores(found: Record) -> Table:
    """One row per method."""
    head = ["method", *(f"T = {t}" for t in found.comparison["steps"])]
    rows = []
    for method, entry in sorted(found.comparison["methods"].items()):
        curves = entry["scores"]
        row = [method, *map(triple, curves["rmse_db"])]
        row += [f"{curves[key][-1][0]:.2f}" for key in ("rmse_ray_traced_db", "rmse_rest_db")]
        rows.append([*row, f"{entry['gof']:+.2f}", f"{100 * curves['coverage90'][-1][0]:.1f} %"])
    return Table("", [*head, "ray-traced", "rest", "GoF", "90 % cover"], rows)


def errors(found: Record, methods: list[str]) -> Table:
    """RMSE of ``methods``, a row each."""
    rows = [
        [method, *map(triple, found.comparison["methods"][method]["scores"]["rmse_db"])]
        for method in methods
    ]
    head = [f"RMSE T={t}" for t in found.comparison["steps"]]
    return Table("", ["predictor / planner", *head], rows)


def paired(found: Record, one: str, other: str, key: str) -> list[list[float]]:
    """``one`` minus ``other`` at every step: (mean, low, high)."""
    for entry in found.comparison["paired"]:
        if (entry["method"], entry["minus"]) == (one, other):
            return entry[key]
        if (entry["method"], entry["minus"]) == (other, one):
            return [[-mean, -high, -low] for mean, low, high in entry[key]]
    raise KeyError(f"{found.name} has no pair {one!r}, {other!r}")


def against(found: Record, methods: list[str]) -> Table:
    """RMSE of ``methods``, in brackets the paired difference from the first."""
    table = errors(found, methods)
    rows = [[row[0], *(cell.split(" [")[0] for cell in row[1:])] for row in table.rows]
    for row in rows[1:]:
        gaps = paired(found, row[0], methods[0], "rmse_db")
        row[1:] = [
            f"{cell} [{low:+.2f}, {high:+.2f}]"
            for cell, (_, low, high) in zip(row[1:], gaps, strict=True)
        ]
    return Table("", table.head, rows)


def differences(found: Record, pairs: list[str]) -> Table:
    """One row per pair: paired difference and its share of the second method's mean; ray-traced
    cells at the last step."""
    steps = found.comparison["steps"]
    wanted = [("rmse_db", k, f"T = {t}") for k, t in enumerate(steps)]
    if all("rmse_ray_traced_db" in entry for entry in found.comparison["paired"]):
        wanted.append(("rmse_ray_traced_db", -1, f"ray-traced, T = {steps[-1]}"))
    rows = []
    for pair in pairs:
        one, other = pair.split(" - ")
        base = found.comparison["methods"][other]["scores"]
        row = [f"{one} − {other}"]
        for key, k, _ in wanted:
            mean, low, high = paired(found, one, other, key)[k]
            share = 100 * mean / base[key][k][0]
            row.append(f"{mean:+.2f} [{low:+.2f}, {high:+.2f}] ({share:+.0f} %)")
        rows.append(row)
    return Table("", ["difference", *(title for *_, title in wanted)], rows)


def saved(found: Record, methods: list[str]) -> Table:
    """Flight saved against the three simple planners."""
    rivals = {
        "random-waypoint": "random waypoints",
        "greedy-variance": "greedy variance",
        "lawnmower": "lawnmower",
    }
    rows = []
    for method in methods:
        ratio = {
            row["rival"]: row["flight_saved"]
            for row in found.comparison["flight_saved"]
            if f"{row['predictor']} / {row['planner']}" == method
        }
        cells = [f"{ratio[r]:.2f}×" if ratio.get(r) else "not reached" for r in rivals]
        rows.append([method, *cells])
    return Table("", ["method", *(f"against {name}" for name in rivals.values())], rows)


def stacked(found: Record, number: int, columns: str) -> Table:
    """The ``number``-th table of every part, the part in the first column."""
    titles = list(dict.fromkeys(table.part for table in found.tables))
    rows: list[list[str]] = []
    for title in titles:
        of_part = [table for table in found.tables if table.part == title]
        chosen = part(Record("", "", of_part), number, columns)
        rows += [[title, *row] for row in chosen.rows]
    return Table("", ["", *chosen.head], rows)


NAMED: dict[str, Callable[..., Table]] = {
    "errors": errors,
    "against": against,
    "differences": differences,
    "saved": saved,
}
PLAIN = re.compile(r"(table|parts) (\w+) (\d+)(?: columns ([\d,-]+))?(?: rows (.+))?")


def block(request: str, results: str) -> str:
    """What stands between the marks: the table and what printed it; ``results`` is the way from the
    page to the records."""
    if found := PLAIN.fullmatch(request):
        kind, name, number, columns, rows = found.groups()
        record = Record.read(name)
        if kind == "parts":
            table = stacked(record, int(number), columns or "")
        else:
            table = part(record, int(number), columns or "", rows or "")
    else:
        head, _, rest = request.partition(":")
        kind, name = head.split()
        record = Record.read(name)
        wanted = [item.strip() for item in rest.split(";") if item.strip()]
        table = NAMED[kind](record, wanted) if wanted else scores(record)
    where = ", ".join(item for item in (record.data, record.machine) if item)
    source = f"([Record]({results}/{name}.md), `{record.command}`; {where}.)"
    lines = textwrap.wrap(source, 100, break_long_words=False, break_on_hyphens=False)
    return "\n".join([*table.lines(), "", *lines])


def filled(text: str, results: str = "../benchmarks/results") -> str:
    """The page with every measured table as its record has it."""

    def replace(found: re.Match[str]) -> str:
        asked = " ".join(found[1].split())
        mark = found[0].split("-->")[0] + "-->"
        return f"{mark}\n\n{block(asked, results)}\n\n<!-- end -->"

    return BLOCK.sub(replace, text)


def unmarked(text: str) -> Iterator[str]:
    """The first lines of tables that hold measured numbers and no request."""
    for found in re.finditer(r"(?:^\|.*\n)+", BLOCK.sub("", text), re.MULTILINE):
        head, _, *rows = (
            [cell.strip() for cell in line.strip().strip("|").split("|")]
            for line in found[0].splitlines()
        )
        measured = [
            bool(MEASURED.fullmatch(cell) or (UNIT.search(title) and cell.isdigit()))
            for row in rows
            for title, cell in list(zip(head, row, strict=False))[1:]
        ]
        if sum(measured) >= 2:
            yield found[0].splitlines()[0]


def scores_t2() -> str:
    """Score on T2 of every method that some record compares there, the one of most surveys."""
    found: dict[str, dict[str, Any]] = {}
    for name in names():
        record = Record.read(name)
        setting = SETTING.match(record.tables[0].title)
        if not (record.comparison and setting):
            continue
        for method, entry in record.comparison["methods"].items():
            surveys = int(setting[1])
            if surveys > found.get(method, {"surveys": 0})["surveys"]:
                found[method] = {
                    "rmse_db": entry["scores"]["rmse_db"][-1],
                    "surveys": surveys,
                    "data": record.data,
                    "record": name,
                }
    return json_text(found)


def stale_records(folder: Path = RESULTS) -> Iterator[str]:
    """Records whose Markdown is not what their numbers say, and files without a record."""
    for name in names(folder):
        if (folder / f"{name}.md").read_text(encoding="utf-8") != Record.read(name).markdown():
            yield f"{name}.md is not what {name}.json says"
    for path in folder.iterdir():
        if not path.with_suffix(".json").exists():
            yield f"{path.name} has no record beside it"


def main(arguments: list[str] | None = None) -> int:
    """Write the tables, or check them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    check = parser.parse_args(arguments).check
    failures: list[Any] = list(stale_records()) if check else []
    for page in pages():
        text = page.read_text(encoding="utf-8")
        try:
            depth = "../" * len(page.relative_to(ROOT).parent.parts)
            wanted = filled(text, f"{depth}benchmarks/results")
        except (KeyError, OSError, ValueError, IndexError) as error:
            failures.append(f"{page.name}: a request cannot be met: {error}")
            continue
        if check:
            failures += [
                f"{page.name}: measured numbers without a request: {line}"
                for line in unmarked(text)
            ]
        if wanted != text and check:
            failures.append(f"{page.name}: not what the records say; run this without --check")
        elif wanted != text:
            page.write_text(wanted, encoding="utf-8")
            print(f"{page.name}: written")
    if not SCORES.exists() or SCORES.read_text(encoding="utf-8") != scores_t2():
        if check:
            failures.append(f"{SCORES.name}: not what the records say; run this without --check")
        else:
            SCORES.write_text(scores_t2(), encoding="utf-8")
            print(f"{SCORES.name}: written")
    print("\n".join(failures) if failures else "the measured tables are what their records say")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
