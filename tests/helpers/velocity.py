"""Designs of mechanical plants that measure q̇, by hand: quadratic K and Hc."""

import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.mechanical_file import Mechanical, phase_space
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.verdict import Verdict


def mechanical_loop(M, V, B, q, friction=None, **about):
    x = phase_space(q)
    model = Mechanical.of(x, M, V, B, friction)
    plant = make_plant(x, *model.structure, **about)
    object.__setattr__(plant, "inertia", sp.ImmutableMatrix(model.M))
    loop = interconnect(plant, default_controller(plant))
    k = len(q) if isinstance(q, tuple) else 1
    functions = tuple(
        sp.expand(v) - s
        for v, s in zip(sp.Matrix(model.B).T * sp.Matrix(x[:k]), loop.controller.xi, strict=True)
    )
    return loop, Casimirs(functions, loop.plant.m, loop.plant.m)


def sprung(loop, casimirs, target, k, h, D, Dc) -> Design:
    """V with quadratic K and Hc of curvatures k and h per input, whose minimum is the target."""
    m = loop.plant.m
    form = Form(Network(m, (), quadratic=True), Network(m, (), quadratic=True))
    n = len(target)
    at = dict(zip(loop.plant.x, [*target, *[0] * n], strict=True))
    slope = np.array([float(v.subs(at)) for v in loop.plant.grad_H[:n, 0]])
    B = np.array(sp.Matrix(loop.plant.G[n:, :]).evalf(), float)
    pull = -np.linalg.lstsq(B, slope, rcond=None)[0]  # ∇K(c*), and ∇Hc(ξ*) alike
    c = B.T @ np.array(target, float)
    k, h = np.full(m, float(k)), np.full(m, float(h))
    hc = [*np.zeros(m + 1), *h, *(-pull / h)]
    kk = [*np.zeros(m + 1), *k, *(c - pull / k)]
    verdict = Verdict(
        True, "ok", "", (sp.Integer(0),) * m, None, sp.ImmutableMatrix(sp.zeros(2 * m, 0)),
        None, None, "asymptotic", None,
    )  # fmt: skip
    return Design(
        loop=loop,
        casimirs=casimirs,
        x_star=(*map(sp.sympify, target), *[sp.Integer(0)] * n),
        verdict=verdict,
        form=form,
        weights=np.array([*hc, *kk]),
        xi_star=np.zeros(m),
        damping=np.diag([D] * m + [Dc] * m).astype(float),
        a=0.1,
        a_requested=0.1,
        seed=0,
    )


def pendulum(limits=None) -> Design:
    q = sp.Symbol("q", real=True)
    loop, casimirs = mechanical_loop(1, 1 - sp.cos(q), 1, q, sp.Rational(1, 10), u_limits=limits)
    return sprung(loop, casimirs, [sp.Rational(3, 4)], 4, 4, 2, 0.5)


def crank(mass: float = 1.0) -> Design:
    """One coordinate whose inertia moves with it, m(1 + ½cos²q)."""
    q, m = sp.Symbol("q", real=True), sp.nsimplify(mass)
    M = m * (1 + sp.cos(q) ** 2 / 2)
    loop, casimirs = mechanical_loop(M, m * (1 - sp.cos(q)), 1, q, m / 10)
    return sprung(loop, casimirs, [sp.Rational(3, 4)], 4 * mass, 4 * mass, 2 * mass, 0.5 / mass)


def crane(wind: str = "0", **ranges) -> tuple[Design, Plants]:
    """A cart with a load that hangs, m in the model 1, and plants with m and a wind w that vary."""
    s, a, m, w = sp.symbols("s a m w", real=True)
    x, friction = phase_space((s, a)), sp.eye(2) / 10
    M = sp.Matrix([[1 + m, m * sp.cos(a)], [m * sp.cos(a), m]])
    V, B = m * (1 - sp.cos(a)) + w * a, sp.Matrix([1, 0])
    known = {m: 1, w: sp.sympify(wind)}
    loop, casimirs = mechanical_loop(M.subs(known), V.subs(known), B, (s, a), friction)
    made = sprung(loop, casimirs, [sp.Rational(1, 2), sp.Integer(0)], 1, 1, 1, 0.5)
    J, R, G, H = Mechanical.formal(x, M, V, B, friction).structure
    structure = (sp.ImmutableMatrix(v) for v in (J, R, G))
    formal = Parametric(*structure, H, {"m": sp.Integer(1), "w": sp.sympify(wind)})
    sides = {name: tuple(map(sp.sympify, side)) for name, side in ranges.items()}
    return made, Plants(formal, sides)


def pendulum_with_load(**ranges) -> Plants:
    """Its plants with a load l, 0 in the model, within ranges."""
    q, load = sp.symbols("q l", real=True)
    x, friction = phase_space(q), sp.Matrix([[sp.Rational(1, 10)]])
    formal = Mechanical.formal(x, 1 + load, (1 + load) * (1 - sp.cos(q)), 1, friction).structure
    J, R, G, H = formal
    structure = (sp.ImmutableMatrix(v) for v in (J, R, G))
    return Plants(Parametric(*structure, H, {"l": sp.Integer(0)}), ranges)


def arm_with_payload(lo: str = "0", hi: str = "1") -> tuple[Design, Plants]:
    """Two links of 1 kg and 1 m that hold half a kilogram, and any payload between two."""
    a, b, mp = sp.symbols("q1 q2 mp", real=True)
    x, half = phase_space((a, b)), sp.Rational(1, 2)
    both = mp * (1 + sp.cos(b)) + sp.Rational(1, 3) + sp.cos(b) / 2
    M = sp.Matrix([[sp.Rational(5, 3) + sp.cos(b) + 2 * mp * (1 + sp.cos(b)), both],
                   [both, sp.Rational(1, 3) + mp]])  # fmt: skip
    V = (sp.Rational(3, 2) + mp) * (1 - sp.cos(a)) + (half + mp) * (1 - sp.cos(a + b))
    V, friction = sp.Rational(981, 100) * V, sp.eye(2) / 5
    known = {mp: half}
    loop, casimirs = mechanical_loop(M.subs(known), V.subs(known), sp.eye(2), (a, b), friction)
    made = sprung(loop, casimirs, [sp.pi / 4, -sp.pi / 3], 110, 110, 8, 0.1)
    J, R, G, H = Mechanical.formal(x, M, V, sp.eye(2), friction).structure
    structure = (sp.ImmutableMatrix(v) for v in (J, R, G))
    formal = Parametric(*structure, H, {"mp": half})
    return made, Plants(formal, {"mp": (sp.sympify(lo), sp.sympify(hi))})


def arm() -> Design:
    """Two links with friction, whose inputs are not the joint torques."""
    q1, q2 = q = sp.symbols("q1 q2", real=True)
    h = sp.Rational(1, 3) + sp.cos(q2) / 2
    M = [[sp.Rational(5, 3) + sp.cos(q2), h], [h, sp.Rational(1, 3)]]
    V = 3 * (1 - sp.cos(q1)) + (1 - sp.cos(q1 + q2)) / 2
    B = [[1, -1], [0, 2]]
    friction = [[sp.Rational(1, 5), 0], [0, sp.Rational(1, 10)]]
    loop, casimirs = mechanical_loop(M, V, B, q, friction)
    return sprung(loop, casimirs, [sp.Rational(1, 2), sp.Rational(-1, 4)], 20, 20, 3, 0.3)
