"""Designs with known answers, made without a solver: closed-form quadratics and fitted networks."""

from __future__ import annotations

import runpy
from pathlib import Path

import casadi as ca
import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop, interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import Plant, make_plant
from necc_casadi.verdict.verdict import Verdict

EXAMPLES = Path(__file__).parents[2] / "examples"


def pendulum() -> Plant:
    model = runpy.run_path(str(EXAMPLES / "pendulum.py"))
    return make_plant(*(model[key] for key in "xJRGH"), name="pendulum")


def mechanical(H, positions: int, inputs=None, R=None) -> Plant:
    """A canonical mechanical plant with symbols q1.., p1..; `inputs` selects actuated momenta."""
    n = positions
    names = [f"q{i + 1}" for i in range(n)] + [f"p{i + 1}" for i in range(n)]
    x = sp.symbols(names, real=True)
    J = sp.Matrix(sp.BlockMatrix([[sp.zeros(n), sp.eye(n)], [-sp.eye(n), sp.zeros(n)]]))
    inputs = range(n) if inputs is None else inputs
    G = sp.zeros(2 * n, len(list(inputs)))
    for column, i in enumerate(inputs):
        G[n + i, column] = 1
    return make_plant(x, J, sp.zeros(2 * n) if R is None else R, G, H(*x), name="mechanical")


def two_link_arm() -> Plant:
    """Unit point masses at the ends of unit links, hanging potential of gravity 1."""

    def H(q1, q2, p1, p2):
        c = sp.cos(q2)
        mass = sp.Matrix([[3 + 2 * c, 1 + c], [1 + c, 1]])
        p = sp.Matrix([p1, p2])
        kinetic = sp.simplify((p.T * mass.inv() * p)[0] / 2)
        return kinetic - 2 * sp.cos(q1) - sp.cos(q1 + q2) + 3

    return mechanical(H, 2)


def verdict(n: int) -> Verdict:
    return Verdict(
        True, "ok", "", (), None, sp.ImmutableMatrix(sp.zeros(n, 0)), None, None, "asymptotic", None
    )


def full_damping(damping: np.ndarray, seed: int = 0) -> np.ndarray:
    """The same diagonal blocks, coupled and with a skew part; the symmetric part stays ≻ 0."""
    m, rng = len(damping) // 2, np.random.default_rng(seed)
    root = np.sqrt(np.diag(damping))
    coupling = np.zeros_like(damping)
    coupling[:m, m:] = rng.uniform(-1, 1, (m, m)) / (2 * m)
    coupling += coupling.T
    skew = rng.normal(size=damping.shape)
    return damping + np.outer(root, root) * (coupling + skew - skew.T)


def make_design(
    plant: Plant,
    target,
    form: Form,
    weights,
    xi_star,
    damping=(5.0, 6.0),
    casimirs: Casimirs | None = None,
    loop: ClosedLoop | None = None,
) -> Design:
    loop = loop or interconnect(plant, default_controller(plant))
    m = plant.m
    return Design(
        loop=loop,
        casimirs=casimirs or find_casimirs(loop),
        x_star=tuple(sp.sympify(v) for v in target),
        verdict=verdict(plant.n),
        form=form,
        weights=np.asarray(weights, float),
        xi_star=np.asarray(xi_star, float),
        damping=np.kron(np.diag(damping), np.eye(m)),
        a=0.5,
        a_requested=0.5,
        seed=0,
    )


def fitted(plant, target, form: Form, xi_star, curvature=None, seed=0, **options) -> Design:
    """Least-squares correction of random weights: ∇V(z*) = 0 and a Hessian near 2I on (q, ξ).

    A few Gauss-Newton steps of least norm; the residuals are the gradient and, where
    `curvature` is given, the lower triangle of ∇²V(z*) minus it.
    """
    design = make_design(
        plant, target, form, form.initial(np.random.default_rng(seed)), xi_star, **options
    )
    from necc_casadi.lyapunov.lyapunov import make_terms, value

    terms = make_terms(design.loop, design.casimirs)
    w, z = ca.MX.sym("w", form.size), ca.MX.sym("z", design.loop.n)
    V = value(terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))
    hess, grad = ca.hessian(V, z)
    residuals = [grad]
    if curvature is not None:
        residuals.append(ca.vec(ca.tril2symm(ca.tril(hess)) - ca.DM(curvature)))
    stacked = ca.vertcat(*residuals)
    f = ca.Function("f", [w, z], [stacked, ca.jacobian(stacked, w)])
    weights = design.weights
    for _ in range(12):
        r, slope = (np.asarray(v, float) for v in f(weights, design.z_star))
        weights = weights - np.linalg.lstsq(slope, r.ravel(), rcond=1e-10)[0]
    return make_design(plant, target, form, weights, xi_star, **options)


def quadratic_pendulum(k: float = 4.0, h: float = 4.0, target="pi/4", xi: float = 0.5) -> Design:
    """Theory 11: K and Hc quadratic with K'(s*) = Hc'(ξ*) = −sin q*, curvatures k and h."""
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    q = float(sp.N(sp.sympify(target)))
    slope = -np.sin(q)
    # affine layer (W, b) zero; ½κ(v − o)² with κ(v* − o) = slope
    hc = [0.0, 0.0, h, xi - slope / h]
    kk = [0.0, 0.0, k, (q - xi) - slope / k]
    return make_design(pendulum(), (target, 0), form, hc + kk, [xi])


def trained_like_pendulum(hidden=(64,), seed=0, quadratic=False, phi: MonotonePhi | None = None):
    form = Form(
        Network(1, tuple(h // 2 for h in hidden), quadratic=quadratic),
        Network(1, hidden, quadratic=quadratic),
        phi=phi,
    )
    target = None
    if phi is None:
        c = np.cos(np.pi / 4)
        target = np.array([[c + 2, 0, -2], [0, 1, 0], [-2, 0, 4.0]])
    return fitted(pendulum(), ("pi/4", 0), form, [0.5], curvature=target, seed=seed)
