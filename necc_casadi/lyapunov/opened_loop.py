"""The plant alone, and the loop opened at the plant's input, as linear systems."""

from __future__ import annotations

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import LyapunovFunction, Terms

__all__ = ["opened_at_the_input", "plant_dynamics", "plant_linearisation"]


def plant_dynamics(terms: Terms) -> ca.Function:
    """(x, u) -> ẋ = (J − R)∇H + G u (eq. Plant)."""
    x, u = ca.SX.sym("x", terms.n), ca.SX.sym("u", terms.m)
    x_dot = terms.drift(x) + terms.directions(x) @ u
    return ca.Function("plant", [x, u], [x_dot], ["x", "u"], ["x_dot"])


def plant_linearisation(terms: Terms, x: Vector, u: Vector) -> tuple[Vector, Vector]:
    """∂ẋ/∂x (n, n) and ∂ẋ/∂u (n, m) of the plant at (x, u)."""
    s, v = ca.SX.sym("x", terms.n), ca.SX.sym("u", terms.m)
    x_dot = plant_dynamics(terms)(s, v)
    slopes = ca.Function("slopes", [s, v], [ca.jacobian(x_dot, s), ca.jacobian(x_dot, v)])
    A, B = slopes.call([x, u])
    return np.asarray(A, float), np.asarray(B, float)


def opened_at_the_input(V: LyapunovFunction, z: Vector) -> tuple[Vector, Vector, Vector]:
    """(A, B, C) of L with u = −L(s) w at the state z: the controller's answer to an input w.

    States are (x, s), s = ξ − γ(x); A − BC is the closed loop.
    """
    terms = V.terms
    n, m = terms.n, terms.m
    x, s = ca.MX.sym("x", n), ca.MX.sym("s", terms.nc)
    u, s_dot = V.control_law_function.call([x, s])
    law = ca.Function("law", [x, s], [u, _slope(u, x, s), _slope(s_dot, x, s)])
    at = [z[:n], V.stored(z[:n], z[n:])]
    u_z, u_slope, s_slope = (np.asarray(v, float) for v in law.call(at))
    A_plant, G = plant_linearisation(terms, z[:n], u_z.ravel())
    A = np.vstack([np.hstack([A_plant, np.zeros((n, terms.nc))]), s_slope])
    B = np.vstack([G, np.zeros((terms.nc, m))])
    return A, B, -u_slope


def _slope(f: ca.MX, x: ca.MX, s: ca.MX) -> ca.MX:
    return ca.horzcat(ca.jacobian(f, x), ca.jacobian(f, s))
