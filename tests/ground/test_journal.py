"""A journal keeps every whole record, whatever happens to its writer."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from skygain.ground.errors import InputError
from skygain.ground.journal import Journal


def test_records_come_back(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, {"a": 1}) as journal:
        journal.append({"x": [1, 2]})
        journal.append({"x": "ü"})
    with Journal(path, {"a": 1}) as journal:
        assert journal.records == [{"x": [1, 2]}, {"x": "ü"}]
    assert Journal.header(path) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["j.jsonl"]


@pytest.mark.parametrize("cut", range(1, 20, 3))
def test_a_line_cut_off_is_forgotten_and_written_over(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, {}) as journal:
        journal.append({"step": 1})
        journal.append({"step": 2, "long": "x" * 20})
    path.write_bytes(path.read_bytes()[:-cut])
    with Journal(path, {}) as journal:
        assert journal.records == [{"step": 1}]
        journal.append({"step": 3})
    with Journal(path, {}) as journal:
        assert journal.records == [{"step": 1}, {"step": 3}]


def test_a_header_cut_off_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    path.write_text('{"belongs_')
    with Journal(path, {"a": 1}) as journal:
        assert journal.records == []
    assert Journal.header(path) == {"a": 1}


def test_other_work_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, {"seed": 1, "data": "abc"}):
        pass
    with pytest.raises(InputError, match=r"data changed; to begin anew, give `overwrite=True`"):
        Journal(path, {"seed": 1, "data": "abd"}, anew="give `overwrite=True`")


@pytest.mark.parametrize("line", ["nonsense", "[1]", '{"a": '])
def test_a_damaged_line_is_told_by_number(tmp_path: Path, line: str) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, {}) as journal:
        journal.append({"step": 1})
    path.write_text(path.read_text() + line + '\n{"step": 3}\n')
    with pytest.raises(InputError, match=r"line 3 of .* is damaged"):
        Journal(path, {})


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, {}), pytest.raises(InputError, match="in use by another run"):
        Journal(path, {})
    with Journal(path, {}):
        pass


def test_a_killed_writer_loses_nothing_and_leaves_the_lock_free(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    code = (
        "import sys, itertools\nfrom skygain.ground.journal import Journal\n"
        "with Journal(sys.argv[1], {}) as journal:\n"
        "    for k in itertools.count():\n"
        "        journal.append({'k': k})\n        print(k, flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        seen = [int(child.stdout.readline()) for _ in range(5)]
        child.send_signal(signal.SIGKILL)
        rest = child.stdout.read().split()
    told = max([*seen, *map(int, rest[:-1])])
    with Journal(path, {}) as journal:
        numbers = [record["k"] for record in journal.records]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > told


def test_a_changed_digit_is_told(tmp_path: Path) -> None:
    """A line that is still JSON, but not what was written."""
    path = tmp_path / "j.jsonl"
    with Journal(path, {}) as journal:
        journal.append({"gain_db": [-91.5, 1e-300], "name": "Zürich"})
    assert Journal(path, {}).records == [{"gain_db": [-91.5, 1e-300], "name": "Zürich"}]
    path.write_text(path.read_text().replace("-91.5", "-90.5"))
    with pytest.raises(InputError, match=r"line 2 of .* is damaged"):
        Journal(path, {})
