"""The check of the documentation finds what it looks for."""

import importlib.util
from pathlib import Path

import pytest

PATH = Path(__file__).parents[2] / "docs" / "check.py"
SPEC = importlib.util.spec_from_file_location("docs_check", PATH)
check = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(check)

GOOD = """
`skygain survey --city 7` and

```
skygain evaluate --data sample \\
    --max-surveys 2      # two
python -m benchmarks few_samples DATA --surveys 3
```

use `skygain.survey.loop.Survey` in `src/skygain/survey/loop.py`.
"""


def test_a_true_page_has_no_problem():
    assert not list(check.wrong_commands(GOOD))
    assert not list(check.wrong_names(GOOD))
    assert not list(check.long_lines(GOOD + "| a table | " + "x" * 120 + " |\n"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("`skygain fly`", "no command fly"),
        ("`skygain survey --cty 7`", "no option --cty"),
        ("```\nskygain evaluate \\\n  --survey 2\n```\n", "no option --survey"),
        ("`python -m benchmarks few_sample DATA`", "no study few_sample"),
        ("`python -m benchmarks few_samples DATA --survey 2`", "no option --survey"),
    ],
)
def test_commands_that_do_not_exist_are_found(text, said):
    (problem,) = check.wrong_commands(text)
    assert said in problem


@pytest.mark.parametrize(
    "name", ["skygain.surveys", "skygain.survey.loop.Flight", "src/skygain/loop.py", "docs/x.md"]
)
def test_names_that_do_not_exist_are_found(name):
    assert list(check.wrong_names(f"see `{name}`")) == [f"there is no {name}"]


def test_links_and_long_lines_are_found(tmp_path):
    page = tmp_path / "page.md"
    assert list(check.wrong_links(page, "[a](b.md), [c](https://d)"))
    assert list(check.long_lines("word " * 30))


def test_every_record_names_a_command_that_exists():
    from benchmarks.evaluations import entries
    from benchmarks.record import Record, names

    assert set(entries()) <= set(names())
    for name in names():
        command = Record.read(name).command
        assert command.startswith("python ")
        assert not list(check.wrong_commands(f"`{command}`"))


def test_every_page_of_a_newcomer_has_commands_that_run():
    for page in check.newcomers():
        text = page.read_text(encoding="utf-8")
        assert check.runnable(page) or "skygain mission" in text or "```python" in text
