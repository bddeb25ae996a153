"""Plants with limited inputs, whose responses say what a proof of the unclipped loop does not."""

from necc_casadi.model.model_file import load_model

#: A joint under gravity: 5.9 N m hold it level, the motor gives 8.
JOINT = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
name = "Robot joint"
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational(1, 20))
G = sp.Matrix([0, 1])
H = 2 * p**2 + sp.Rational("5.886") * (1 - sp.cos(q))
units = {q: "rad"}
domain = {q: (-3, 3), p: (-2, 2)}
u_limits = [(-8, 8)]
"""

#: A camera head: a stiff design asks for many times what its motors give.
PAN_TILT = """
import sympy as sp
pan, tilt, p1, p2 = sp.symbols("pan tilt p1 p2", real=True)
name = "Pan-tilt head"
x = (pan, tilt, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([[0, 0], [0, 0], [1, 0], [0, 1]])
H = p1**2 / (sp.Rational(4, 100) + sp.cos(tilt) ** 2 / 100) + 50 * p2**2 + 0.6 * sp.sin(tilt)
units = {pan: "rad", tilt: "rad"}
u_limits = [(-1.5, 1.5), (-1.5, 1.5)]
target = {pan: 0.5, tilt: sp.Rational(1, 3), p1: 0, p2: 0}
"""


def written(folder, text):
    """A model file in a folder."""
    path = folder / "actuated.py"
    path.write_text(text, encoding="utf-8")
    return path


def loaded(folder, text):
    """The model of that file."""
    return load_model(written(folder, text))
