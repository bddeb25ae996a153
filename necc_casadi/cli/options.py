"""Options of the commands: their groups and the types of their values."""

from __future__ import annotations

import math
from typing import Any

import click

from necc_casadi.cli.terminal import grouped
from necc_casadi.errors import OptionError

__all__ = [
    "Positive",
    "form_option",
    "output_option",
    "read_numbers",
    "read_range",
    "read_widths",
    "region_option",
    "solver_option",
    "task_option",
]


_WIDEST, _DEEPEST, _MOST_SWEPT = 1024, 8, 1000


def read_widths(_ctx: click.Context, _option: click.Parameter, text: str | None) -> Any:
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


def read_numbers(_ctx: click.Context, option: click.Parameter, text: str | None) -> Any:
    """Comma-separated constants, read like --target."""
    if text is None:
        return None
    from necc_casadi.symbolic.expressions import parse_number

    label = option.opts[-1]
    return tuple(float(parse_number(part, label, "usage", OptionError)) for part in text.split(","))


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


solver_option = grouped("Solver and damping")


output_option = grouped("Output")
