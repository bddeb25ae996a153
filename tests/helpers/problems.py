"""Problems and designs that many tests share."""

from pathlib import Path
from types import SimpleNamespace

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.designs.design import Design
from necc_casadi.model.target import parse_target, target_from_model
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.synthesis import design
from necc_casadi.verdict.judge import judge

PENDULUM = Path(__file__).parents[2] / "examples" / "pendulum.py"


#: A plant with two inputs, an inertia that depends on the position, friction and two Casimirs.
CART_AND_CRANE = """
import sympy as sp
q1, q2, p1, p2, k = sp.symbols("q1 q2 p1 p2 k")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, 0.1, sp.exp(-q1**2) / 5)
G = sp.Matrix([[0, 0], [0, 0], [1, 0], [0, 1]])
H = p1**2 / (2 * (2 + sp.cos(q2))) + p2**2 / 2 + k * (1 - sp.cos(q1)) + q2**2 / 4
params = {k: 0.5}
name = "Cart and crane"
"""


def problem(model, target):
    if target is None:
        x_star = target_from_model(model.loop.plant, model.target)
    else:
        x_star = parse_target(model.loop.plant, target)
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    verdict = judge(model.loop, casimirs, x_star)
    return SimpleNamespace(
        model=model, loop=model.loop, casimirs=casimirs, verdict=verdict, x_star=x_star
    )


def solve(task, options: Options | None = None) -> Design:
    return design(task.loop, task.casimirs, task.verdict, task.x_star, options)
