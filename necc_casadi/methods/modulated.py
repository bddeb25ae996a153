"""Inputs in J or R, and constant sources: a shift by the input that holds the target.

With F = J(x, u*) − R(x, u*), g = ∂ẋ/∂u and a function h of the states that solves

    F∇h = E + G u* + g w(x)   for some w,

the plant is ẋ = F∇(H + h) + g ũ under u = u* − w(x) + ũ: a port-Hamiltonian plant whose energy has
a critical point at the target wherever F is regular there. For a constant F, h = −xᵀ∇H(x*)
with w = 0, which is xᵀF⁻¹(E + G u*) where F is regular.

References
----------
Ortega, van der Schaft, Mareels, Maschke (2001); docs/theory.md#modulated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.casimirs.integrability import potential
from necc_casadi.errors import ModelError
from necc_casadi.methods.flow import Flow
from necc_casadi.methods.method import Method
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.modulated import Modulated
from necc_casadi.model.plant import Plant, make_plant
from necc_casadi.model.shaped_loop import shaped_loop
from necc_casadi.symbolic.derivatives import at, gradient
from necc_casadi.symbolic.linear_algebra import kernel, tidy
from necc_casadi.symbolic.zero import is_zero
from necc_casadi.verdict.judge import judge

__all__ = ["at_its_minimum", "shifted_plant"]


def shifted_plant(system: Modulated, x_star: Mapping[sp.Symbol, sp.Expr]) -> Plant | str:
    """The plant as ũ sees it, or in words why no shift was found.

    Parameters
    ----------
    system
        With inputs in J or R, or sources.
    x_star
        An equilibrium, exact.
    """
    inputs = sp.Matrix(at(system.directions, x_star))
    if is_zero((inputs.T * inputs).det()) is not False:
        return "at the target the inputs act alike, or one does not act: none is singled out"
    u_star = system.holding_input(x_star).applyfunc(tidy)
    held = dict(zip(system.u, u_star, strict=True))
    if any(is_zero(e) is not True for e in at(system.motion.subs(held), x_star)):
        return "no constant input holds the target"
    F = sp.Matrix((system.J - system.R).subs(held)).applyfunc(tidy)
    push = sp.Matrix(system.E + system.G * u_star)
    for h in _shifts(F, push, system, x_star):
        plant = _with_energy(system, held, F, push, h)
        if plant is not None:
            return plant
    return "no function h with G⊥(F∇h − E − G u*) = 0 was found"


def at_its_minimum(plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr]) -> Method | None:
    """A loop of damping alone, where the target is a strict minimum of H; None where it is not.

    With γ = 0 and α = 0 the controller's own states are no part of u but through a coupled damping:
    u = u* − D y, which saturates as it likes.
    """
    zero = (sp.Integer(0),) * plant.m
    loop = shaped_loop(plant, zero, sp.zeros(plant.m, plant.m))
    functions = tuple(-s for s in loop.controller.xi)
    casimirs = Casimirs(functions, plant.m, plant.m, ("controller",) * plant.m)
    if any(is_zero(slope) is not True for slope in at(plant.grad_H, x_star)):
        return None
    verdict = judge(loop, casimirs, x_star)
    return Method("modulated", loop, casimirs, verdict) if verdict.assignable else None


def _shifts(
    F: sp.Matrix, push: sp.Matrix, system: Modulated, x_star: Mapping[sp.Symbol, sp.Expr]
) -> Iterator[sp.Expr]:
    """Candidates for h, simplest first."""
    x = system.x
    if push.is_zero_matrix:
        yield sp.Integer(0)
        return
    if not F.free_symbols:
        slope = -sp.Matrix(at(gradient(system.H, x), x_star))  # where F is regular: F⁻¹ push
        yield (slope.applyfunc(tidy).T * sp.Matrix(x))[0]
    elif F.det() != 0:
        h = potential(list(F.LUsolve(push).applyfunc(sp.cancel)), x)
        if h is not None:
            yield h
    yield from _searched(F, push, system, x_star)


def _searched(
    F: sp.Matrix, push: sp.Matrix, system: Modulated, x_star: Mapping[sp.Symbol, sp.Expr]
) -> Iterator[sp.Expr]:
    """H from first integrals h(x) − t of the rows of g⊥F, each with its push as the rate of t."""
    t = sp.Symbol("t_of_the_search", real=True)
    annihilator = kernel(sp.Matrix(system.directions.T)).T
    fields = sp.Matrix.hstack(annihilator * F, annihilator * push).T.applyfunc(tidy)
    found = find_casimirs(Flow.of((*system.x, t), fields, system.H), (), x_star)
    for c in found.functions:
        rate = sp.diff(c, t)
        if rate != 0 and not rate.free_symbols:
            yield sp.expand((rate * t - c) / rate)


def _with_energy(
    system: Modulated,
    held: Mapping[sp.Symbol, sp.Expr],
    F: sp.Matrix,
    push: sp.Matrix,
    h: sp.Expr,
) -> Plant | None:
    """The plant with energy H + h, where that is proved."""
    g = sp.Matrix(system.directions)
    excess = (F * gradient(h, system.x) - push).applyfunc(tidy)
    w = ((g.T * g).inv() * g.T * excess).applyfunc(tidy)
    u_star = sp.Matrix([held[s] for s in system.u])
    J, R = (matrix.subs(held) for matrix in (system.J, system.R))
    try:
        plant = make_plant(
            system.x,
            J,
            R,
            g,
            system.H + h,
            name=system.name,
            units=system.units,
            domain=system.domain,
            u_limits=system.u_limits,
        )
    except ModelError:  # R(u*) is not ⪰ 0, or H + h is constant
        return None
    one = sp.ImmutableMatrix(sp.eye(system.m))
    u0 = sp.ImmutableMatrix(u_star + w)
    ahead = Preliminary(system.drift, system.directions, u0, one)
    if not ahead.matches(plant.flow, plant.G):
        return None
    # g may vanish at points, as where a converter holds nothing: no proof asks for its rank
    proper = tuple(p for p in plant.properties if p.kind != "rank")
    return replace(
        plant, preliminary=ahead, sizes=system.sizes, inputs=system.inputs, properties=proper
    )
