"""Options of the commands: their groups, the types of their values, and those that they share."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any, get_args

import click

from necc_casadi.cases import NAME_IN_C
from necc_casadi.cli.terminal import grouped
from necc_casadi.errors import OptionError

__all__ = [
    "Positive",
    "choice",
    "form_option",
    "json_option",
    "last_options",
    "numbers",
    "output_option",
    "read_integral",
    "read_prefix",
    "read_range",
    "region_option",
    "response_option",
    "solver_option",
    "task_option",
    "widths",
]


Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


_WIDEST, _DEEPEST, _MOST_SWEPT = 1024, 8, 1000


def _read_widths(_ctx: click.Context, _option: click.Parameter, text: str | None) -> Any:
    """Widths of hidden layers, ``64,64`` -> (64, 64)."""
    if text is None:
        return None
    try:
        widths = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of widths such as 64,64") from None
    if len(widths) > _DEEPEST or not all(1 <= width <= _WIDEST for width in widths):
        raise click.BadParameter(f"{text!r}: at most {_DEEPEST} layers of 1 to {_WIDEST} neurons")
    return widths


def _read_numbers(_ctx: click.Context, option: click.Parameter, text: str | None) -> Any:
    """Comma-separated constants, read like --target."""
    if text is None:
        return None
    from necc_casadi.symbolic.expressions import parse_number

    label = option.opts[-1]
    return tuple(float(parse_number(part, label, "usage", OptionError)) for part in text.split(","))


def read_prefix(_ctx: click.Context, _option: click.Parameter, text: str) -> str:
    """The beginning of a name in C."""
    if re.fullmatch(NAME_IN_C, text) is None:
        raise click.BadParameter(
            f"{text!r} cannot begin the names of C: use a letter, then letters, digits and _"
        )
    return text


def read_integral(_ctx: click.Context, _option: click.Parameter, text: str | None) -> Any:
    """Whether there is integral action, or its τ in s."""
    if text is None or text == "auto":
        return text is not None
    return Positive().convert(text, _option, _ctx)


def read_range(_ctx: click.Context, _option: click.Parameter, text: str | None) -> Any:
    """LO:HI:N -> (lo, hi, n)."""
    if text is None:
        return None
    try:
        lo, hi, n = text.split(":")
        result = (float(lo), float(hi), int(n))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not LO:HI:N, e.g. 0.1:1.0:10") from None
    if not (0 < result[0] < result[1] < math.inf and 2 <= result[2] <= _MOST_SWEPT):
        raise click.BadParameter(f"{text!r} needs 0 < LO < HI and 2 ≤ N ≤ {_MOST_SWEPT}")
    return result


class Positive(click.FloatRange):
    """A finite number above zero."""

    def __init__(self) -> None:
        super().__init__(min=0, min_open=True)

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Text to a float; nan and inf are no numbers here."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


task_option = grouped("Task")


form_option = grouped("Form of the design")


region_option = grouped("Region of attraction")


response_option = grouped("Response")


solver_option = grouped("Solver and damping")


output_option = grouped("Output")


def choice(kind: Any) -> click.Choice[str]:
    """One of the words of a Literal type."""
    return click.Choice(get_args(kind))


def widths(name: str, text: str) -> Decorator:
    """An option for the widths of hidden layers."""
    return form_option(name, metavar="W,W,…", callback=_read_widths, help=text)


def numbers(option: Callable[..., Decorator], name: str, text: str) -> Decorator:
    """An option for numbers, under a heading of --help."""
    return option(name, metavar="NUMBERS", callback=_read_numbers, help=text)


def json_option(text: str = "One JSON object on stdout.") -> Decorator:
    """``--json``."""
    return output_option("--json", "as_json", is_flag=True, help=text)


def last_options(name: str, debug: str = "Show tracebacks.") -> Decorator:
    """``--debug`` and ``--version``, with which every command ends."""
    version = click.version_option(package_name="necc-casadi", prog_name=name)
    debugging: Decorator = output_option("--debug", is_flag=True, help=debug)
    return lambda command: debugging(version(command))
