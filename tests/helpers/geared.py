"""An oscillator driven through a gear whose ratio depends on the position."""

import dataclasses

import sympy as sp

from helpers.constructed import make_design
from helpers.oscillators import QUADRATIC
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant


def geared(gain, domain=None, masses=1):
    """q̇ = p/m, ṗ = −q − r(q)·u with a gear whose ratio r depends on the position."""
    names = [f"{kind}{i + 1}" for kind in "qp" for i in range(masses)]
    x = sp.symbols(names, real=True)
    q, p = x[:masses], x[masses:]
    J = sp.Matrix(
        sp.BlockMatrix([[sp.zeros(masses), sp.eye(masses)], [-sp.eye(masses), sp.zeros(masses)]])
    )
    G = sp.Matrix([*[0] * masses, gain(q[0]), *[0] * (masses - 1)])
    H = sum(v**2 for v in (*q, *p)) / 2
    plant = make_plant(x, J, sp.zeros(2 * masses), G, H, name="geared", domain=domain)
    loop = interconnect(plant, default_controller(plant))
    c = loop.z[-1] - sp.integrate(gain(q[0]), q[0])
    casimirs = dataclasses.replace(find_casimirs(loop), functions=(c,))
    weights = [0, 0, 1.0, 0, 0, 0, 1.0, 0]
    return make_design(plant, [0] * 2 * masses, QUADRATIC, weights, [0.0], casimirs=casimirs)
