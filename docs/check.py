"""Check the documentation.

    python docs/check.py [--run]

With ``--run`` the commands of README, tutorial and task pages are run too, where their files ship.

Every ``>>>`` example gives what it says, every relative link leads somewhere, every command is one
that the command line takes, every module and file that is named exists, lines of text end at column
100, and every example script runs.
"""

from __future__ import annotations

import doctest
import importlib
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)#\s]+)")
FENCE = re.compile(r"^ *```\w*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`]+)`")
MODULE = re.compile(r"\bskygain(?:\.[A-Za-z_]\w*)+")
PATH = re.compile(r"(?<![\w./-])(?:src/skygain|benchmarks|docs|tests|examples)/[\w./-]*\w")
COLUMNS = 100
BUILT = "cities.zarr.zip"
"""what the pages call a data set that takes long to build"""


def code(text: str) -> Iterator[str]:
    """Lines of code blocks, with continued ones joined, and what stands between backticks."""
    for block in FENCE.findall(text):
        yield from block.replace("\\\n", " ").splitlines()
    yield from (" ".join(span.split()) for span in SPAN.findall(FENCE.sub("", text)))


def wrong_links(page: Path, text: str) -> Iterator[str]:
    """Relative links that lead nowhere."""
    for target in LINK.findall(text):
        if not (page.parent / target).exists():
            yield f"the link {target} leads nowhere"


def wrong_commands(text: str) -> Iterator[str]:
    """Commands with a name or an option that the command line does not have."""
    for line in code(text):
        try:
            words = shlex.split(line, comments=True)
        except ValueError:
            continue
        if words[:1] and words[0].removeprefix(".venv/bin/") == "skygain":
            yield from (f"`{line}`: {problem}" for problem in _skygain(words[1:]))
        elif words[:3] == ["python", "-m", "benchmarks"] and len(words) > 3:
            yield from (f"`{line}`: {problem}" for problem in _benchmark(words[3], words[4:]))


def _skygain(words: list[str]) -> Iterator[str]:
    command, path = _command_line(), "skygain"
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        name, *words = words
        found = command.get_command(None, name)
        if found is None:
            if not re.fullmatch(r"[A-Z…].*|\.\.\.", name):  # a placeholder
                yield f"{path} has no command {name}"
            return
        command, path = found, f"{path} {name}"
    known = {flag for p in command.params for flag in (*p.opts, *p.secondary_opts)} | {"--help"}
    for word in words:
        option = word.partition("=")[0]
        if option.startswith("--") and option not in known:
            yield f"{path} has no option {option}"


def _benchmark(name: str, words: list[str]) -> Iterator[str]:
    studies = _studies()
    if name == "NAME":
        return
    if name not in studies:
        yield f"there is no study {name}"
        return
    known = {flag for action in studies[name].parser()._actions for flag in action.option_strings}
    for word in words:
        if word.startswith("--") and word not in known:
            yield f"the study {name} has no option {word}"


@cache
def _command_line() -> Any:
    from skygain.app.cli import command_line

    return command_line()


@cache
def _studies() -> dict[str, Any]:
    import benchmarks.__main__  # noqa: F401 - registers them
    from benchmarks.study import STUDIES

    return STUDIES


def wrong_names(text: str) -> Iterator[str]:
    """Modules and their members, files and folders that are named but do not exist."""
    for name in sorted(set(MODULE.findall("\n".join(code(text))))):
        if not _importable(name):
            yield f"there is no {name}"
    for name in sorted(set(PATH.findall(text))):
        if not (ROOT / name).exists():
            yield f"there is no {name}"


@cache
def _importable(name: str) -> bool:
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError as error:
            if error.name and not error.name.startswith("skygain"):
                return True  # an optional package is missing, not the module
            continue
        for part in parts[k:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


def long_lines(text: str) -> Iterator[str]:
    """Lines of text that end beyond column 100; tables, code, pictures and requests may."""
    for line in FENCE.sub("", re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)).splitlines():
        free = line.startswith(("|", "    ", "![")) or len(line.split()) == 1
        if len(line) > COLUMNS and not free:
            yield f"a line of {len(line)} columns: {line[:50]}…"


