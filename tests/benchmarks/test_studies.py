"""The harness of the studies, and some of them at their smallest."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

import benchmarks.__main__  # noqa: E402, F401 - registers the studies
from benchmarks import document_tables, evaluations  # noqa: E402
from benchmarks.record import Record, Table, names, parsed, part  # noqa: E402
from benchmarks.study import STUDIES, Option, Run  # noqa: E402

SAMPLE = str(ROOT / "src/skygain/data/sample.zarr.zip")
SMALLEST = [
    (
        "calibration",
        SAMPLE,
        "--predictor",
        "idw",
        "--split",
        "T4",
        "--surveys",
        "1",
        "--steps",
        "2",
    ),
    ("exhaustion", "--settings", "1"),
    ("few_samples", SAMPLE, "--split", "T4", "--surveys", "1", "--methods", "kriging-blind"),
    (
        "foreign",
        SAMPLE,
        "--split",
        "T4",
        "--worlds",
        "home,buildings missing,gudmundson",
        "--predictors",
        "idw,kriging-blind",
        "--planners",
        "random-waypoint",
        "--surveys",
        "1",
        "--steps",
        "2,4",
    ),
    ("predictors", SAMPLE, "--predictors", "idw,knn", "--split", "T4", "--steps", "2,4"),
    ("value_iteration", "--sizes", "2:4:24"),
    ("certificates", SAMPLE, "--surveys", "1", "--horizons", "10"),
]


@pytest.mark.parametrize("arguments", SMALLEST, ids=lambda a: a[0])
def test_a_study_runs_leaves_a_record_and_does_not_measure_twice(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, *options = arguments
    for _ in range(2):
        STUDIES[name].main([*options, "--results", "."])
    journal = (tmp_path / f"surveys/benchmarks/{name}.jsonl").read_text().splitlines()
    assert len(journal) == len({json.loads(line)[0] for line in journal})
    found = Record.read(name, tmp_path)
    assert found.command.startswith(f"python -m benchmarks {name}")
    assert all(len(row) == len(table.head) for table in found.tables for row in table.rows)
    assert (tmp_path / f"{name}.md").read_text() == found.markdown()


def test_a_journal_cut_off_by_a_kill_keeps_the_whole_lines(tmp_path):
    journal = tmp_path / "study.jsonl"
    run = Run(None, Path("data"), journal)
    run.once(["a"], lambda: 1)
    with journal.open("a") as out:
        out.write('["[\\"data\\", \\"b')
    again = Run(None, Path("data"), journal)
    assert again.once(["a"], lambda: 2) == 1
    assert again.once(["b"], lambda: 3) == 3


def test_options_take_the_type_of_their_default():
    assert Option((1.0,), "").parse("2,3") == (2.0, 3.0)
    assert Option((), "").parse("a,b") == ("a", "b")
    assert Option(3, "").parse("4") == 4


def test_a_table_survives_markdown():
    table = Table("Above it.", ["a", "b"], [["1", "2"], ["", "3"]], "A part")
    record = Record("x", "command", [table])
    assert parsed(record.markdown())[0] == table
    assert part(record, 1, "2", "1").rows == [["2"]]


def test_every_evaluation_is_one_that_the_command_line_takes():
    from skygain.evaluation.request import EvaluateRequest

    for name in evaluations.entries():
        for arguments in evaluations.parts(name).values():
            options = {
                option.removeprefix("--").replace("-", "_"): value
                for option, value in zip(arguments[::2], arguments[1::2], strict=True)
            }
            assert {k for k in options if k != "altitude"} <= set(
                EvaluateRequest.__dataclass_fields__
            )
            methods = tuple(options.get("methods", "").split(",")) if "methods" in options else ()
            request = EvaluateRequest(
                predictors=tuple(options.get("predictors", "").split(",")) if not methods else (),
                planners=tuple(options.get("planners", "").split(",")) if not methods else (),
                methods=methods,
            )
            assert request.pairs


def test_measured_numbers_without_a_request_are_found():
    loose = "| run | RMSE |\n|---|---|\n| a | 1.23 dB |\n| b | 4.5 [4, 5] |\n"
    assert list(document_tables.unmarked(loose)) == ["| run | RMSE |"]
    words = "| name | what |\n|---|---|\n| a | one of 3 maps |\n| b | 12 m wide |\n"
    assert not list(document_tables.unmarked(words))
    assert not list(
        document_tables.unmarked(f"<!-- measured scores x -->\n\n{loose}\n<!-- end -->\n")
    )


def test_a_page_gets_its_table_and_the_command():
    name = names()[0]
    text = f"Before.\n\n<!-- measured table {name} 1 -->\nold\n<!-- end -->\n\nAfter.\n"
    filled = document_tables.filled(text)
    assert Record.read(name).tables[0].lines()[0] in filled
    assert Record.read(name).command in " ".join(filled.split())
    assert document_tables.filled(filled) == filled
