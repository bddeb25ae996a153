"""The symmetric chain, driven in the middle, with drag of any kind on its outer masses."""

import sympy as sp

from helpers.constructed import make_design, mechanical
from helpers.oscillators import QUADRATIC
from necc_casadi.model.plant import make_plant

SYMBOLS = q1, q2, q3, p1, p2, p3 = sp.symbols("q1:4 p1:4", real=True)

#: Zero, but no algebra in use proves it.
UNKNOWN = 2 ** sp.log(3) - 3 ** sp.log(2)


def on_momenta(first, third=0):
    """Rayleigh drag φ₁, φ₃ on the outer masses."""
    return sp.diag(0, 0, 0, first, 0, third)


def between(phi):
    """Drag φ on the relative velocity of the outer masses."""
    r = sp.Matrix([0, 0, 0, 1, 0, -1])
    return phi * r * r.T


#: Held where they are: drag that vanishes there, and what is known of the stability.
ATTRACT = {
    "on both": on_momenta(p1**2, p3**2),
    "on one": on_momenta(p1**2),
    "of any momentum": on_momenta(p1**2 + p3**2),
    "of the same squared": on_momenta((p1**2 + p3**2) ** 2),
    "where displaced": on_momenta(q1**2 * p1**2),
    "quartic": on_momenta(p1**4),
    "sine": on_momenta(sp.sin(p1) ** 2),
    "mixed product": on_momenta(p1**2 * sp.tanh(q1) ** 2),
    "exponentials": on_momenta((sp.exp(p1) - 1) ** 2 * sp.exp(q1)),
    "with a denominator": on_momenta(p1**2 / (1 + p1**2)),
    "relative": between((p1 - p3) ** 2),
}
#: The outer masses swing against each other for ever.
SWING = {
    "none": on_momenta(0),
    "of their sum, on both": on_momenta((p1 + p3) ** 2, (p1 + p3) ** 2),
    "of their sum, on one": on_momenta((p1 + p3) ** 2),
    "of their sum, relative": between((p1 + p3) ** 2),
    "of an outer one, on the middle": sp.diag(0, 0, 0, 0, p1**2, 0),
    "of the middle": on_momenta(p2**2, sp.sin(q2) ** 2 * p3**2),
}
#: Neither is proved: {p² + q³ = 0} holds more than {p = 0}, and no proof says that 1 − cos p ≥ 0.
UNDECIDED = {
    "two signs": on_momenta((p1**2 + q1**3) ** 2),
    "cosine": on_momenta(1 - sp.cos(p1)),
    "not analytic": on_momenta(sp.sqrt(p1**2 + p1**4)),
}


def chain(R):
    return mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2 + q3**2) / 2
        ),
        3,
        inputs=[1],
        R=R,
    )


def dragged(R):
    """A design that holds the chain at 0, V = H + ½ξ² + ½(q₂ − ξ)²."""
    return make_design(chain(R), [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])


def creeping():
    """ȧ = −a³ beside a driven oscillator, V = ½a² + …: a falls as 1/√t."""
    a, q, p = sp.symbols("a q p", real=True)
    J = sp.Matrix([[0, 0, 0], [0, 0, 1], [0, -1, 0]])
    H = (a**2 + q**2 + p**2) / 2
    plant = make_plant((a, q, p), J, sp.diag(a**2, 0, 0), sp.Matrix([0, 0, 1]), H)
    return make_design(plant, (0, 0, 0), QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
