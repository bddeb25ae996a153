"""Designs with random weights for the export tests: the C code must not care about training."""

import shutil
from functools import cache

import numpy as np
import sympy as sp
from hypothesis import strategies as st

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.certify import units_of
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.networks import ACTIVATIONS, MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop, interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.verdict import Verdict

STRICT = [
    "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion",
    "-Wmissing-prototypes", "-Wshadow", "-Werror",
]  # fmt: skip
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]


@cache
def pendulum_loop(limits=None) -> tuple[ClosedLoop, Casimirs]:
    q, p = sp.symbols("q p", real=True)
    plant = make_plant(
        (q, p),
        sp.Matrix([[0, 1], [-1, 0]]),
        sp.zeros(2, 2),
        sp.Matrix([0, 1]),
        p**2 / 2 + 1 - sp.cos(q),
        name="Pendulum */ with a name to escape",
        units={"q": "rad", "p": "kg m²/s"},
        u_limits=limits,
    )
    loop = interconnect(plant, default_controller(plant))
    return loop, Casimirs((loop.z[0] - loop.z[2],), 1, 1)


@cache
def arm_loop() -> tuple[ClosedLoop, Casimirs]:
    """Two masses with a position-dependent inertia, two inputs, a singular function or two."""
    q1, q2, p1, p2 = x = sp.symbols("q1 q2 p1 p2", real=True)
    J = sp.Matrix(4, 4, lambda i, j: 1 if j == i + 2 else -1 if i == j + 2 else 0)
    R = sp.diag(0, 0, sp.Rational(1, 10), sp.exp(-(q1**2)))
    H = p1**2 / (3 + 2 * sp.cos(q2)) / 2 + p2**2 / 2 + sp.sqrt(2 + sp.sin(q1)) + sp.atan(q2) ** 3
    plant = make_plant(x, J, R, sp.Matrix([[0, 0], [0, 0], [1, 0], [sp.sin(q1), 2]]), H)
    loop = interconnect(plant, default_controller(plant))
    xi1, xi2 = loop.controller.xi
    # For the export a Casimir is any function of z; a nonlinear one tests its gradient.
    return loop, Casimirs((q1 - xi1, sp.tanh(q2) * (1 + xi2**2) - xi2 / 3 + q1 * xi1), 2, 2)


def _damping(rng: np.random.Generator, m: int) -> np.ndarray:
    """Uncoupled or full, in turns; the symmetric part of either is ≻ 0."""
    diagonal = np.diag(rng.uniform(1, 5, 2 * m))
    root = rng.normal(size=(2 * m, 2 * m))
    return diagonal + (root @ root.T + root - root.T) * rng.integers(2)


def design(loop_and_casimirs, form: Form, seed: int = 0) -> Design:
    loop, casimirs = loop_and_casimirs
    rng = np.random.default_rng(seed)
    m, r = loop.plant.m, len(casimirs.functions)
    verdict = Verdict(
        True, "ok", "", (sp.Integer(0),) * r, None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)),
        None, None, "asymptotic", None,
    )  # fmt: skip
    weights = form.initial(rng)
    return Design(
        loop=loop,
        casimirs=casimirs,
        x_star=(sp.pi / 4,) + (sp.Integer(0),) * (loop.plant.n - 1),
        verdict=verdict,
        form=form,
        weights=weights,
        xi_star=rng.normal(size=m),
        damping=_damping(rng, m),
        a=0.5,
        a_requested=0.5,
        seed=seed,
    )


def paper_design(hidden_h=(32, 32), hidden_k=(64, 64)) -> Design:
    return design(pendulum_loop(), Form(Network(1, hidden_h), Network(1, hidden_k)))


def claiming(made: Design, statements) -> Certificate:
    """A certificate that holds these statements, and no region."""
    return Certificate(
        design_hash=made.hash,
        claims=tuple(Claim("equilibrium", True, text) for text in statements),
        units=units_of(made),
        z_bar=tuple(made.z_star),
        enclosure=None,
        mu=None,
        radius=None,
        bound_rigorous=None,
        stability=None,
    )


def networks(inputs: int) -> st.SearchStrategy[Network]:
    return st.builds(
        Network,
        st.just(inputs),
        st.lists(st.integers(1, 19), max_size=3).map(tuple),
        st.sampled_from(sorted(ACTIVATIONS)),
        st.booleans(),
    )


@st.composite
def designs(draw) -> Design:
    """Both plants, both Casimir forms, both Φ, every activation, odd widths and depths."""
    loop, casimirs = draw(st.sampled_from([pendulum_loop(), arm_loop()]))
    r = len(casimirs.functions)
    summed = draw(st.booleans())
    form = Form(
        hc=draw(networks(loop.controller.nc)),
        k=draw(networks(1 if summed else r)),
        betas=tuple(draw(networks(1)) for _ in range(r)) if summed else (),
        phi=draw(st.none() | st.builds(MonotonePhi, st.integers(1, 12))),
    )
    return design((loop, casimirs), form, draw(st.integers(0, 2**16)))
