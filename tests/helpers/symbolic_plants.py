"""Plants and independent numerical routes shared by the symbolic tests."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import sympy as sp

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller, make_controller
from necc_casadi.model.model_file import load_model
from necc_casadi.model.plant import make_plant
from necc_casadi.model.target import target_from_model
from necc_casadi.verdict.judge import judge

EXAMPLES = Path(__file__).parents[2] / "examples"


def load(name, **options):
    """(plant, loop, target) of an example model file."""
    model = runpy.run_path(str(EXAMPLES / f"{name}.py"))
    if "M" in model:  # J, R, G and H are the tool's own
        made = load_model(EXAMPLES / f"{name}.py")
        return made.loop.plant, made.loop, target_from_model(made.loop.plant, made.target)
    values = model.get("params", {})
    J, R, G, H = (sp.sympify(model[key]).subs(values) for key in "JRGH")
    plant = make_plant(model["x"], J, R, G, H, name=model["name"])
    controller = default_controller(plant)
    if "xi" in model and not options.get("integrators"):
        controller = make_controller(plant, *(model[key] for key in ("xi", "Jc", "Rc", "Gc")))
    target = {s: sp.sympify(v).subs(values) for s, v in model.get("target", {}).items()}
    return plant, interconnect(plant, controller), target


def verdict_of(loop, target, supplied=()):
    values = dict(zip(loop.plant.x, map(sp.sympify, target), strict=True))
    return judge(loop, find_casimirs(loop, supplied, values), values)


def canonical(n):
    J = sp.zeros(2 * n, 2 * n)
    J[:n, n:], J[n:, :n] = sp.eye(n), -sp.eye(n)
    return J


def cross(p):
    """p ↦ the skew matrix J(p) of a rigid body."""
    return sp.Matrix([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])


def rolling_coin():
    x, y, theta, phi, p1, p2 = sp.symbols("x y theta phi p1 p2", real=True)
    J = sp.zeros(6, 6)
    J[0, 5], J[1, 5], J[2, 5], J[3, 4] = sp.cos(phi), sp.sin(phi), 1, 1
    G = sp.Matrix.vstack(sp.zeros(4, 2), sp.eye(2))
    return make_plant((x, y, theta, phi, p1, p2), J - J.T, sp.zeros(6, 6), G, (p1**2 + p2**2) / 2)


def body_and_wheel(inertia=(3, 2, 1), wheel=1):
    """A free rigid body next to a driven wheel that does not touch it."""
    p = sp.symbols("p1:4", real=True)
    s = sp.Symbol("s", real=True)
    J = sp.diag(cross(p), 0)
    H = sum(v**2 / sp.Integer(2 * i) for v, i in zip(p, inertia, strict=True)) + wheel * s**2 / 2
    return make_plant((*p, s), J, sp.zeros(4, 4), sp.Matrix([0, 0, 0, 1]), H)


def predator_prey():
    x1, x2 = sp.symbols("x1 x2", positive=True)
    J = sp.Matrix([[0, x1 * x2], [-x1 * x2, 0]])
    H = x1 + x2 - sp.log(x1) - 2 * sp.log(x2)
    return make_plant((x1, x2), J, sp.zeros(2, 2), sp.Matrix([x1, 0]), H)


def transformed(plant, T):
    """The plant in coordinates y with x = T y."""
    y = sp.symbols(f"y1:{plant.n + 1}", real=True)
    back = dict(zip(plant.x, T * sp.Matrix(y), strict=True))
    inverse = T.inv()
    J, R = (inverse * sp.Matrix(A).subs(back) * inverse.T for A in (plant.J, plant.R))
    return make_plant(
        y, J, R, inverse * sp.Matrix(plant.G).subs(back), plant.H.subs(back, simultaneous=True)
    )


def curved(plant, y, forward):
    """The plant in coordinates y with x = forward(y), a curved change."""
    T = sp.Matrix(forward).jacobian(y)
    inverse = T.inv().applyfunc(sp.cancel)
    back = dict(zip(plant.x, forward, strict=True))
    J, R, G = (sp.Matrix(A).subs(back, simultaneous=True) for A in (plant.J, plant.R, plant.G))
    return make_plant(
        y,
        (inverse * J * inverse.T).applyfunc(sp.expand),
        (inverse * R * inverse.T).applyfunc(sp.expand),
        (inverse * G).applyfunc(sp.expand),
        plant.H.subs(back, simultaneous=True),
    )


def numeric(matrix):
    return np.array(sp.Matrix(matrix).evalf(20).tolist(), dtype=float)


def best_hessian_eigenvalue(loop, casimirs, target, seed=0):
    """Largest λ_min(∇²V(z*)) that a search over quadratic K and Hc finds; −inf if ∇V ≠ 0.

    A route of its own: least squares for λ, then ∇²V = ∇²(H + Σλc) + ∇c S ∇cᵀ + ∇²Hc with S and
    ∇²Hc multiples of the identity, λ drawn at random where it is free.
    """
    rng = np.random.default_rng(seed)
    z, n, r = list(loop.z), loop.plant.n, len(casimirs.functions)
    point = {**target, **{s: sp.Rational(1, 3) for s in loop.controller.xi}}
    slopes = [
        numeric(sp.Matrix([sp.diff(c, s) for s in z]).subs(point)) for c in casimirs.functions
    ]
    hessians = [numeric(sp.hessian(c, z).subs(point)) for c in casimirs.functions]
    base = numeric(sp.hessian(loop.plant.H, z).subs(point))
    g = numeric(sp.Matrix([sp.diff(loop.plant.H, s) for s in z[:n]]).subs(point))
    C = np.hstack(slopes) if r else np.zeros((loop.n, 0))
    lam = -np.linalg.lstsq(C[:n], g, rcond=None)[0][:, 0] if r else np.zeros(0)
    if np.abs(g[:, 0] + C[:n] @ lam).max() > 1e-9 * max(1.0, np.abs(g).max()):
        return -np.inf
    free = np.eye(r) - np.linalg.pinv(C[:n]) @ C[:n] if r else np.zeros((0, 0))
    best = -np.inf
    for trial in range(200 if np.abs(free).max(initial=0) > 1e-9 else 1):
        shift = free @ rng.normal(scale=3.0, size=r) if trial else np.zeros(r)
        P = base + sum(
            (w * Q for w, Q in zip(lam + shift, hessians, strict=True)), np.zeros_like(base)
        )
        for stiffness in (1.0, 1e3, 1e6):
            full = P + stiffness * C @ C.T
            full[n:, n:] += 10 * stiffness * np.eye(loop.n - n)
            best = max(best, float(np.linalg.eigvalsh(full)[0]))
    return best
