"""Mechanical plants by coordinates, inertia, potential, inputs and friction: Mq̈ + … + Fq̇ = Bu.

x = (q, p),  p = M(q)q̇,  H = ½pᵀM⁻¹(q)p + V(q),  J = [0, I; −I, 0],  R = [0, 0; 0, F],  G = [0; B]

References
----------
van der Schaft (2017), chapter 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.entries import (
    check_states,
    decide_psd,
    decide_rank,
    not_psd,
    scalar_entry,
    shaped_matrix,
)
from necc_casadi.symbolic.linear_algebra import generic_rank, tidy
from necc_casadi.symbolic.semidefinite import blocks, is_positive_semidefinite
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = ["MECHANICAL", "Mechanical", "is_mechanical", "phase_space"]


#: What a mechanical plant gives in place of x, J, R, G and H.
MECHANICAL = ("q", "M", "V", "B")


def is_mechanical(space: Mapping[str, Any]) -> bool:
    """Whether a file gives a plant by q, M, V and B; beside another form they are its own."""
    others = {"J", "H"} & set(space) or {"x", "f", "G"} <= set(space)
    return set(MECHANICAL) <= set(space) and not others


def phase_space(q: Any) -> tuple[sp.Symbol, ...]:
    """The states (q, p) of coordinates; momenta are named ``p_<coordinate>``.

    Raises
    ------
    ModelError
        ``shape`` or ``duplicate_state``.
    """
    try:
        coordinates = (q,) if isinstance(q, sp.Symbol) else tuple(q)
    except TypeError:
        raise ModelError(
            "shape", f"q = {q!r} is not a tuple of symbols", "Write q = (q1, q2)."
        ) from None
    check_states(coordinates, "q")
    return (*coordinates, *(sp.Symbol(f"p_{name}", real=True) for name in coordinates))


@dataclass(frozen=True, eq=False)
class Mechanical:
    """A mechanical plant as a file gives it, of k coordinates and m inputs."""

    x: tuple[sp.Symbol, ...]  # (2k,), coordinates and then their momenta
    M: sp.MatrixBase  # inertia, k × k, symmetric, ≻ 0
    V: sp.Expr  # potential
    B: sp.MatrixBase  # k × m
    friction: sp.MatrixBase  # k × k, symmetric, ⪰ 0

    @classmethod
    def of(cls, x: Sequence[sp.Symbol], M: Any, V: Any, B: Any, friction: Any) -> Mechanical:
        """The same of numbers, nested lists or matrices; no friction where it is None.

        Raises
        ------
        ModelError
            ``shape`` or ``h_not_scalar`` and, for entries, as ``scalar_entry``.
        """
        k = len(x) // 2
        q = tuple(x[:k])
        damping = sp.zeros(k, k) if friction is None else friction
        return cls(
            x=tuple(x),
            M=_sized(M, "M", q, k, k),
            V=_potential(V, q),
            B=_sized(B, "B", q, k),
            friction=_sized(damping, "friction", x, k, k),
        )

    @classmethod
    def formal(cls, x: Sequence[sp.Symbol], M: Any, V: Any, B: Any, friction: Any) -> Mechanical:
        """The same with parameters as symbols; it was checked with their values."""
        k = len(x) // 2
        damping = sp.zeros(k, k) if friction is None else _whole(friction)
        return cls(tuple(x), _whole(M), _whole(V)[0, 0], _whole(B), damping)

    def check(self) -> None:
        """Refuse what no mechanical plant has.

        Raises
        ------
        ModelError
            ``model_file`` or ``singular`` for M, ``r_not_symmetric`` or ``r_not_psd`` for friction,
            ``g_rank`` for B.
        """
        _check_inertia(sp.Matrix(self.M))
        decide_psd(self.friction, "friction", "r_not_symmetric", "r_not_psd")
        decide_rank(self.B, "B", "g_rank")

    @property
    def structure(self) -> tuple[sp.Matrix, sp.Matrix, sp.Matrix, sp.Expr]:
        """J, R, G and H of x."""
        k = len(self.x) // 2
        J, zero = sp.zeros(2 * k), sp.zeros(k)
        J[:k, k:], J[k:, :k] = sp.eye(k), -sp.eye(k)
        R = sp.diag(zero, sp.Matrix(self.friction))
        G = sp.Matrix.vstack(sp.zeros(k, self.B.cols), sp.Matrix(self.B))
        return J, R, G, _kinetic(sp.Matrix(self.M), self.x[k:]) + self.V


def _kinetic(M: sp.Matrix, p: Sequence[sp.Symbol]) -> sp.Expr:
    """½pᵀM⁻¹p with one fraction for each block of M: shorter than the entries of M⁻¹."""
    energy: sp.Expr = sp.Integer(0)
    for block in blocks(M):
        inertia = M.extract(block, block)
        cofactors = inertia.adjugate().applyfunc(tidy)
        form = sum(
            (
                cofactors[i, j] * p[block[i]] * p[block[j]] * (1 if i == j else 2)
                for i in range(len(block))
                for j in range(i, len(block))
            ),
            sp.Integer(0),
        )
        energy += sp.factor_terms(form) / (2 * tidy(inertia.det()))
    return energy


def _whole(value: Any) -> sp.MatrixBase:
    """A matrix as it is; a number as a matrix of one entry."""
    return value if isinstance(value, sp.MatrixBase) else sp.Matrix([[value]])


def _sized(
    value: Any, label: str, allowed: Sequence[sp.Symbol], rows: int, columns: int | None = None
) -> sp.ImmutableMatrix:
    """A matrix of as many rows as there are coordinates; a number for a single one."""
    single = isinstance(value, (sp.Expr, int, float)) and not isinstance(value, bool)
    matrix = shaped_matrix(_whole(value) if single else value, label, allowed)
    if matrix.rows == rows and matrix.cols == (columns or matrix.cols) > 0:
        return matrix
    raise ModelError(
        "shape",
        f"{label} has shape {matrix.rows}×{matrix.cols}, but q has {rows} coordinates",
        f"{label} must be {rows}×{columns}."
        if columns
        else f"{label} needs {rows} rows and one column per input.",
    )


def _potential(V: Any, q: Sequence[sp.Symbol]) -> sp.Expr:
    inner = V[0, 0] if isinstance(V, sp.MatrixBase) and V.shape == (1, 1) else V
    if not isinstance(inner, (sp.Expr, int, float)) or isinstance(inner, bool):
        shape = f"a {V.rows}×{V.cols} matrix" if isinstance(V, sp.MatrixBase) else "no scalar"
        shown = "V" if isinstance(V, sp.MatrixBase) else f"V = {V}"
        raise ModelError(
            "h_not_scalar",
            f"{shown} is {shape}",
            "V must be one scalar expression of the coordinates.",
        )
    return scalar_entry(inner, "V", q)


def _check_inertia(M: sp.Matrix) -> None:
    for i in range(M.rows):
        for j in range(i):
            if is_zero(M[i, j] - M[j, i]) is False:
                raise ModelError(
                    "model_file",
                    f"M must be symmetric: M[{j},{i}] = {M[j, i]}, M[{i},{j}] = {M[i, j]}",
                    "Make the two entries equal.",
                )
    if is_positive_semidefinite(M) is False:
        fault = not_psd(M, "M", {})[0].replace("semidefinite", "definite")
        raise ModelError("model_file", fault, "Kinetic energy is positive for every velocity.")
    try:
        rank = generic_rank(M)
    except Undecided:
        return
    if rank < M.rows:
        raise ModelError(
            "singular",
            f"M has rank {rank}, but shape {M.rows}×{M.cols}: it has no inverse",
            "Give every coordinate an inertia of its own, or leave it out.",
        )
