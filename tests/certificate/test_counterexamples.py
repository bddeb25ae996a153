"""A hunt for counterexamples inside certified regions: 10⁴ states from the boundary inwards."""

import numpy as np
import pytest
from helpers.problems import solve

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.synthesis.options import Options

STATES, BATCHES, HORIZON = 10_000, 20, 200.0
#: V may rise by this much through the integrator's own error.
ROUNDING = 1e-7


class PlainPendulum:
    """ż and V of a pendulum design, by its stored weights in NumPy, column by column."""

    def __init__(self, design):
        form, weights = design.form, design.form.split(design.weights)
        self.design, self.nets = design, list(zip((form.hc, form.k), weights, strict=False))

    def network(self, index, v):
        """(f, f′) at scalars (B,)."""
        net, w = self.nets[index]
        value, slope = v[None, :], np.ones((1, v.size))
        *hidden, last = net.layers(w)
        for W, b in hidden:
            value = np.tanh(W @ value + b[:, None])
            slope = (1 - value**2) * (W @ slope)
        value, slope = (last[0] @ value)[0] + last[1][0], (last[0] @ slope)[0]
        if net.quadratic:
            kappa, center = (part[0] for part in net.quadratic_part(w))
            value, slope = value + kappa * (v - center) ** 2 / 2, slope + kappa * (v - center)
        return value, slope

    def V(self, z):
        """p²/2 + 1 − cos q + Hc(ξ) + K(q − ξ)."""
        q, p, xi = z
        return p**2 / 2 + 1 - np.cos(q) + self.network(0, xi)[0] + self.network(1, q - xi)[0]

    def flow(self, z):
        """The damped loop with y = p, u = −Hc′(ξ) − D p, and ξ̇ = p − Dc ∂V/∂ξ."""
        q, p, xi = z
        D, Dc = float(self.design.D[0, 0]), float(self.design.Dc[0, 0])
        dhc, dk = self.network(0, xi)[1], self.network(1, q - xi)[1]
        return np.array([p, -np.sin(q) - dhc - D * p, p - Dc * (dhc - dk)])


def from_the_boundary_inwards(design, plain, certificate, count):
    """States along random rays from z̄ at shares of the way to where V reaches c, half at its end.

    The rays start inside and V is followed outwards in small steps, so that the first crossing of
    the level is on the boundary of the component around z̄.
    """
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(3, count))
    rays /= np.linalg.norm(rays, axis=0)
    center = design.z_bar[:, None]
    low = np.zeros(count)
    climbing = np.ones(count, dtype=bool)
    while climbing.any():
        ahead = low + 0.02
        climbing &= plain.V(center + ahead * rays) < certificate.level
        low = np.where(climbing, ahead, low)
    high = low + 0.02
    for _ in range(40):
        middle = (low + high) / 2
        inside = plain.V(center + middle * rays) < certificate.level
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    share = np.where(np.arange(count) % 2 == 0, 1 - 1e-9, rng.uniform(size=count) ** (1 / 3))
    return center + share * low * rays


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [((64,), (32,)), ((64, 64), (32, 32))], ids=["default", "deep"])
def test_no_solution_leaves_the_certified_region_and_all_converge(pendulum, sizes):
    design = solve(pendulum, Options(hidden_k=sizes[0], hidden_h=sizes[1]))
    certificate, plain = certify(design), PlainPendulum(design)
    assert certificate.certified
    assert_same_loop(design, plain)
    z = from_the_boundary_inwards(design, plain, certificate, STATES)
    assert all(certificate.contains(design.V, v) for v in z.T[::11])
    spectrum = np.linalg.eigvals(design.lyapunov.linearisation(design.z_bar))
    step = min(0.1, 1 / np.abs(spectrum).max())
    for batch in np.array_split(z, BATCHES, axis=1):
        assert_all_arrive(plain, batch, design.z_bar[:, None], step)


def assert_all_arrive(plain, z, z_bar, step):
    """V never rises, hence none leaves {V ≤ c}, and each comes to within 2 % of its distance."""
    near = 0.02 * np.linalg.norm(z - z_bar, axis=0)
    before = plain.V(z)
    for _ in range(int(HORIZON / step)):
        z = _rk4(plain.flow, z, step)
        value = plain.V(z)
        assert np.all(value <= before + ROUNDING)
        away = np.linalg.norm(z - z_bar, axis=0) > near
        z, before, near = z[:, away], value[away], near[away]
        if not away.any():
            break
    assert near.size == 0


def _rk4(f, z, h):
    k1 = f(z)
    k2 = f(z + h / 2 * k1)
    k3 = f(z + h / 2 * k2)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + h * k3))


def assert_same_loop(design, plain):
    """The plain formulas are those of the design."""
    z = np.random.default_rng(3).uniform(-1.5, 1.5, (3, 20))
    np.testing.assert_allclose(
        plain.flow(z), design.lyapunov.vector_field(z.T).T, atol=1e-9, rtol=1e-9
    )
    np.testing.assert_allclose(plain.V(z), [design.V(v) for v in z.T], atol=1e-9, rtol=1e-9)
