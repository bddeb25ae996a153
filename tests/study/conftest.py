"""A pendulum with parameters, designed once."""

import pytest
from helpers.commands import design

WEIGHED = """
import sympy as sp
q, p, m, g = sp.symbols("q p m g", real=True)
x = (q, p)
params = {m: 1.25, g: 9.81}
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational(1, 10))
G = sp.Matrix([0, 1])
H = p**2 / (2 * m) + m * g * (1 - sp.cos(q))
u_limits = [(-30, 30)]
"""


@pytest.fixture(scope="session")
def weighed(tmp_path_factory):
    """(model file, folder of its design)."""
    folder = tmp_path_factory.mktemp("weighed")
    model, out = folder / "weighed.py", folder / "out"
    model.write_text(WEIGHED, encoding="utf-8")
    code, _, err = design(
        model, "--target", "pi/4", "--hidden-k", "8", "--hidden-h", "6", "--no-plots", "--out", out
    )
    assert code == 0, err
    return model, out


RANGED = """
import sympy as sp
q, m = sp.symbols("q m")
M, V, B, friction = m, m * (1 - sp.cos(q)), 1, 0.1
params = {m: 1}
uncertain = {m: (0.9, 1.1)}
disturbance = [(-0.1, 0.1)]
target = {q: 0.75}
"""


@pytest.fixture(scope="session")
def ranged(tmp_path_factory):
    """The folder of a design of which ranges are proved."""
    folder = tmp_path_factory.mktemp("ranged")
    model, out = folder / "ranged.py", folder / "out"
    model.write_text(RANGED, encoding="utf-8")
    code, _, err = design(model, "--global", "--out", out)
    assert code == 0, err
    return out
