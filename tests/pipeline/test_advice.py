"""A double well: the default region ends at a pass nearby, and shaping V moves it away."""

import pytest
from helpers.problems import problem, solve

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.model_file import load_model
from necc_casadi.performance.shares import sampled_share
from necc_casadi.pipeline.advice import region_notes
from necc_casadi.synthesis.options import Options

MODEL = """
import sympy as sp

q, p = sp.symbols("q p", real=True)
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational(1, 10))
G = sp.Matrix([0, 1])
H = p**2 / 2 + q**4 / 4 - q**2 / 2
"""


def ran(tmp_path, **chosen):
    """The plain default, or what is asked, and what is advised of it."""
    model = tmp_path / "duffing.py"
    model.write_text(MODEL, encoding="utf-8")
    options = Options(**chosen)
    made = solve(problem(load_model(model), "1/2"), options)
    certificate = certify(made)
    share = sampled_share(made, certificate)
    return certificate, share, region_notes(certificate, share, options)


@pytest.mark.slow
def test_a_small_region_gets_a_note_that_helps(tmp_path):
    (_, small, notes), (certificate, large, none) = ran(tmp_path), ran(tmp_path, shape="level")
    assert small < 0.05
    assert any("--shape level" in note for note in notes)
    assert large > 0.4
    assert certificate.certified
    assert none == []
