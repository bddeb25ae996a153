"""The paper's claim about its figure, made true: a proved region that contains [−2, 2]²."""

import itertools

import numpy as np
import sympy as sp

from necc_casadi import Options, certify, design, find_casimirs, judge, load_model
from necc_casadi.model.target import parse_target
from necc_casadi.simulation.responses import simulate

MODEL = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
x, H = (q, p), p**2 / 2 + 1 - sp.cos(q)
J, R, G = sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2, 2), sp.Matrix([0, 1])
domain = {q: (-9, 9), p: (-9, 9), "xi1": (-9, 9)}
"""


def test_slice_of_the_proved_region_contains_the_papers_square(tmp_path):
    path = tmp_path / "wide.py"
    path.write_text(MODEL)
    model = load_model(path)
    x_star = parse_target(model.loop.plant, "q=pi/4")
    casimirs = find_casimirs(model.loop)
    verdict = judge(model.loop, casimirs, x_star)
    # natural sizes are those of the paper's square, whatever box the certificate looks at
    options = Options(convex=True, natural_units=False)
    made = design(model.loop, casimirs, verdict, x_star, options)
    certificate = certify(made)
    assert certificate.certified
    assert certificate.is_global
    side = np.linspace(-2, 2, 41)
    highest = max(made.V([q, p, made.xi_star[0]]) for q, p in itertools.product(side, side))
    assert highest < certificate.level
    for corner in itertools.product((-2.0, 2.0), repeat=2):
        assert simulate(made, corner).converged


def test_global_certificate_is_about_the_whole_space(tmp_path):
    """∇²V of the convex design is positive definite far outside every box."""
    path = tmp_path / "wide.py"
    path.write_text(MODEL)
    model = load_model(path)
    x_star = {s: sp.Integer(0) for s in model.loop.plant.x} | {model.loop.plant.x[0]: sp.pi}
    casimirs = find_casimirs(model.loop)
    verdict = judge(model.loop, casimirs, x_star)
    made = design(model.loop, casimirs, verdict, x_star, Options(convex=True, natural_units=False))
    assert certify(made, region=True).is_global
    rng = np.random.default_rng(0)
    for z in rng.uniform(-100, 100, (300, 3)):
        assert np.linalg.eigvalsh(np.asarray(made.lyapunov.hessian(z), float))[0] > 0
