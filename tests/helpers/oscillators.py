"""A plant whose region can be computed by hand."""

import dataclasses

from helpers.constructed import make_design, mechanical
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form

QUADRATIC = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))


def oscillator(h: float = 1.0, k: float = 1.0, domain=None):
    """V = ½(q² + p²) + ½hξ² + ½k(q − ξ)²."""
    plant = mechanical(lambda q, p: (p**2 + q**2) / 2, 1)
    plant = dataclasses.replace(plant, domain=domain or {})
    return make_design(plant, (0, 0), QUADRATIC, [0, 0, h, 0, 0, 0, k, 0], [0.0])
