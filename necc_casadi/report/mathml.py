"""Expressions as MathML, which a browser typesets without a script and without the network."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

from necc_casadi.symbolic.expressions import complexity, to_text

__all__ = ["column", "formula", "identifier", "matrix", "operator", "row"]


#: Expressions with more operations than this are shown as text: no line of a page holds them.
_MOST_OPERATIONS = 150


def formula(*parts: str) -> str:
    """A formula on a line of its own, which scrolls where it is wider than the page."""
    inner = f'<math display="block"><mrow>{"".join(parts)}</mrow></math>'
    return f'<div class="formula">{inner}</div>'


def operator(sign: str) -> str:
    """``+``, ``=``, ``∇``."""
    return f"<mo>{html.escape(sign)}</mo>"


def identifier(name: str) -> str:
    """A letter, with its index below."""
    return row(sp.Symbol(name))


def row(expr: sp.Expr) -> str:
    """One expression, or its text where it is long."""
    if complexity(expr) > _MOST_OPERATIONS:
        return f"<mtext>{html.escape(to_text(expr))}</mtext>"
    printed: str = MathMLPresentationPrinter({"mul_symbol_mathml_numbers": "&#xB7;"}).doprint(expr)
    printed = printed.replace("&InvisibleTimes;", "&#x2062;").replace("&ExponentialE;", "e")
    printed = printed.replace("<mo>-</mo>", "<mo>−</mo>")
    return re.sub(r"<mn>-([^<]*)</mn>", r"<mrow><mo>−</mo><mn>\1</mn></mrow>", printed)


def matrix(M: sp.MatrixBase) -> str:
    """A matrix in brackets."""
    return _bracketed([[row(entry) for entry in line] for line in M.tolist()])


def column(entries: Sequence[str]) -> str:
    """A column of formulas in brackets."""
    return _bracketed([[entry] for entry in entries])


def _bracketed(lines: Sequence[Sequence[str]]) -> str:
    cells = "".join(
        "<mtr>" + "".join(f"<mtd>{entry}</mtd>" for entry in line) + "</mtr>" for line in lines
    )
    return f'<mtable class="matrix">{cells}</mtable>'  # its frame needs no font with tall brackets
