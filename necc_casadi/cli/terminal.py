"""The shell of every command: grouped help, errors in two lines, exit codes."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from necc_casadi.cli.console import echo, echo_json, fitting, readable_streams
from necc_casadi.errors import InputError, OutputError
from necc_casadi.interrupts import interruptible

__all__ = ["GroupedCommand", "NamedPath", "columns", "grouped", "run", "said_again"]


_UNGROUPED = "Other"


INTERNAL_FAULT, BAD_INPUT, INTERRUPTED = 1, 2, 130


_STOPPED = "interrupted; the output folder is the earlier one or the new one, whole"


_OUR_MISTAKE = "This is our mistake; --debug shows where it happened."


#: Columns of a page of text: as many as the terminal has, within these.
_NARROWEST, _WIDEST = 60, 98


class GroupedOption(click.Option):
    """An option that stands under a heading in --help."""

    def __init__(self, *args: Any, group: str = "Options", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.group = group


def grouped(group: str) -> Callable[..., Callable[..., Any]]:
    """``click.option`` for options under one heading of --help."""

    def option(*names: str, **kwargs: Any) -> Callable[..., Any]:
        return click.option(*names, cls=GroupedOption, group=group, **kwargs)

    return option


class GroupedCommand(click.Command):
    """A command whose --help shows its options under headings, on any console."""

    def get_help(self, ctx: click.Context) -> str:
        """The text of --help in the letters of stdout."""
        return fitting(super().get_help(ctx), sys.stdout)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one section per heading, in the order of the options."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None and isinstance(parameter, click.Option):
                heading = getattr(parameter, "group", _UNGROUPED)
                sections.setdefault(heading, []).append(record)
        for heading, records in sorted(sections.items(), key=lambda item: item[0] == _UNGROUPED):
            with formatter.section(heading):
                formatter.write_dl(records)


@contextlib.contextmanager
def _same_stdout() -> Iterator[None]:
    """Afterwards stdout is what it was: an interrupt may come while a redirection of it ends."""
    stdout = sys.stdout
    try:
        yield
    finally:
        sys.stdout = stdout


def run(command: click.Command, arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; every fault becomes one clear message."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    as_json, debug = "--json" in given, "--debug" in given
    readable_streams()
    try:
        with _same_stdout(), interruptible():
            code = command.main(given, prog_name=command.name, standalone_mode=False)
            sys.stdout.flush()
        return int(code or 0)
    except InputError as problem:
        return _refuse(problem.code, problem.fault, problem.remedy, as_json, debug)
    except click.UsageError as problem:
        name = problem.ctx.command_path if problem.ctx else str(command.name)
        hint = f"See {name} --help."
        return _refuse("usage", problem.format_message(), hint, as_json, debug)
    except (KeyboardInterrupt, click.Abort):
        return _end(INTERRUPTED, "interrupted", [_STOPPED], as_json)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as problem:
        if debug:
            traceback.print_exc()
        fault = f"internal fault: {' '.join(f'{type(problem).__name__}: {problem}'.split())}"
        return _end(INTERNAL_FAULT, "internal", [fault, _OUR_MISTAKE], as_json)


def _end(status: int, code: str, lines: Sequence[str], as_json: bool) -> int:
    """Say what happened: lines on stderr, with --json one object on stdout; the exit code."""
    if as_json:
        message = " ".join(line.strip() for line in lines).removeprefix(f"error [{code}]: ")
        echo_json({"status": "error", "error": {"code": code, "message": message}})
    for line in lines:
        echo(line, err=True)
    return status


def _refuse(code: str, fault: str, remedy: str, as_json: bool, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    return _end(BAD_INPUT, code, (f"error [{code}]: {fault}", f"  {remedy}"), as_json)


class NamedPath(click.Path):
    """A path that is not empty: an empty text would mean the working directory."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(path_type=Path, **kwargs)

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Text to a path.

        Raises
        ------
        OutputError
            When the text is empty.
        """
        if not str(value).strip():
            name = param.opts[-1] if isinstance(param, click.Option) else param.human_readable_name
            raise OutputError("output", f"{name} is empty", "Name a path; . is the working folder.")
        return super().convert(value, param, ctx)


#: Options that say where and how results are shown, not what they are.
_ABOUT_OUTPUT = {"out", "as_json", "every_claim", "debug"}


def said_again(model: Path) -> str:
    """The command at hand with the options that were given, as it makes the same elsewhere."""
    context = click.get_current_context()
    said = [context.command.name or "", model.name]
    for option in context.command.params:
        name = option.name or ""
        source = context.get_parameter_source(name)
        if isinstance(option, click.Option) and name not in _ABOUT_OUTPUT:
            given = source is click.core.ParameterSource.COMMANDLINE
            said += _said(option, context.params[name]) if given else []
    return shlex.join(said)


def _said(option: click.Option, value: Any) -> list[str]:
    if option.is_flag or value is True:
        return [option.opts[-1]] if value else []
    if option.multiple:
        return [word for entry in value for word in (option.opts[-1], str(entry))]
    if not isinstance(value, tuple):
        return [option.opts[-1], f"{value:g}" if isinstance(value, float) else str(value)]
    separator = ":" if option.metavar == "LO:HI:N" else ","
    return [option.opts[-1], separator.join(f"{entry:.15g}" for entry in value)]


def columns() -> int:
    """Columns for a page of text on this terminal; where stdout is none, as many as we like."""
    wide = shutil.get_terminal_size((_WIDEST, 24)).columns
    return max(_NARROWEST, min(_WIDEST, wide))
