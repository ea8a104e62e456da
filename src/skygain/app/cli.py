"""The command line, made from the requests: options, help, completion, errors.

Anything the user can put right ends in one line on standard error and exit code 2; an unexpected
exception is a bug and shows its traceback.
"""

from __future__ import annotations

__all__ = ["command_line", "for_command_line", "main"]

import importlib
import inspect
import re
import sys
from dataclasses import MISSING
from functools import partial
from pathlib import Path
from typing import Any

import click

import skygain
from skygain.app.config import read_config
from skygain.app.requests import COMMANDS
from skygain.app.signals import Terminated
from skygain.ground.declared import Asked, Request
from skygain.ground.errors import InputError, did_you_mean

_GROUPS = {
    "mission": "From a real map to plans for drones, and back with their readings.",
    "benchmark": "A benchmark that methods outside Skygain can join.",
    "dataset": "Build and inspect data sets of ray-traced cities.",
    "train": "Train what the package ships trained.",
}
_METAVARS = {bool: "", int: "N", float: "NUMBER", str: "TEXT", Path: "PATH", dict[str, str]: "K=V"}


def main() -> None:
    """Entry point of the ``skygain`` command."""
    try:
        sys.exit(command_line().main(standalone_mode=False, prog_name="skygain"))
    except (InputError, click.ClickException) as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        print(f"error: {' '.join(text.split())}", file=sys.stderr)
        sys.exit(2)
    except Terminated as ended:
        sys.exit(128 + ended.number)
    except (click.Abort, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def command_line() -> click.Group:
    """The whole command, with one subcommand for each of `COMMANDS`."""
    top = _Group(
        "skygain",
        help="Map a radio transmitter's channel gain over a city with a swarm of UAVs.",
        epilog='Shell completion: eval "$(_SKYGAIN_COMPLETE=bash_source skygain)", or zsh, fish.',
    )
    click.version_option(skygain.__version__, message="skygain %(version)s")(top)
    for words, request in COMMANDS.items():
        *above, name = words.split()
        group = top
        for word in above:
            group = group.commands.setdefault(word, _Group(word, help=_GROUPS[word]))  # type: ignore[assignment]
        group.add_command(_command(name, request))
    return top


def for_command_line(text: str, request: type[Request]) -> str:
    """``text`` with the parameters in backticks written as options of ``request``'s command.

    >>> from skygain.app.requests import SurveyRequest
    >>> for_command_line("give `uavs=1`, or `overwrite=True`", SurveyRequest)
    'give --uavs 1, or --overwrite'
    """
    asked = {one.name: one for one in request.asked()}

    def written(match: re.Match[str]) -> str:
        name, value = match["name"], match["value"]
        if name not in asked:
            return match[0].strip("`")
        one = asked[name]
        if one.argument:
            return name.upper() if value is None else value
        if one.kind is bool:
            return f"--no-{one.flag}" if value == "False" else f"--{one.flag}"
        return f"--{one.flag}" if value is None else f"--{one.flag} {value}"

    return re.sub(r"`(?P<name>\w+)(?:=(?P<value>[^`]*))?`", written, text)


class _Group(click.Group):
    """A group that lists its commands in our order and suggests a name for a misspelt one."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, no_args_is_help=True, **options)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            raise InputError(f"no command {args[0]!r}; {did_you_mean(args[0], self.commands)}")
        return super().resolve_command(ctx, args)


class _Command(click.Command):
    """A command whose help shows the options by group."""

    def __init__(self, name: str, request: type[Request], **options: Any) -> None:
        self.request = request
        super().__init__(name, **options)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        asked = self.request.asked()
        if not any(one.argument for one in asked):
            args = _repeated(args, {f"--{one.flag}" for one in asked if one.several})
        return super().parse_args(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        sections: dict[str, list[tuple[str, str]]] = {"": []}
        for one in self.request.asked():
            flag = one.name.upper() if one.argument else _flag(one)
            sections.setdefault(one.group, []).append((flag, _help(one, self.request)))
        sections["Further"] = [
            ("--config FILE", "TOML, JSON or results.json to start from; options override it"),
            ("--help", "Show this."),
        ]
        for heading, rows in sections.items():
            if rows:
                with formatter.section(heading or "Options"):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if self.epilog:
            with formatter.section("Examples"):
                for line in self.epilog.splitlines():
                    formatter.write(f"  {line.strip()}\n")


def _command(name: str, request: type[Request]) -> click.Command:
    text, _, examples = inspect.cleandoc(request.__doc__ or "").partition("Examples:")
    short = " ".join(text.split())
    return _Command(
        name,
        request,
        callback=partial(_serve, name, request),
        params=[_parameter(one) for one in request.asked()]
        + [click.Option(["--config"], type=click.Path(path_type=Path))],
        help=short,
        short_help=short,
        epilog=examples.strip(),
        context_settings={"max_content_width": 100},
    )


def _serve(label: str, request: type[Request], /, config: Path | None = None, **given: Any) -> None:
    """Make the request, once, and have it served."""
    from skygain.app.progress import shown_progress

    fields = {one.name: one for one in request.asked()}
    try:
        values = read_config(request, config) if config else {}
        for key, value in given.items():
            if value is not None and value != ():
                values[key] = _scaled(value, fields[key])
        asked = request.of(values)
        module, _, function = request.runs.partition(":")
        run = getattr(importlib.import_module(module), function)
        with shown_progress(label, lambda text: for_command_line(text, request)) as tell:
            told = run(asked, tell)
    except InputError as error:
        raise InputError(for_command_line(str(error), request)) from error
    if told:
        print(for_command_line(told, request))


def _parameter(one: Asked) -> click.Parameter:
    """Values stay texts here: the request reads them, as it reads those of a file."""
    if one.argument:
        many = -1 if one.several else 1
        return click.Argument([one.name], required=one.default is MISSING, nargs=many)
    flag = f"--{one.flag}"
    if one.kind is bool:
        return click.Option([one.name, f"{flag}/--no-{one.flag}"], default=None)
    return click.Option(
        [one.name, flag],
        type=str,
        default=None,
        multiple=one.several,
        shell_complete=partial(_completed, one.names) if one.names else None,
    )


def _repeated(args: list[str], flags: set[str]) -> list[str]:
    """``--data a b`` as ``--data a --data b``, for the options of any number of files.

    >>> _repeated(["--data", "a", "b", "--out", "c"], {"--data"})
    ['--data', 'a', '--data', 'b', '--out', 'c']
    """
    found: list[str] = []
    flag = ""
    for word, before in zip(args, ["", *args], strict=False):
        if word.startswith("-"):
            flag = word if word in flags else ""
        elif flag and before != flag:
            found.append(flag)
        found.append(word)
    return found


def _scaled(value: Any, one: Asked) -> Any:
    if one.scale == 1.0:
        return value
    try:
        return float(value) * one.scale
    except ValueError:
        raise InputError(f"`{one.name}` must be a number, got {value!r}") from None


def _completed(registry: str, ctx: Any, param: Any, incomplete: str) -> list[str]:
    module, _, attribute = registry.partition(":")
    names = getattr(importlib.import_module(module), attribute).names()
    before, comma, last = incomplete.rpartition(",")
    return [f"{before}{comma}{name}" for name in names if name.startswith(last)]


def _flag(one: Asked) -> str:
    if one.kind is bool:
        return f"--{one.flag}" + (f"/--no-{one.flag}" if one.default is True else "")
    metavar = _METAVARS.get(one.kind, "PATH" if one.several else "A,B,…")
    return f"--{one.flag} {metavar}".rstrip()


def _help(one: Asked, request: type[Request]) -> str:
    text = for_command_line(one.text.replace("``", ""), request)
    if one.default is MISSING:
        return f"{text}  [required]"
    if one.kind is bool or one.default in (None, (), {}):
        return text
    default = one.default / one.scale if one.scale != 1.0 else one.default
    parts = default if isinstance(default, tuple) else (default,)
    shown = ",".join(f"{part:g}" if isinstance(part, float) else str(part) for part in parts)
    return f"{text}  [{shown}]"
