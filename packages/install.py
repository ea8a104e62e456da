"""Installs the packages of this checkout for the Python that runs it.

    .venv/bin/python packages/install.py CONSTRAINTS

uv fetches and unpacks side by side what pip takes one by one. Where pip cannot have it, or it ends
in an error, pip does all. uv is told what pip is configured with: indexes, folders of wheels,
certificates.
"""

from __future__ import annotations

__all__ = ["main", "pip_settings", "uv_options"]

import ast
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[1]
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
INSTALL = (*PIP, "install", "--quiet", "--no-compile")
PACKAGES = ("--editable", ".", "--editable", "packages/paper-weights")
OPTIONS = {
    "index-url": "--default-index",
    "extra-index-url": "--index",
    "find-links": "--find-links",
    "constraint": "--constraint",
    "trusted-host": "--allow-insecure-host",
}
SWITCHES = {"no-index": "--no-index", "no-cache-dir": "--no-cache"}
VARIABLES = {"cert": "SSL_CERT_FILE", "proxy": "ALL_PROXY"}
IRRELEVANT = {"default-timeout", "timeout", "retries", "disable-pip-version-check", "quiet"}
IRRELEVANT |= {"cache-dir", "progress-bar", "compile", "no-compile", "no-color", "config-file"}
IRRELEVANT |= {"no-input", "require-virtualenv", "log", "verbose", "no-python-version-warning"}
"""settings of pip that change nothing in what is installed"""


def main(constraints: str) -> None:
    """Install, with uv or else with pip."""
    os.chdir(ROOT)
    wanted = ("--constraint", constraints, *PACKAGES)
    if not _with_uv(constraints, wanted):
        print("uv cannot be had or used here: pip installs, which takes longer", file=sys.stderr)
        sys.exit(subprocess.run([*INSTALL, *wanted], check=False).returncode)


def _with_uv(constraints: str, wanted: tuple[str, ...]) -> bool:
    """Whether uv could be fetched and did it all."""
    fetch = [*INSTALL, "--constraint", constraints, "uv"]
    if subprocess.run(fetch, capture_output=True, check=False).returncode:
        return False
    listed = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=False)
    told = uv_options(pip_settings(listed.stdout))
    if told is None:
        return False
    options, variables = told
    uv = Path(sysconfig.get_path("scripts")) / "uv"
    command = [uv, "pip", "install", "--python", sys.executable, *options, *wanted]
    return not subprocess.run(command, check=False, env=variables | os.environ).returncode


def pip_settings(listed: str) -> dict[str, list[str]]:
    """The settings in ``pip config list``, by name.

    >>> pip_settings("global.index-url='https://a/simple'\\n:env:.find-links='/b /c'")
    {'index-url': ['https://a/simple'], 'find-links': ['/b', '/c']}
    """
    found: dict[str, list[str]] = {}
    for line in listed.splitlines():
        key, _, value = line.partition("=")
        if key.startswith((":env:.", "global.", "install.")):
            values = found.setdefault(key.rpartition(".")[2], [])
            values.extend(ast.literal_eval(value).split())
    return found


def uv_options(settings: dict[str, list[str]]) -> tuple[list[str], dict[str, str]] | None:
    """What uv has to be told: options and environment variables; ``None`` if it cannot be.

    >>> uv_options({"find-links": ["/b"], "cert": ["/c.pem"]})
    (['--index-strategy', 'unsafe-best-match', '--find-links', '/b'], {'SSL_CERT_FILE': '/c.pem'})
    """
    options = ["--index-strategy", "unsafe-best-match"]  # as pip: all indexes count alike
    variables = {}
    for name, values in settings.items():
        if name in OPTIONS:
            for value in values:
                options += [OPTIONS[name], value]
        elif name in SWITCHES:
            options += [SWITCHES[name]] * (values[-1].lower() in ("1", "true", "yes", "on"))
        elif name in VARIABLES:
            variables[VARIABLES[name]] = values[-1]
        elif name not in IRRELEVANT:
            return None
    return options, variables


if __name__ == "__main__":
    main(*sys.argv[1:])
