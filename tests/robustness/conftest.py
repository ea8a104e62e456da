"""At the end, what the trials ended in."""

from __future__ import annotations

from collections import Counter

import pytest

from .processes import TRIALS

ENDS = ("passed", "failed", "error", "skipped")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line for each kind of trial, where there are many."""
    if TRIALS == 1:
        return
    found: dict[str, Counter[str]] = {}
    told: list[str] = []
    for end in ENDS:
        for report in terminalreporter.stats.get(end, []):
            file, _, test = report.nodeid.rpartition("::")
            told += [str(value) for name, value in report.user_properties if name == "trials"]
            if "robustness/" in file:
                words = test.partition("[")[0].removeprefix("test_").replace("_", " ")
                kind = file.rpartition("/")[2].removeprefix("test_").removesuffix(".py")
                found.setdefault(f"{kind}: {words}", Counter())[end] += 1
    terminalreporter.section("trials")
    width = max(map(len, found), default=0)
    terminalreporter.write_line(" " * width + "".join(f"{end:>9}" for end in ENDS))
    for name, ends in sorted(found.items()):
        line = "".join(f"{ends[end] or '–':>9}" for end in ENDS)
        terminalreporter.write_line(f"{name:<{width}}{line}")
    for text in sorted(told):
        terminalreporter.write_line(text)
