"""The control law as the C code evaluates it: closed forms around the slopes of the networks.

CasADi orders the operations; the C code and the bounds of its rounding follow the same ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from necc_casadi.designs.design import Design

__all__ = ["Law", "law_of"]


@dataclass(frozen=True, eq=False)
class Law:
    """The law in what is measured and kept, given ∇Hc, γᵢ = Φ₂ ∂C/∂cᵢ and Φ₁; columns of SX."""

    x: ca.SX  # (n,), as it is measured
    s: ca.SX  # (nc,), what the code keeps
    state: ca.SX  # (n,), x of the model
    held: ca.SX  # (nc,), ξ
    grad_hc: ca.SX  # (nc,)
    gamma: ca.SX  # (r,)
    phi_1: ca.SX | None  # None: 1
    casimirs: ca.SX  # (r,), of x and s
    V_xi: ca.SX  # (nc,), ∂V/∂ξ
    u: ca.SX  # (m,)
    rate: ca.SX  # (nc,), ṡ
    undamped: ca.SX  # (nc,), the same without damping
    damped: ca.SX  # (nc,), what damping adds to it
    resting: ca.SX  # (m,), u without damping
    pull: ca.SX  # (m,), what damping adds to it

    @property
    def slopes(self) -> dict[str, ca.SX]:
        """What the closed forms need of the networks."""
        known = {"grad_hc": self.grad_hc, "gamma": self.gamma}
        return known if self.phi_1 is None else {**known, "phi_1": self.phi_1}


def law_of(design: Design) -> Law:
    """The law of a design, in the units of its model."""
    terms, loop = design.lyapunov.terms, design.loop
    n, nc, m = loop.plant.n, loop.controller.nc, loop.plant.m
    x, s = ca.SX.sym("x", n), ca.SX.sym("xi", nc)
    z, state = ca.SX.sym("z", n + nc), ca.densify(terms.measured.state(x))
    here, grad_H = ca.vertcat(state, s + terms.gamma(state)), ca.SX.sym("grad_H", n)
    c = terms.c(z)
    grad_hc, gamma = ca.SX.sym("grad_hc", nc), ca.SX.sym("gamma", terms.r)
    phi_1 = None if design.form.phi is None else ca.SX.sym("phi_1")
    energy_slope = ca.vertcat(grad_H, grad_hc)
    V_z = (ca.SX(1) if phi_1 is None else phi_1) * energy_slope + ca.jacobian(c, z).T @ gamma
    injected = -ca.DM(design.damping) @ (terms.ports(z).T @ V_z)
    pull, resting = injected[:m], -terms.feedback(z) @ grad_hc
    u = injected[:m] - terms.feedback(z) @ grad_hc
    if terms.preliminary is not None:
        given = ca.SX.sym("u", m)
        gain = ca.jacobian(terms.preliminary(z[:n], given), given)
        u, resting, pull = (*(terms.preliminary(z[:n], v) for v in (u, resting)), gain @ pull)
    damped = terms.own_ports(z) @ injected
    undamped = terms.own_structure(z) @ energy_slope
    rate = undamped + damped
    slope_here = ca.densify(terms.measured.grad_H(x))
    parts = [c, V_z[n:], u, rate, undamped, damped, resting, pull]
    known = ca.substitute(parts, [z, grad_H], [here, slope_here])
    return Law(x, s, state, here[n:], grad_hc, gamma, phi_1, *known)
