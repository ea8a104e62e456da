"""Remedies that fit how Skygain was installed."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygain.ground import errors
from skygain.ground.errors import install_command


def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, released: bool) -> Path:
    """A place that the code seems to run from."""
    module = tmp_path / "src" / "skygain" / "ground" / "errors.py"
    monkeypatch.setattr(errors, "__file__", str(module))
    monkeypatch.setattr(
        errors.sysconfig, "get_path", lambda name: str(tmp_path.resolve() / ".venv" / "bin")
    )
    if not released:
        (tmp_path / "pyproject.toml").touch()
    return tmp_path


def test_a_released_package_is_installed_by_its_name(tmp_path, monkeypatch):
    checkout(tmp_path, monkeypatch, released=True)
    assert install_command("geo") == "pip install 'skygain[geo]'"
    assert install_command("paper") == "pip install 'skygain[paper]'"
    assert install_command() == "pip install skygain"


def test_a_checkout_is_installed_from_where_it_lies(tmp_path, monkeypatch):
    root = checkout(tmp_path, monkeypatch, released=False).resolve()
    monkeypatch.chdir(root)
    assert install_command("geo") == ".venv/bin/pip install -e '.[geo]'"
    assert install_command("paper") == ".venv/bin/pip install -e packages/paper-weights"
    monkeypatch.chdir("/")
    assert install_command("geo") == f"{root}/.venv/bin/pip install -e '{root}[geo]'"
