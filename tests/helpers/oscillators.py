"""Plants whose regions can be computed by hand."""

import dataclasses

import sympy as sp

from helpers.constructed import make_design, mechanical, quadratic_pendulum
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect

QUADRATIC = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))


def sides(**half: float):
    """Bounds ±half around 0 for each state named."""
    return {name: (-sp.Rational(str(v)), sp.Rational(str(v))) for name, v in half.items()}


def oscillator(h: float = 1.0, k: float = 1.0, domain=None):
    """V = ½(q² + p²) + ½hξ² + ½k(q − ξ)²."""
    plant = mechanical(lambda q, p: (p**2 + q**2) / 2, 1)
    plant = dataclasses.replace(plant, domain=domain or {})
    return make_design(plant, (0, 0), QUADRATIC, [0, 0, h, 0, 0, 0, k, 0], [0.0])


def double_well(k: float = 0.25, domain=None):
    """H = ½p² + ¼(q² − 1)², held at q = 1: a pass at q near 0 ends every region."""
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2 / 4, 1)
    plant = dataclasses.replace(plant, domain=domain or {})
    return make_design(plant, (1, 0), QUADRATIC, [0, 0, 1.0, 0.0, 0, 0, k, 1.0], [0.0])


def soft_pendulum():
    """The pendulum at π/4 on springs so soft that a pass beyond π ends its region."""
    return quadratic_pendulum(k=0.6, h=1.0)


def chain(domain=None):
    """Three coupled masses, quadratic: no state has to be kept."""
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2
        ),
        3,
        inputs=[0],
    )
    plant = dataclasses.replace(plant, domain=domain or {})
    return make_design(plant, [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])


def limited(design, *pairs):
    """The design with limits of its inputs."""
    plant = dataclasses.replace(design.loop.plant, u_limits=pairs)
    return dataclasses.replace(design, loop=interconnect(plant, design.loop.controller))
