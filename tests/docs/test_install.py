"""What `make demo` installs with: pip's settings reach uv, or pip keeps the work."""

from __future__ import annotations

import doctest
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SPEC = importlib.util.spec_from_file_location("install", ROOT / "packages" / "install.py")
install = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(install)


def test_examples() -> None:
    found = doctest.testmod(install)
    assert found.attempted >= 2
    assert not found.failed


@pytest.mark.parametrize("name", ["constraints.txt", "constraints-newest.txt"])
def test_the_installer_is_pinned_too(name: str) -> None:
    assert any(line.startswith("uv==") for line in (ROOT / name).read_text().splitlines())


def test_what_pip_is_configured_with_is_read(tmp_path: Path) -> None:
    config = tmp_path / "pip.conf"
    config.write_text("[global]\nextra-index-url = https://a/simple\n  https://b/simple\n")
    listed = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        env={"PIP_CONFIG_FILE": str(config), "PIP_NO_INDEX": "1", "PATH": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    settings = install.pip_settings(listed.stdout)
    assert settings["extra-index-url"][-2:] == ["https://a/simple", "https://b/simple"]
    options, _ = install.uv_options(settings)
    assert "--no-index" in options
    assert options[options.index("https://b/simple") - 1] == "--index"


def test_a_setting_that_uv_does_not_know_leaves_the_work_to_pip() -> None:
    assert install.uv_options({"index-url": ["https://a"], "prefix": ["/opt"]}) is None
