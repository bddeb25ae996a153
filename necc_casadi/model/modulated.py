"""Plants whose inputs stand in J or R, or that a constant source drives: converters, motors.

    ẋ = (J(x, u) − R(x, u))∇H + G u + E,   affine in u

At a constant input u* this is ẋ = F∇H + g(x)(u − u*) + E + G u*, with F = J(x, u*) − R(x, u*) and
g = ∂ẋ/∂u.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.control_affine import ControlAffine, Equilibria
from necc_casadi.model.entries import check_states, scalar_entry, shaped_matrix, square_matrix
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.linear_algebra import generic_rank, tidy
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = ["Modulated", "System", "make_control_affine", "make_modulated"]


@dataclass(frozen=True, eq=False)
class Modulated(Equilibria):
    """A port-Hamiltonian plant with inputs u in its structure, and constant sources."""

    name: str
    x: tuple[sp.Symbol, ...]  # (n,)
    u: tuple[sp.Symbol, ...]  # (m,)
    J: sp.ImmutableMatrix  # n × n, of x and u
    R: sp.ImmutableMatrix  # n × n, of x and u
    G: sp.ImmutableMatrix  # n × m, of x
    E: sp.ImmutableMatrix  # n × 1, constant
    H: sp.Expr
    units: Mapping[str, str] = field(default_factory=dict)
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] = field(default_factory=dict)
    u_limits: tuple[tuple[float, float], ...] | None = None
    sizes: Mapping[str, sp.Expr] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()

    @cached_property
    def motion(self) -> sp.ImmutableMatrix:
        """ẋ of x and u, n × 1."""
        inner = (self.J - self.R) * gradient(self.H, self.x)
        return sp.ImmutableMatrix(inner + self.G * sp.Matrix(self.u) + self.E)

    @cached_property
    def drift(self) -> sp.ImmutableMatrix:
        """f: ẋ without inputs, n × 1."""
        return sp.ImmutableMatrix(self.motion.subs(dict.fromkeys(self.u, 0)).applyfunc(tidy))

    @cached_property
    def directions(self) -> sp.ImmutableMatrix:
        """G = ∂ẋ/∂u, n × m."""
        return sp.ImmutableMatrix(self.motion.jacobian(self.u).applyfunc(tidy))


#: A plant as a model file may give it.
System = Plant | Modulated | ControlAffine


def make_modulated(
    x: Sequence[sp.Symbol],
    u: Sequence[sp.Symbol],
    J: Any,
    R: Any,
    G: Any,
    E: Any,
    H: Any,
    **about: Any,
) -> Modulated:
    """Check a plant with inputs in J or R, or with a source; None for G or E stands for 0.

    Raises
    ------
    ModelError
        For what is no such plant; docs/contract.md#errors.
    """
    x, u = tuple(x), tuple(u)
    check_states(x, "x")
    if u:
        check_states(u, "u")
    n, both = len(x), (*x, *u)
    inputs = shaped_matrix(sp.zeros(n, len(u)) if G is None else G, "G", x)
    if not u:
        u = tuple(sp.symbols([f"u{i + 1}" for i in range(inputs.cols)], real=True))
    if inputs.shape != (n, len(u)):
        raise ModelError(
            "shape",
            f"G has shape {inputs.rows}×{inputs.cols} for {n} states and {len(u)} inputs",
            f"G needs {n} rows and one column per input; leave it out where u stands in J alone.",
        )
    source = shaped_matrix(sp.zeros(n, 1) if E is None else E, "E", ())
    if source.shape != (n, 1):
        raise ModelError(
            "shape",
            f"E has shape {source.rows}×{source.cols}",
            f"E is a constant source: one entry for each of {n} states.",
        )
    found = Modulated(
        x=x,
        u=u,
        J=square_matrix(J, n, "J", both),
        R=square_matrix(R, n, "R", both),
        G=inputs,
        E=source,
        H=scalar_entry(H, "H", x),
        **about,
    )
    _check(found)
    return found


def _check(plant: Modulated) -> None:
    """J skew and R symmetric for every input, u affine, and inputs that act."""
    for i in range(plant.n):
        for j in range(i + 1):
            if is_zero(plant.J[i, j] + plant.J[j, i]) is False:
                raise ModelError(
                    "j_not_skew",
                    f"J must be skew-symmetric: J[{j},{i}] + J[{i},{j}] = "
                    f"{sp.simplify(plant.J[i, j] + plant.J[j, i])}",
                    f"Set J[{i},{j}] = -J[{j},{i}].",
                )
            if is_zero(plant.R[i, j] - plant.R[j, i]) is False:
                raise ModelError(
                    "r_not_symmetric",
                    f"R must be symmetric: R[{j},{i}] = {plant.R[j, i]}, "
                    f"R[{i},{j}] = {plant.R[i, j]}",
                    "Make the two entries equal; the skew part belongs into the other matrix.",
                )
    for matrix, label in ((plant.J, "J"), (plant.R, "R")):
        for entry in matrix:
            for s in plant.u:
                if any(is_zero(sp.diff(entry, s, other)) is not True for other in plant.u):
                    raise ModelError(
                        "model_file",
                        f"{label} holds {entry}, which is not affine in {s}",
                        "Inputs may stand in J and R to the first power alone.",
                    )
    _check_inputs(plant.directions)


def _check_inputs(directions: sp.MatrixBase) -> None:
    try:
        rank = generic_rank(sp.Matrix(directions))
    except Undecided:
        return
    if rank < directions.cols:
        raise ModelError(
            "g_rank",
            f"∂ẋ/∂u has rank {rank}, but there are {directions.cols} inputs",
            "Remove inputs that act alike, or not at all.",
        )


def make_control_affine(x: Sequence[sp.Symbol], f: Any, G: Any, **about: Any) -> ControlAffine:
    """Check a plant ẋ = f(x) + G(x) u.

    Raises
    ------
    ModelError
        For what is no such plant; docs/contract.md#errors.
    """
    x = tuple(x)
    check_states(x, "x")
    drift, inputs = shaped_matrix(f, "f", x), shaped_matrix(G, "G", x)
    if drift.shape != (len(x), 1):
        raise ModelError(
            "shape", f"f has shape {drift.rows}×{drift.cols}", f"f has {len(x)} entries."
        )
    if inputs.rows != len(x) or inputs.cols == 0:
        raise ModelError(
            "shape",
            f"G has shape {inputs.rows}×{inputs.cols}, but x has {len(x)} states",
            f"G needs {len(x)} rows and one column per input.",
        )
    _check_inputs(inputs)
    return ControlAffine(x=x, f=drift, g=inputs, **about)
