"""The plant ẋ = (J − R)∇H + G u, y = Gᵀ∇H (eq. Plant): structure checks and equilibria."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.errors import ModelError
from necc_casadi.expressions import FUNCTIONS, exact, non_smooth_part

__all__ = ["Plant", "Property", "gradient", "make_plant"]


@dataclass(frozen=True)
class Property:
    """A structural property that must hold for all x, and how it is known."""

    name: str  # e.g. "R ⪰ 0"
    proved: bool  # False: it held at sampled points only


@dataclass(frozen=True, eq=False)
class Plant:
    """A port-Hamiltonian plant, exact and checked (eq. Plant).

    Build one with :func:`make_plant`, which substitutes parameters and checks the structure.
    """

    name: str
    x: tuple[sp.Symbol, ...]  # (n,)
    J: sp.ImmutableMatrix  # n × n, skew-symmetric
    R: sp.ImmutableMatrix  # n × n, symmetric, ⪰ 0
    G: sp.ImmutableMatrix  # n × m, full column rank
    H: sp.Expr  # Hamiltonian, scalar
    units: Mapping[str, str] = field(default_factory=dict)  # name of a state -> unit
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] = field(default_factory=dict)
    u_limits: tuple[tuple[float, float], ...] | None = None  # (m,) pairs
    properties: tuple[Property, ...] = ()

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.x)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.G.cols)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(str(s) for s in self.x)

    @cached_property
    def grad_H(self) -> sp.ImmutableMatrix:
        """∇H, n × 1."""
        return gradient(self.H, self.x)

    @cached_property
    def equilibrium_equations(self) -> tuple[sp.Expr, ...]:
        """G⊥(J − R)∇H, the residuals that no constant input can cancel; zero ones dropped."""
        annihilator = ex.kernel(sp.Matrix(self.G.T)).T
        residual = annihilator * ((self.J - self.R) * self.grad_H)
        # simplify() is slow, and polynomials do not need it
        tidied = (sp.expand(row) if row.is_polynomial() else sp.simplify(row) for row in residual)
        equations = (sp.numer(sp.together(row)) for row in tidied)
        return tuple(row for row in equations if row != 0)

    def holding_input(self, x_star: Mapping[sp.Symbol, sp.Expr]) -> sp.Matrix:
        """The constant input u* with (J − R)∇H + G u* = 0 at an equilibrium, m × 1."""
        G = sp.Matrix(self.G.subs(x_star))
        drift = sp.Matrix(((self.J - self.R) * self.grad_H).subs(x_star))
        return -(G.T * G).LUsolve(G.T * drift)


def gradient(f: sp.Expr, variables: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
    """∇f as a column, len(variables) × 1; a term costs only the variables that it contains."""
    slopes: dict[sp.Symbol, list[sp.Expr]] = {v: [] for v in variables}
    for term in sp.Add.make_args(f):
        for v in term.free_symbols & slopes.keys():
            slopes[v].append(sp.diff(term, v))
    return sp.ImmutableMatrix([sp.Add(*terms) for terms in slopes.values()])


def make_plant(
    x: Sequence[sp.Symbol],
    J: sp.Matrix,
    R: sp.Matrix,
    G: sp.Matrix,
    H: sp.Expr,
    *,
    name: str = "plant",
    units: Mapping[str, str] | None = None,
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] | None = None,
    u_limits: Sequence[tuple[float, float]] | None = None,
) -> Plant:
    """Check the structure of eq. Plant and return the plant; numbers become exact rationals.

    Raises
    ------
    ModelError
        With the code of the first property that fails: ``duplicate_state, shape, h_not_scalar,
        undefined_symbol, not_real, non_smooth, singular, h_constant, j_not_skew, r_not_symmetric,
        r_not_psd, g_rank, limits``.
    """
    x = tuple(x)
    check_states(x, "x")
    n = len(x)
    H = _hamiltonian(H, x)
    J, R = (square_matrix(matrix, n, label, x) for matrix, label in ((J, "J"), (R, "R")))
    G = shaped_matrix(G, "G", x)
    if G.rows != n or G.cols == 0:
        raise ModelError(
            "shape",
            f"G has shape {G.rows}×{G.cols}, but x has {n} states",
            f"G needs {n} rows and one column per input.",
        )
    properties = (
        check_skew(J, "J", "j_not_skew"),
        check_psd(R, "R", "r_not_symmetric", "r_not_psd"),
        check_rank(G, "G", "g_rank"),
    )
    if u_limits is not None and len(u_limits) != G.cols:
        raise ModelError(
            "limits",
            f"u_limits has {len(u_limits)} entries, but G has {G.cols} columns",
            "Give one (lo, hi) pair per input.",
        )
    return Plant(
        name=name,
        x=x,
        J=J,
        R=R,
        G=G,
        H=H,
        units=dict(units or {}),
        domain=dict(domain or {}),
        u_limits=None if u_limits is None else tuple(u_limits),
        properties=properties,
    )


def _hamiltonian(H: sp.Expr, x: tuple[sp.Symbol, ...]) -> sp.Expr:
    remedy = "H must be one scalar expression of the states."
    if isinstance(H, sp.MatrixBase):
        if H.shape != (1, 1):
            raise ModelError("h_not_scalar", f"H is a {H.rows}×{H.cols} matrix", remedy)
        H = H[0, 0]
    if not isinstance(H, (sp.Expr, int, float)) or isinstance(H, bool):
        raise ModelError("h_not_scalar", f"H = {H} is not a scalar expression", remedy)
    H = scalar_entry(H, "H", x)
    if not H.free_symbols:
        raise ModelError(
            "h_constant",
            f"H = {H} depends on no state",
            f"H must be the energy as a function of {', '.join(map(str, x))}.",
        )
    return H


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
    if expr.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
        raise ModelError("singular", f"{label} = {expr} is not finite", "Remove the division by 0.")
    if expr.has(sp.I):
        raise ModelError("not_real", f"{label} = {expr} is complex", "Write a real expression.")
    unknown = sorted(map(str, expr.free_symbols - set(allowed)))
    if unknown:
        raise ModelError(
            "undefined_symbol",
            f"{label} contains {', '.join(unknown)}, not among {', '.join(map(str, allowed))}",
            f"Give it a value: params = {{{unknown[0]}: 1}}, or --param {unknown[0]}=1.",
        )
    part = non_smooth_part(expr)
    if part is not None:
        raise ModelError(
            "non_smooth",
            f"{label} contains {part}, which is not one of the smooth functions",
            f"Use {', '.join(FUNCTIONS)}, and powers.",
        )
    return expr


def shaped_matrix(value: object, label: str, allowed: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
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


def check_skew(J: sp.Matrix, label: str, code: str) -> Property:
    """Decide J = −Jᵀ entry by entry."""
    proved = True
    for i in range(J.rows):
        for j in range(i + 1):
            total = J[i, j] + J[j, i]
            verdict = ex.is_zero(total)
            if verdict is False:
                raise ModelError(
                    code,
                    f"{label} must be skew-symmetric: {label}[{j},{i}] + {label}[{i},{j}] = "
                    f"{sp.simplify(total)}",
                    f"Set {label}[{i},{j}] = -{label}[{j},{i}]"
                    + (", so zero on the diagonal." if i == j else "."),
                )
            proved = proved and verdict is True
    return Property(f"{label} = -{label}ᵀ", proved)


def check_psd(R: sp.Matrix, label: str, code_symmetric: str, code_psd: str) -> Property:
    """Decide R = Rᵀ ⪰ 0; what is undecided is sampled once the target is known."""
    proved = True
    for i in range(R.rows):
        for j in range(i):
            verdict = ex.is_zero(R[i, j] - R[j, i])
            if verdict is False:
                raise ModelError(
                    code_symmetric,
                    f"{label} must be symmetric: {label}[{j},{i}] = {R[j, i]}, "
                    f"{label}[{i},{j}] = {R[i, j]}",
                    "Make the two entries equal; the skew part belongs into the other matrix.",
                )
            proved = proved and verdict is True
    verdict = ex.is_positive_semidefinite(sp.Matrix(R))
    if verdict is False:
        raise ModelError(code_psd, *not_psd(R, label, {}))
    return Property(f"{label} ⪰ 0", proved and verdict is True)


def not_psd(R: sp.Matrix, label: str, point: Mapping[sp.Symbol, sp.Expr]) -> tuple[str, str]:
    """Fault and remedy for a matrix that is not ⪰ 0, with a witness entry or eigenvalue."""
    where = f" at {shown_point(point)}" if point else ""
    remedy = f"Every quadratic form of {label} must be nonnegative: dissipation takes energy out."
    for i in range(R.rows):
        value = R[i, i].subs(point)
        if not value.free_symbols and ex.sign(value) == -1:
            return (
                f"{label} must be positive semidefinite: {label}[{i},{i}] = "
                f"{float(sp.N(value)):.4g}{where}",
                remedy,
            )
    value = sp.Matrix(R.subs(point))
    if value.free_symbols:
        return f"{label} must be positive semidefinite: a diagonal entry is negative", remedy
    lowest = np.linalg.eigvalsh(np.array(value.evalf(), dtype=float))[0]
    return (
        f"{label} must be positive semidefinite: its least eigenvalue is {lowest:.3g}{where}",
        remedy,
    )


def check_rank(G: sp.Matrix, label: str, code: str) -> Property:
    """Decide that G has full rank (min of its sides) at generic points."""
    full = min(G.shape)
    rank = ex.generic_rank(sp.Matrix(G))
    if rank < full:
        raise ModelError(
            code,
            f"{label} has rank {rank}, but shape {G.rows}×{G.cols}",
            f"{label} needs full rank {full}: remove inputs that act alike.",
        )
    return Property(f"rank {label} = {full}", not G.free_symbols)


def shown_point(point: Mapping[sp.Symbol, sp.Expr]) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in point.items())
