"""What a console shows: readable in whatever letters it has, harmless whatever a text holds."""

from __future__ import annotations

import codecs
import contextlib
import io
import sys
import threading
from collections.abc import Iterator
from typing import Any, TextIO

import click

from necc_casadi.files import to_json_text
from necc_casadi.texts import escaped, to_ascii

__all__ = ["Progress", "echo", "echo_json", "fitting", "readable_streams"]


_READABLE = "necc_readable"


#: Seconds that a stage lasts before a line on a pipe names it: quick runs stay quiet.
_QUIET = 5.0


def _in_ascii(problem: UnicodeError) -> tuple[str, int]:
    """The letters that a console lacks, as ξ -> xi."""
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    return to_ascii(problem.object[problem.start : problem.end]), problem.end


codecs.register_error(_READABLE, _in_ascii)


def readable_streams() -> None:
    """Let stdout and stderr take every letter, those of a model file's own prints too."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_READABLE)


def fitting(text: str, stream: TextIO) -> str:
    """`text` in the letters of a stream, with everything that a terminal could obey escaped."""
    shown = "\n".join(escaped(line) for line in text.split("\n"))
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return shown.encode(encoding, _READABLE).decode(encoding)


def echo(text: str, *, err: bool = False) -> None:
    """Print lines on stdout or stderr."""
    click.echo(fitting(text, sys.stderr if err else sys.stdout), err=err)


def echo_json(value: Any) -> None:
    """Print one JSON object on stdout, in ASCII: no console and no pipe spoils it."""
    click.echo(to_json_text(value, ascii_only=True))


class Progress:
    """The step at hand on stderr: a spinner on a terminal, a line per long stage on a pipe."""

    def __init__(self) -> None:
        self._status: Any = None
        self._text = self._stage = ""
        self._timer: threading.Timer | None = None

    @contextlib.contextmanager
    def shown(self) -> Iterator[Progress]:
        """Show it while the block runs."""
        try:
            with self._spinner():
                yield self
        finally:
            self._stop()
            self._status = None

    @contextlib.contextmanager
    def _spinner(self) -> Iterator[None]:
        if not sys.stderr.isatty():
            yield
            return
        from rich.console import Console

        spinner = "dots" if fitting("⠋", sys.stderr) == "⠋" else "line"
        with Console(stderr=True).status("starting", spinner=spinner) as self._status:
            yield

    def say(self, text: str) -> None:
        """Name the step at hand: a stage, or a stage with a colon and a step of it."""
        self._text = text
        if self._status is not None:
            self._status.update(fitting(text, sys.stderr))
            return
        stage = text.partition(":")[0]
        if stage != self._stage:
            self._stop()
            self._stage = stage
            self._timer = threading.Timer(_QUIET, self._tell)
            self._timer.daemon = True
            self._timer.start()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _tell(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # nobody listens any more
            echo(f"{self._text} ...", err=True)
