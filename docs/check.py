"""Check the documentation: every ``>>>`` example gives what it says, every relative link leads
somewhere, every example script runs."""

from __future__ import annotations

import doctest
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)#\s]+)")


def main() -> int:
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
    failures = 0
    for page in pages:
        text = page.read_text()
        for target in LINK.findall(text):
            if not (page.parent / target).exists():
                print(f"{page.relative_to(ROOT)}: the link {target} leads nowhere")
                failures += 1
        result = doctest.testfile(
            str(page),
            module_relative=False,
            optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE,
        )
        failures += result.failed
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
