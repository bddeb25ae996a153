"""The values of a model file: exact, of real symbols, with parameters as their values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.symbolic.expressions import exact, parse_number
from necc_casadi.symbolic.zero import sign
from necc_casadi.texts import escaped

__all__ = ["Reader", "inputs_inside", "printable", "real", "source", "stands_inside"]


def inputs_inside(space: Mapping[str, Any]) -> tuple[sp.Symbol, ...]:
    """The symbols that `u` names, where it names some; another u is the file's own affair."""
    value = space.get("u")
    symbols = value if isinstance(value, (tuple, list)) else (value,)
    return tuple(symbols) if all(isinstance(s, sp.Symbol) for s in symbols) else ()


def stands_inside(space: Mapping[str, Any], symbol: sp.Symbol) -> bool:
    """Whether a symbol stands in J or R."""
    matrices = (space.get(name) for name in "JR")
    return any(isinstance(A, sp.MatrixBase) and A.has(symbol) for A in matrices)


def source(space: Mapping[str, Any]) -> Any:
    """The constant source `E`; another E, a modulus or a true matrix, is the file's own affair."""
    value = space.get("E")
    if isinstance(value, (sp.MatrixBase, np.ndarray)):
        return None if min(value.shape, default=0) > 1 else value
    return value if isinstance(value, (list, tuple)) else None


class Reader:
    """The values of a model file: exact, of real symbols, with parameters as their values."""

    def __init__(self, space: Mapping[str, Any], overrides: Mapping[str, str]) -> None:
        self.space = space
        self.states = _symbols(space["x"], "x")
        self.xi = _symbols(space.get("xi", ()), "xi")
        self.inputs = [s for s in inputs_inside(space) if stands_inside(space, s)]
        own = {str(s) for s in self._own}
        self.parameters = _parameters(self.table("params"), own, overrides)
        self._values = {s: self.parameters.get(str(s), real(s)) for s in self._occurring()}

    @property
    def _own(self) -> list[sp.Symbol]:
        return [*self.states, *self.xi, *self.inputs]

    def _occurring(self) -> set[sp.Symbol]:
        """Every symbol that occurs in the file."""
        parts: list[object] = [*self._own, *dict(self.space.get("params", {}))]
        for value in self.space.values():
            parts += value if isinstance(value, (list, tuple)) else [value]
        return {
            symbol
            for part in parts
            if isinstance(part, (sp.Basic, sp.MatrixBase))
            for symbol in part.free_symbols
        }

    def table(self, name: str) -> dict[str, Any]:
        """What the file says by name of a state, an input or a parameter; empty without it."""
        return {str(key): value for key, value in dict(self.space.get(name, {})).items()}

    def read(self, value: Any) -> Any:
        """A number, a matrix or a nested list."""
        if isinstance(value, sp.MatrixBase):
            return value.applyfunc(lambda entry: exact(entry).xreplace(self._values))
        if isinstance(value, (list, tuple, np.ndarray)):
            return [self.read(entry) for entry in value]
        expr = exact(value)
        return expr.xreplace({s: self._values.get(s, real(s)) for s in expr.free_symbols})

    def unvalued(self, name: str) -> Any:
        """An entry of the plant with its parameters as symbols; None where there is none."""
        value = self.space.get(name)
        if value is None:
            return None
        whole = sp.Matrix(value) if isinstance(value, (list, tuple, np.ndarray)) else value
        if isinstance(whole, sp.MatrixBase):
            return whole.applyfunc(_exactly)
        return _exactly(whole)

    def attempt(self, name: str) -> Any:
        """An entry of the plant, if there is one; what cannot be read is named by make_plant."""
        value = self.space.get(name)
        try:
            return self.read(value)
        except (TypeError, ValueError, AttributeError):
            return value


def printable(text: str, label: str) -> str:
    """A text that C comments, XML, plots and terminals can show."""
    if escaped(text) != text:
        raise ModelError(
            "model_file",
            f"{label} = '{escaped(text)}' holds characters that cannot be shown",
            "Write it on one line, with letters, digits and signs.",
        )
    return text


def _symbols(value: Any, label: str) -> list[sp.Symbol]:
    try:
        symbols = [value] if isinstance(value, sp.Symbol) else list(value)
    except TypeError:
        raise ModelError(
            "shape", f"{label} = {value!r} is not a tuple of symbols", f"Write {label} = (q, p)."
        ) from None
    for symbol in symbols:
        printable(str(symbol), f"a name in {label}")
    return symbols


def _exactly(value: Any) -> sp.Expr:
    """An entry with exact numbers, of real symbols."""
    expr = exact(value)
    return expr.xreplace({s: real(s) for s in expr.free_symbols})


def real(symbol: sp.Symbol) -> sp.Symbol:
    """The same symbol, real: models need not say so. What is no symbol is refused later."""
    return sp.Symbol(symbol.name, real=True) if isinstance(symbol, sp.Symbol) else symbol


def _parameters(
    params: Mapping[str, object], states: set[str], overrides: Mapping[str, str]
) -> dict[str, sp.Expr]:
    """Exact values of the parameters, as the file or `overrides` give them."""
    for name in overrides:
        if name not in params:
            known = ", ".join(params) or "none"
            raise ModelError(
                "param",
                f"--param {name}: the model has no parameter {name}",
                f"Its parameters: {known}.",
            )
    values = {}
    for name, value in params.items():
        if name in states:
            raise ModelError(
                "name_clash", f"{name} is a state and a parameter", "Rename one of them."
            )
        if name in overrides:
            value = parse_number(overrides[name], f"--param {name}", "param", ModelError)
        values[name] = _parameter(name, value)
    return values


def _parameter(name: str, value: Any) -> sp.Expr:
    """A parameter's exact value; one that is proved to be zero is 0."""
    try:
        number = exact(sp.sympify(value))
    except (sp.SympifyError, TypeError, ValueError, AttributeError):
        raise ModelError(
            "param",
            f"params[{name}] = {value!r} is not a number",
            f"Give it one: params = {{{name}: 1}}, or --param {name}=1.",
        ) from None
    if not number.is_number or number.is_real is not True:
        raise ModelError(
            "param", f"params[{name}] = {number} is not a real number", "Give it a number."
        )
    return sp.Integer(0) if sign(number) == 0 else number
