"""Mechanical plants by coordinates and rates: Mq̈ + … + Rq̇ + ∇U = B(u + d).

With q̇ = ∂H/∂p and p = M q̇: H = ½q̇ᵀM(q)q̇ + U(q), y = Bᵀq̇, friction R acting on q̇.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant
from necc_casadi.model.ranges import Range
from necc_casadi.model.rescale import exactly
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.zero import is_zero

__all__ = [
    "Lagrangian",
    "Plants",
    "integral_obstacle",
    "lagrangian",
    "local_integral_obstacle",
    "varied_plant",
]


@dataclass(frozen=True, eq=False)
class Lagrangian:
    """M, U, R and B of a plant of k coordinates and m inputs, in some units."""

    q: tuple[sp.Symbol, ...]  # (k,)
    M: sp.ImmutableMatrix  # k × k, of q and θ
    U: sp.Expr  # of q and θ
    R: sp.ImmutableMatrix  # k × k, of θ
    B: sp.ImmutableMatrix  # k × m, constant, of rank m
    ranges: Mapping[sp.Symbol, Range] = field(default_factory=dict)  # of θ

    @cached_property
    def affine(self) -> tuple[sp.Symbol, ...]:
        """Those θ that M, U and R have to the first power, the others held."""
        entries = {sp.sympify(v) for v in (self.U, *self.M, *self.R)}
        return tuple(
            s
            for s in self.ranges
            if all(is_zero(v.diff(s, 2)) is True for v in entries if v.has(s))
        )

    def unheld(self, q_star: Sequence[sp.Expr]) -> sp.Matrix:
        """(I − B(BᵀB)⁻¹Bᵀ)∇U at q*, (k, 1), of θ: what no input can hold there."""
        there = dict(zip(self.q, q_star, strict=True))
        slope, B = sp.Matrix([sp.diff(self.U, s) for s in self.q]).subs(there), sp.Matrix(self.B)
        return slope - B * (B.T * B).inv() * B.T * slope


@dataclass(frozen=True, eq=False)
class Plants:
    """The plants of a model of which some parameters are constants within ranges."""

    parametric: Parametric
    ranges: Mapping[str, Range]  # parameter -> (least, greatest), exact

    @property
    def varied(self) -> Parametric:
        """J, R, G and H with these parameters as symbols, the others at their values."""
        known = {k: v for k, v in self.parametric.values.items() if k not in self.ranges}
        return self.parametric.at(known)


def varied_plant(plant: Plant, plants: Plants | None) -> Plant | None:
    """The plant with θ as symbols in M, U and R; None where θ is elsewhere, or H not quadratic."""
    if plants is None:
        return plant
    varied, k = plants.varied, plant.n // 2
    p, at_rest = plant.x[k:], dict.fromkeys(plant.x[k:], sp.Integer(0))
    inverse = sp.hessian(varied.H, p).applyfunc(tidy)
    rest = varied.H - (sp.Matrix(p).T * inverse * sp.Matrix(p))[0, 0] / 2
    linear = any(is_zero(sp.diff(rest, s)) is not True for s in p)
    if (varied.J, varied.G) != (plant.J, plant.G) or inverse.free_symbols & set(p) or linear:
        return None
    if any(is_zero(v) is not True for v in varied.R - varied.R.T):
        return None
    if any(varied.R[:k, :]) or any(varied.R[:, :k]) or varied.R.free_symbols & set(plant.x):
        return None
    inertia = sp.ImmutableMatrix(inverse.inv().applyfunc(tidy))
    return replace(plant, H=rest.subs(at_rest), R=varied.R, inertia=inertia)


def lagrangian(loop: ClosedLoop, units: Sizes, plants: Plants | None = None) -> Lagrangian | None:
    """The plant of a loop that has no :func:`local_integral_obstacle`, measured in `units`.

    With `plants` as a function of their parameters; None where these are not in M, U and R alone.
    """
    plant, k = varied_plant(loop.plant, plants), loop.plant.n // 2
    if plant is None or plant.inertia is None:
        return None
    inertia = plant.inertia
    S, u = exactly(units.state[:k]), exactly(units.input)
    T, E = exactly(np.array([units.time, units.energy]))
    scale = {s: size * s for s, size in zip(plant.x, S, strict=False) if size != 1}
    at_rest = dict.fromkeys(plant.x[k:], sp.Integer(0))

    def scaled(matrix: sp.MatrixBase, factor: sp.Expr) -> sp.ImmutableMatrix:
        return sp.ImmutableMatrix(
            k, k, lambda i, j: matrix[i, j].xreplace(scale) * S[i] * S[j] * factor
        )

    return Lagrangian(
        q=plant.x[:k],
        M=scaled(inertia, 1 / (T**2 * E)),
        U=plant.H.subs(at_rest).xreplace(scale) / E,
        R=scaled(plant.R[k:, k:], 1 / (T * E)),
        B=sp.ImmutableMatrix(k, plant.m, lambda i, j: plant.G[k + i, j] * S[i] * u[j] / E),
        ranges={}
        if plants is None
        else {sp.Symbol(name, real=True): side for name, side in plants.ranges.items()},
    )


def integral_obstacle(
    loop: ClosedLoop, casimirs: Sequence[sp.Expr], phi_is_sum: bool
) -> str | None:
    """Why no box can be proved with integral action on the position; None where one can.

    What it takes beside :func:`local_integral_obstacle`: an input for each coordinate.
    """
    m, k = loop.plant.m, loop.plant.n // 2
    if loop.plant.inertia is not None and m < k:
        return f"{m} input(s) act on {k} coordinates: the plant is underactuated"
    return local_integral_obstacle(loop, casimirs, phi_is_sum)


def local_integral_obstacle(
    loop: ClosedLoop, casimirs: Sequence[sp.Expr], phi_is_sum: bool
) -> str | None:
    """Why integral action on the position is not covered, near the target either; None: it is.

    What it takes: M(q)q̈ + … = B(u + d) with constant B, k × m of rank m, constant friction,
    q̇ measured; the published loop with m integrators, Casimirs linear in (q, ξ), and the sum
    Φ = H + Hc + C.
    """
    plant, controller = loop.plant, loop.controller
    n, m, k = plant.n, plant.m, plant.n // 2
    if plant.inertia is None:
        return "the controller does not measure velocities"
    if isinstance(loop, ShapedLoop) or plant.preliminary is not None:
        return "the loop is not the published one"
    if not phi_is_sum:
        return "Φ is not the sum H + Hc + C"
    B, R, J = plant.G[k:, :], plant.R[k:, k:], plant.J
    canonical = sp.Matrix.hstack(sp.zeros(k, k), sp.eye(k))
    if any((*(J[:k, :] - canonical), *J[k:, k:], *plant.R[:k, :], *plant.R[:, :k])):
        return "J and R are not those of q̇ = ∂H/∂p, ṗ = −∂H/∂q − R ∂H/∂p + B u"
    if B.free_symbols or R.free_symbols or is_zero(sp.Matrix(B.T * B).det()) is not False:
        return "B and the friction are not constant, or the columns of B are dependent"
    Gc = controller.Gc
    own = (*controller.Jc, *controller.Rc)
    if controller.nc != m or any(own) or Gc.free_symbols or is_zero(sp.Matrix(Gc).det()):
        return "the controller is not made of one integrator per input"
    slopes = sp.Matrix([[sp.diff(c, s) for s in loop.z] for c in casimirs])
    seen = any(slopes[:, k:n]) if casimirs else True
    square = len(casimirs) == m and not slopes.free_symbols
    if not square or seen or is_zero(slopes[:, n:].det()) is not False:
        return "the Casimirs are not linear in q and ξ, or not one per input"
    return None
