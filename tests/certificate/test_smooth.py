"""Where expressions are smooth as they were written: maker and checker, each in its arithmetic."""

import numpy as np
import pytest
import sympy as sp
from helpers.commands import design, here

from necc_casadi.certificate.checker.arithmetic import smooth as checker
from necc_casadi.certificate.prover.arithmetic import smooth as prover
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.designs.design import Design

q, p = sp.symbols("q p", real=True)


def on(expr, lo, hi):
    """The answer of both on q in [lo, hi], p in [-1, 1]."""
    box = Interval(np.array([lo, -1.0]), np.array([hi, 1.0]))
    answers = {
        prover.is_smooth_on([expr], (q, p), box),
        checker.is_smooth_on([expr], (q, p), ((lo, hi), (-1.0, 1.0))),
    }
    (answer,) = answers
    return answer


def everywhere(expr):
    answers = {module.is_smooth_everywhere([expr], (q, p)) for module in (prover, checker)}
    (answer,) = answers
    return answer


@pytest.mark.parametrize(
    ("expr", "smooth", "not_smooth"),
    [
        (sp.atan(sp.tan(q)) ** 2, (-1.5, 1.5), (1.0, 2.0)),
        (sp.sqrt(q), (0.1, 9.0), (0.0, 1.0)),
        (q ** sp.Rational(7, 2), (0.1, 9.0), (-1.0, 1.0)),
        (1 / q, (-3.0, -0.1), (-1.0, 1.0)),
        ((1 - q) * p / (1 - q) ** 3, (1.5, 3.0), (0.5, 3.0)),
        (sp.log(q**2), (0.5, 1.0), (-1.0, 1.0)),
        (sp.asin(q), (-0.9, 0.9), (-0.9, 1.0)),
        (sp.acos(sp.cos(q)), (0.2, 3.0), (-0.5, 0.5)),
        (sp.atanh(q) + sp.acosh(3 + q), (-0.9, 0.9), (0.0, 1.0)),
        (sp.acosh(q), (1.1, 5.0), (1.0, 5.0)),
        (sp.tan(q), (-1.5, 1.5), (-1.6, 1.5)),
        (sp.exp(sp.sin(q) / (2 + sp.cos(p))), (-50.0, 50.0), None),
        (sp.tanh(q) * 0 + sp.sqrt(q**2 - 2 * q * p + 5), (-9.0, 9.0), None),
        (abs(q - 1), None, (5.0, 6.0)),
    ],
    ids=str,
)
def test_both_know_where_an_expression_is_smooth(expr, smooth, not_smooth):
    assert smooth is None or on(expr, *smooth)
    assert not_smooth is None or not on(expr, *not_smooth)


@pytest.mark.parametrize(
    "expr",
    [
        p**2 / 2 + 1 - sp.cos(q),
        p**2 / (2 * (3 - sp.cos(q) ** 2)),
        p**2 / (2 * (1 + q**2 / 4)),
        p**2 / (5 + 4 * sp.cos(2 * q)),
        sp.sqrt(1 + q**4) + sp.tanh(q) / (2 + sp.tanh(p)),
        sp.exp(q * p) + sp.cosh(q) ** -2,
        1 / (1 + sp.exp(q)) + sp.sin(1 / (1 + q**2)),
    ],
    ids=str,
)
def test_both_know_what_is_smooth_everywhere(expr):
    assert everywhere(expr)


@pytest.mark.parametrize(
    "expr",
    [
        sp.atan(sp.tan(q)) ** 2, 1 / q, sp.log(1 + q), 1 / (1 - q**2), sp.tan(q),
        p**2 / (1 + sp.cos(q)), sp.sqrt(q**2), 1 / sp.sin(q / 2), 1 / (2 + 3 * sp.cos(q)),
    ],
    ids=str,
)  # fmt: skip
def test_neither_calls_a_pole_or_a_kink_smooth(expr):
    assert not everywhere(expr)


SAWTOOTH = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / 2 + {energy}
"""


@pytest.mark.parametrize("energy", ["3 * sp.atan(sp.tan(q))**2", "sp.acos(sp.cos(q))**2"])
def test_no_claim_crosses_a_kink_that_derivatives_do_not_show(energy, tmp_path):
    """The Hessian of a sawtooth's energy is a constant in sympy's eyes."""
    (tmp_path / "saw.py").write_text(SAWTOOTH.format(energy=energy), encoding="utf-8")
    out = tmp_path / "out"
    arguments = ("--target", "q=1,p=0", "--no-plots", "--hidden-k", "8", "--hidden-h", "6")
    code, _, err = design(tmp_path / "saw.py", *arguments, "--out", out)
    assert code in (0, 4), err
    certificate = certify(Design.load(out))
    claims = {claim.name: claim for claim in certificate.claims}
    assert not certificate.is_global
    assert not claims["global"].holds
    kink = np.pi / 2 if "tan" in energy else np.pi
    made = Design.load(out)
    if certificate.region is not None:
        below = np.array(made.z_bar, float)
        for beyond in (kink + 0.01, kink + 0.5, -0.01 if "cos" in energy else -kink - 0.1):
            at = below.copy()
            at[0] = beyond
            assert not certificate.region.contains(made.V, at)
    code, text, _ = here(_certify, out)
    assert code == 0, text
