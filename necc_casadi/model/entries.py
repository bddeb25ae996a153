"""Checks of the entries of a model: shapes, symbols, skewness, definiteness, rank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.symbolic.expressions import FUNCTIONS, exact, is_finite, non_smooth_part
from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.linear_algebra import generic_rank
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.smoothness import without_hidden_zeros
from necc_casadi.symbolic.zero import Undecided, is_zero, sign

__all__ = [
    "Property",
    "PropertyKind",
    "check_states",
    "check_structure",
    "decide_psd",
    "decide_rank",
    "not_psd",
    "scalar_entry",
    "shaped_matrix",
    "shown_point",
    "square_matrix",
]


#: J = −Jᵀ, R = Rᵀ ⪰ 0, or full rank of G.
PropertyKind = Literal["skew", "psd", "rank"]


@dataclass(frozen=True)
class Property:
    """A structural property that must hold for all x, and how it is known."""

    kind: PropertyKind
    matrix: str  # name of the matrix: J, R, G, Jc, Rc or Gc
    proved: bool  # False: it held at sampled points only
    rank: int | None = None  # of G or Gc

    @property
    def name(self) -> str:
        """The property in words, e.g. ``R ⪰ 0``."""
        if self.kind == "skew":
            return f"{self.matrix} = -{self.matrix}ᵀ"
        return f"{self.matrix} ⪰ 0" if self.kind == "psd" else f"rank {self.matrix} = {self.rank}"

    @classmethod
    def named(cls, name: str, proved: bool) -> Property:
        """The property that has this name, as a file gives it; ValueError where there is none."""
        match name.split():
            case ["rank", matrix, "=", rank]:
                return cls("rank", matrix, proved, int(rank))
            case [matrix, "⪰", "0"]:
                return cls("psd", matrix, proved)
            case [matrix, "=", transposed] if transposed == f"-{matrix}ᵀ":
                return cls("skew", matrix, proved)
        raise ValueError(f"{name!r} is no property of a model")


def check_states(symbols: Sequence[sp.Symbol], label: str) -> None:
    """Raise ModelError unless `symbols` are distinct sympy symbols, at least one."""
    if not symbols:
        raise ModelError("shape", f"{label} is empty", f"{label} needs at least one sympy symbol.")
    for i, symbol in enumerate(symbols):
        if not isinstance(symbol, sp.Symbol):
            raise ModelError(
                "shape",
                f"{label}[{i}] = {symbol!s} is not a symbol",
                f'{label} is a tuple of sympy symbols, e.g. x = sp.symbols("q p", real=True).',
            )
        if symbol in symbols[:i]:
            raise ModelError(
                "duplicate_state",
                f"{label}[{i}] = {symbol} stands twice in {label}",
                "Give every state a name of its own.",
            )


def scalar_entry(value: object, label: str, allowed: Sequence[sp.Symbol]) -> sp.Expr:
    """`value` as an exact, real, smooth expression of the symbols in `allowed`.

    Raises
    ------
    ModelError
        ``undefined_symbol, not_real, non_smooth`` or ``singular``, naming `label`.
    """
    try:
        expr = exact(sp.sympify(value))
    except (sp.SympifyError, TypeError, ValueError, AttributeError):
        raise ModelError(
            "shape", f"{label} = {value!r} is not an expression", "Write it with sympy."
        ) from None
    if not isinstance(expr, sp.Expr):
        raise ModelError("shape", f"{label} = {expr} is not a number", "Write a real expression.")
    if not is_finite(expr):
        raise ModelError("singular", f"{label} = {expr} is not finite", "Remove the division by 0.")
    if expr.has(sp.I):
        raise ModelError("not_real", f"{label} = {expr} is complex", "Write a real expression.")
    unknown = sorted(map(str, expr.free_symbols - set(allowed)))
    if unknown:
        raise ModelError(
            "undefined_symbol",
            f"{label} contains {', '.join(unknown)}, not among {', '.join(map(str, allowed))}",
            f"Give it a value in the model: params = {{{unknown[0]}: 1}}.",
        )
    part = non_smooth_part(expr)
    if part is not None:
        raise ModelError(
            "non_smooth",
            f"{label} contains {part}, which is not one of the smooth functions",
            f"Use {', '.join(FUNCTIONS)}, and powers.",
        )
    return without_hidden_zeros(expr)


def shaped_matrix(value: Any, label: str, allowed: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
    """`value` as a matrix of checked entries; vectors become one column."""
    try:
        matrix = sp.Matrix(value) if not isinstance(value, sp.MatrixBase) else value
        rows, columns = matrix.shape
    except (TypeError, ValueError, AttributeError):
        raise ModelError(
            "shape", f"{label} = {value!r} is not a matrix", f"Write {label} = sp.Matrix([...])."
        ) from None
    entries = [
        scalar_entry(matrix[i, j], f"{label}[{i},{j}]", allowed)
        for i in range(rows)
        for j in range(columns)
    ]
    return sp.ImmutableMatrix(rows, columns, entries)


def square_matrix(
    value: object, size: int, label: str, allowed: Sequence[sp.Symbol]
) -> sp.ImmutableMatrix:
    """`value` as a checked size × size matrix."""
    matrix = shaped_matrix(value, label, allowed)
    if matrix.shape != (size, size):
        raise ModelError(
            "shape",
            f"{label} has shape {matrix.rows}×{matrix.cols}, but there are {size} states",
            f"{label} must be {size}×{size}.",
        )
    return matrix


def check_structure(
    J: sp.MatrixBase,
    R: sp.MatrixBase,
    G: sp.MatrixBase,
    suffix: str = "",
    *,
    code_skew: str,
    code_symmetric: str,
    code_psd: str,
    code_rank: str,
) -> tuple[Property, Property, Property]:
    """Decide J = −Jᵀ, R = Rᵀ ⪰ 0 and full rank of G; `suffix` is c for the controller's.

    Raises
    ------
    ModelError
        With the code of the first of them that fails.
    """
    return (
        _decide_skew(J, f"J{suffix}", code_skew),
        decide_psd(R, f"R{suffix}", code_symmetric, code_psd),
        decide_rank(G, f"G{suffix}", code_rank),
    )


def _decide_skew(J: sp.MatrixBase, label: str, code: str) -> Property:
    """Decide J = −Jᵀ entry by entry."""
    proved = True
    for i in range(J.rows):
        for j in range(i + 1):
            total = J[i, j] + J[j, i]
            verdict = is_zero(total)
            if verdict is False:
                raise ModelError(
                    code,
                    f"{label} must be skew-symmetric: {label}[{j},{i}] + {label}[{i},{j}] = "
                    f"{sp.simplify(total)}",
                    f"Set {label}[{i},{j}] = -{label}[{j},{i}]"
                    + (", so zero on the diagonal." if i == j else "."),
                )
            proved = proved and verdict is True
    return Property("skew", label, proved)


def decide_psd(R: sp.MatrixBase, label: str, code_symmetric: str, code_psd: str) -> Property:
    """Decide R = Rᵀ ⪰ 0; what is undecided is sampled once the target is known.

    Raises
    ------
    ModelError
        With the code of the first of the two that fails.
    """
    proved = True
    for i in range(R.rows):
        for j in range(i):
            verdict = is_zero(R[i, j] - R[j, i])
            if verdict is False:
                raise ModelError(
                    code_symmetric,
                    f"{label} must be symmetric: {label}[{j},{i}] = {R[j, i]}, "
                    f"{label}[{i},{j}] = {R[i, j]}",
                    "Make the two entries equal; the skew part belongs into the other matrix.",
                )
            proved = proved and verdict is True
    verdict = is_positive_semidefinite(sp.Matrix(R))
    if verdict is False:
        raise ModelError(code_psd, *not_psd(R, label, {}))
    return Property("psd", label, proved and verdict is True)


def decide_rank(G: sp.MatrixBase, label: str, code: str) -> Property:
    """Decide that G has full rank (min of its sides) at generic points.

    Raises
    ------
    ModelError
        With the given code where it has not.
    """
    full = min(G.shape)
    try:
        rank = generic_rank(sp.Matrix(G))
    except Undecided:
        return Property("rank", label, False, full)
    if rank < full:
        raise ModelError(
            code,
            f"{label} has rank {rank}, but shape {G.rows}×{G.cols}",
            f"{label} needs full rank {full}: remove inputs that act alike.",
        )
    return Property("rank", label, not G.free_symbols, full)


def not_psd(R: sp.MatrixBase, label: str, point: Mapping[sp.Symbol, sp.Expr]) -> tuple[str, str]:
    """Fault and remedy for a matrix that is not ⪰ 0, with a witness entry or direction."""
    where = f" at {shown_point(point)}" if point else ""
    remedy = f"Every quadratic form of {label} must be nonnegative: dissipation takes energy out."
    for i in range(R.rows):
        value = R[i, i].subs(point)
        if not value.free_symbols and sign(value) == -1:
            return (
                f"{label} must be positive semidefinite: {label}[{i},{i}] = "
                f"{to_float(value):.4g}{where}",
                remedy,
            )
    there = sp.Matrix(R.subs(point))
    if there.free_symbols:
        return f"{label} must be positive semidefinite: a diagonal entry is negative", remedy
    _, w = definiteness(there)
    if w is None:
        return f"{label} must be positive semidefinite{where}", remedy
    least = (w.T * there * w)[0] / (w.T * w)[0]
    along = ", ".join(f"{float(sp.N(e)):.4g}" for e in w)
    return (
        f"{label} must be positive semidefinite: wᵀ{label}w/wᵀw = {float(sp.N(least)):.4g} for "
        f"w = ({along}){where}",
        remedy,
    )


def shown_point(point: Mapping[sp.Symbol, sp.Expr]) -> str:
    """A point in words: ``q = 1, p = 0``."""
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in point.items())
