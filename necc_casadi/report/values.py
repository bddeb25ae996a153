"""How values are written on a page of text."""

from __future__ import annotations

import math

import sympy as sp

from necc_casadi.symbolic.floats import to_float

__all__ = ["MANY", "SUB", "TIE", "constant_text", "percent", "rounded_down", "short_text", "tied"]


#: Constants with more letters than this are said in decimals alone.
_LONG_CONSTANT = 24


#: Numbers below this power of ten are written without one.
_PLAIN = 6


#: Columns of the labels inside a block.
SUB = 11


#: A space at which no line is broken.
TIE = "\N{NO-BREAK SPACE}"


#: Lists of more states than this are shortened in the text, never in the JSON.
MANY = 12


def tied(text: str) -> str:
    """A text that is not broken across lines."""
    return text.replace(" ", TIE)


def short_text(value: sp.Expr) -> str:
    """A number exactly, unless that is as long as a float's ratio."""
    exactly = str(sp.sstr(value))
    return exactly if len(exactly) <= _LONG_CONSTANT else f"{to_float(value):.6g}"


def constant_text(value: sp.Expr) -> str:
    """A constant, exact where that is short, and its decimals."""
    exact, decimal = sp.sstr(value), f"{to_float(value):.6g}"
    if value.is_Integer:
        return f"= {exact}"
    return f"= {exact} = {decimal}" if len(exact) <= _LONG_CONSTANT else f"≈ {decimal}"


def percent(share: float, digits: int = 2) -> str:
    """A lower bound of a share, in percent."""
    return f"{rounded_down(100 * share, digits)} %"


def rounded_down(value: float, digits: int = 2) -> str:
    """A lower bound in few digits, rounded down so that it stays one."""
    if not value > 0:
        return "0"
    exponent = math.floor(math.log10(value))
    unit = 10.0 ** (exponent - digits + 1)
    plain = max(digits, exponent + 1) if exponent < _PLAIN else digits  # 100, not 1e+02
    return f"{math.floor(value / unit * (1 + 1e-12)) * unit:.{plain}g}"