def page_problems(page: Path) -> Iterator[str]:
    """Everything that is wrong with the text of a page."""
    text = page.read_text(encoding="utf-8")
    yield from wrong_links(page, text)
    if page.name != "CHANGELOG.md":
        yield from wrong_commands(text)
        yield from wrong_names(text)
        yield from long_lines(text)


def wrong_examples(page: Path) -> int:
    """How many ``>>>`` examples give something else than they say. What they write goes away."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "examples").symlink_to(ROOT / "examples")
        os.chdir(folder)
        try:
            return doctest.testfile(
                str(page),
                module_relative=False,
                optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE,
            ).failed
        finally:
            os.chdir(here)


def runnable(page: Path) -> list[list[str]]:
    """The ``skygain`` commands in the code blocks of a page that can be run as they stand."""
    found = []
    for block in FENCE.findall(page.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            if line.strip().startswith(("skygain ", ".venv/bin/skygain ")):
                words = shlex.split(line, comments=True)[1:]
                # a mission needs a crew, a score a participant; figures and presets take long
                long = words[:3] == ["dataset", "build", "--preset"] or BUILT in words
                alone = words[0] in ("mission", "reproduce") or words[:2] == ["benchmark", "score"]
                if not (long or alone or "--cluster" in words):
                    found.append(words)
    return found


def write_module(page: Path, folder: Path) -> None:
    """The code of a page as ``mymodule.py``, as the page says."""
    code = doctest.script_from_examples(page.read_text(encoding="utf-8"))
    (folder / "mymodule.py").write_text(code, encoding="utf-8")


def failed_commands(page: Path) -> Iterator[str]:
    """Commands that end in an error, run one after the other in a folder with the examples."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "examples").symlink_to(ROOT / "examples")
        write_module(page, Path(folder))
        for words in runnable(page):
            run = [sys.executable, "-m", "skygain", *words]
            done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=False)
            print(f"skygain {shlex.join(words)}: {done.returncode}", flush=True)
            if done.returncode:
                yield f"`skygain {shlex.join(words)}`: {done.stderr.strip().splitlines()[-1]}"


def newcomers() -> list[Path]:
    """The pages that a newcomer types from."""
    docs = ROOT / "docs"
    return [ROOT / "README.md", docs / "tutorial.md", *sorted((docs / "how-to").glob("*.md"))]


def source_problems(module: Path) -> Iterator[str]:
    """Files that a module speaks of and that do not exist."""
    for name in sorted(set(PATH.findall(module.read_text(encoding="utf-8")))):
        if name.endswith((".md", ".py", ".toml")) and not (ROOT / name).exists():
            yield f"there is no {name}"


def main() -> int:
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
    failures = 0
    for page in pages:
        for problem in page_problems(page):
            print(f"{page.relative_to(ROOT)}: {problem}")
            failures += 1
        failures += wrong_examples(page)
    if "--run" in sys.argv[1:]:
        for page in newcomers():
            for problem in failed_commands(page):
                print(f"{page.relative_to(ROOT)}: {problem}")
                failures += 1
    for module in sorted((ROOT / "src").rglob("*.py")):
        for problem in source_problems(module):
            print(f"{module.relative_to(ROOT)}: {problem}")
            failures += 1
    for script in sorted((ROOT / "examples").glob("[0-9]*.py")):
        with tempfile.TemporaryDirectory() as folder:
            run = subprocess.run(
                [sys.executable, str(script)],
                cwd=folder,
                env={**os.environ, "MPLBACKEND": "Agg"},
                check=False,
            )
        failures += run.returncode != 0
        print(f"{script.relative_to(ROOT)}: {'failed' if run.returncode else 'ran'}")
    print(f"{len(pages)} pages checked, {failures} failed")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
