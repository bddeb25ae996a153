"""A double well: the default region ends at a pass nearby, and shaping V moves it away."""

import pytest

from necc_casadi.pipeline.request import Choices, Request
from necc_casadi.pipeline.run import run_design

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
    model = tmp_path / "duffing.py"
    model.write_text(MODEL, encoding="utf-8")
    request = Request(model, tmp_path / "out", target="1/2", plots=False, chosen=Choices(**chosen))
    return run_design(request, lambda text: None)


@pytest.mark.slow
def test_a_small_region_gets_a_note_that_helps(tmp_path):
    plain, shaped = ran(tmp_path), ran(tmp_path, shape="level")
    assert plain.domain_share < 0.05
    assert any("--shape level" in note for note in plain.notes)
    assert shaped.domain_share > 0.4
    assert shaped.certificate.certified
    assert not any("--shape level" in note for note in shaped.notes)
