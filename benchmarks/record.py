"""The record of a study: its tables, the command that printed them, the machine, the data.

A record is a JSON file in benchmarks/results; the Markdown file beside it is the same for people.
The documents take their tables from records, see `benchmarks.document_tables`.
"""

from __future__ import annotations

__all__ = ["RESULTS", "Record", "Table", "names", "parsed", "part"]

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from skygain.ground.files import atomic_write
from skygain.ground.strict_json import json_text

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Table:
    """One table."""

    title: str
    """the sentences above it"""
    head: Sequence[str]
    """names of the columns"""
    rows: Sequence[Sequence[str]]
    """cells as they are printed; a table without rows is text alone"""
    part: str = ""
    """heading of the part it belongs to, where one record has several"""

    def lines(self) -> list[str]:
        """The table as lines of Markdown, without its title."""
        if not self.rows:
            return []
        head = ["| " + " | ".join(self.head) + " |", "|" + "---|" * len(self.head)]
        return head + ["| " + " | ".join(row) + " |" for row in self.rows]


@dataclass(frozen=True)
class Record:
    """What one study found."""

    name: str
    """stem of its two files"""
    command: str
    """prints it again; ``DATA`` stands for the data"""
    tables: Sequence[Table]
    """in the order of printing"""
    data: str = ""
    """what it was measured on"""
    machine: str = ""
    """what it was measured with"""
    comparison: dict[str, Any] = field(default_factory=dict)
    """numbers of a comparison of methods, see `benchmarks.evaluations`"""

    @classmethod
    def read(cls, name: str, folder: Path = RESULTS) -> Record:
        """The committed record."""
        found = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        return cls(**found | {"tables": [Table(**table) for table in found["tables"]]})

    @property
    def source(self) -> str:
        """One sentence: what printed it, on what."""
        parts = [f"Printed by `{self.command}`"]
        parts += [f"on {self.data}"] if self.data else []
        return " ".join(parts) + (f"; {self.machine}." if self.machine else ".")

    def markdown(self) -> str:
        """For people."""
        blocks, heading = [], ""
        for table in self.tables:
            if table.part != heading:
                heading = table.part
                blocks.append(f"## {heading}")
            blocks += [block for block in (table.title, "\n".join(table.lines())) if block]
        return "\n\n".join([*blocks, self.source]) + "\n"

    def write(self, folder: Path = RESULTS) -> None:
        """Write both files."""
        kept = {key: value for key, value in asdict(self).items() if value}
        kept["tables"] = [{k: v for k, v in table.items() if v} for table in kept["tables"]]
        for table in kept["tables"]:
            table |= {key: table.get(key, []) for key in ("head", "rows")}
            table.setdefault("title", "")
        for suffix, text in ((".json", json_text(kept)), (".md", self.markdown())):
            with atomic_write(folder / f"{self.name}{suffix}") as path:
                path.write_text(text, encoding="utf-8")


def names(folder: Path = RESULTS) -> list[str]:
    """Every record there is."""
    return sorted(path.stem for path in folder.glob("*.json"))


def part(found: Record, number: int, columns: str = "", rows: str = "") -> Table:
    """The ``number``-th table, counted from 1; ``columns`` such as ``1-4,7``, and only the rows
    whose first cell is among ``rows``, separated by semicolons, in that order."""
    table = found.tables[number - 1]
    chosen = [
        k
        for span in (columns or f"1-{len(table.head)}").split(",")
        for k in range(int(span.split("-")[0]) - 1, int(span.split("-")[-1]))
    ]
    kept = list(table.rows)
    if rows:
        wanted = [name.strip() for name in rows.split(";")]
        if unknown := set(wanted) - {row[0] for row in table.rows}:
            raise KeyError(f"{found.name} has no row {', '.join(sorted(unknown))}")
        kept = [row for name in wanted for row in table.rows if row[0] == name]
    return Table(
        table.title, [table.head[k] for k in chosen], [[row[k] for k in chosen] for row in kept]
    )


def parsed(markdown: str) -> list[Table]:
    """The tables of a Markdown text, each with the paragraphs above it."""
    tables: list[Table] = []
    text: list[str] = []
    heading = ""
    for block in re.split(r"\n\s*\n", markdown.strip()):
        if block.startswith("|"):
            rows = [
                [cell.strip() for cell in line.strip()[1:-1].split("|")]
                for line in block.splitlines()
            ]
            tables.append(Table("\n\n".join(text), rows[0], rows[2:], heading))
            text = []
        elif block.startswith("#"):
            heading = block.lstrip("# ")
        else:
            text.append(" ".join(block.split()))
    if text:
        tables.append(Table("\n\n".join(text), [], [], heading))
    return tables
