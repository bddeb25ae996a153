"""What V looks like at z*, seen through the 2-jets of its networks.

V depends on the weights θ, at z*, only through value, gradient and Hessian of each network at its
input there. With these jets y as variables of their own, ∇V(z*) and ∇²V(z*) are small expressions
that do not grow with the networks: V with each network replaced by its Taylor polynomial.

References
----------
Albersmeyer and Diehl (2010), lifted Newton methods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import Terms, value
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.sizes import Sizes

__all__ = ["Lifting"]


@dataclass(frozen=True, eq=False)
class _Jet:
    """Lifted 2-jet of one network at its input: value, gradient and upper Hessian."""

    base: ca.SX  # input of the network at z*, (d,), in the lifted variables
    y: ca.SX  # (1 + d + d(d + 1)/2,)

    def model(self, v: ca.SX) -> ca.SX:
        """The network's second-order Taylor polynomial around its input at z*."""
        d = self.base.numel()
        hessian = _symmetric(self.y[1 + d :], d)
        step = v - self.base
        return self.y[0] + ca.dot(self.y[1 : 1 + d], step) + ca.bilin(hessian, step, step) / 2


def _symmetric(upper: ca.SX, d: int) -> ca.SX:
    matrix = ca.SX(d, d)
    for index, (i, j) in enumerate(_upper(d)):
        matrix[i, j] = matrix[j, i] = upper[index]
    return matrix


def _upper(d: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(d) for j in range(i, d)]


def _jet_function(network: Network | MonotonePhi) -> ca.Function:
    """(weights, input) -> 2-jet of the network, in the layout of :class:`_Jet`."""
    w, v = ca.MX.sym("w", network.size), ca.MX.sym("v", network.inputs)
    f = network(w, v)
    hessian, gradient = ca.hessian(f, v)
    entries = [hessian[i, j] for i, j in _upper(network.inputs)]
    return ca.Function("jet", [w, v], [ca.vertcat(f, gradient, *entries)])


class Lifting:
    """Lifted variables (ξ*, y), ∇V(z*) and ∇²V(z*) in them, and their ties to the weights."""

    def __init__(
        self,
        terms: Terms,
        form: Form,
        x_star: Vector,  # (n,)
        scales: Sizes,
        guess: Vector,  # (nc,) where ξ* starts
    ) -> None:
        self.terms, self.form, self.x_star = terms, form, x_star
        self.scales, self.guess = scales, guess
        self.jet_functions = [_jet_function(network) for network in form.networks]
        self.xi = ca.SX.sym("xi", terms.nc)
        self.jets = self._lift()
        self.small = ca.vertcat(self.xi, *[jet.y for jet in self.jets])
        self.bases = ca.Function("bases", [self.small], [jet.base for jet in self.jets])
        self.g, self.N = self._derivatives()
        self.gradient_hessian = ca.Function("gN", [self.small], [self.g, self.N])
        self.sigma, self.tau = self._units()

    def _lift(self) -> list[_Jet]:
        """One jet per network, in the order of ``form.networks``."""
        form, z_star = self.form, ca.vertcat(ca.SX(self.x_star), self.xi)

        def jet(name: str, base: ca.SX) -> _Jet:
            d = base.numel()
            return _Jet(base, ca.SX.sym(name, 1 + d + d * (d + 1) // 2))

        hc, c = jet("hc", self.xi), self.terms.c(z_star)
        betas = [jet(f"beta{i + 1}", c[i]) for i in range(len(form.betas))]
        k = jet("k", sum((beta.y[0] for beta in betas), ca.SX(0)) if betas else c)
        jets = [hc, k, *betas]
        if form.phi is not None:
            energy = self.terms.H(ca.SX(self.x_star)) + hc.y[0]
            jets.append(jet("phi", ca.vertcat(energy, k.y[0])))
        return jets

    def _derivatives(self) -> tuple[ca.SX, ca.SX]:
        """∇V(z*) and ∇²V(z*) in the lifted variables."""
        hc, k, *rest = self.jets
        betas = rest[: len(self.form.betas)]

        def casimir(c: ca.SX) -> ca.SX:
            terms = (b.model(c[i]) for i, b in enumerate(betas))
            return k.model(sum(terms, ca.SX(0)) if betas else c)

        def outer(energy: ca.SX, C: ca.SX) -> ca.SX:
            phi = self.form.phi
            return energy + C if phi is None else rest[-1].model(ca.vertcat(energy, C))

        z = ca.SX.sym("z", self.terms.n + self.terms.nc)
        V = value(self.terms, z, hc.model, casimir, outer)
        N, g = ca.hessian(V, z)
        at_target = ca.vertcat(ca.SX(self.x_star), self.xi)
        gradient, hessian = ca.substitute([g, N], [z], [at_target])
        return gradient, hessian

    def _units(self) -> tuple[Vector, Vector]:
        """Weights = σ∘ŵ + τ: the networks see inputs and energies of order one."""
        z = ca.SX.sym("z", self.terms.n + self.terms.nc)
        slope = ca.Function("dc", [z], [ca.jacobian(self.terms.c(z), z)])
        sizes = np.abs(np.asarray(slope(np.concatenate([self.x_star, self.guess])), float))
        c_size = (sizes * self.scales.state).max(axis=1, initial=0.0)
        c_size[c_size == 0] = 1.0
        form, energy = self.form, self.scales.energy
        pairs = [form.hc.units(self.scales.state[self.terms.n :], energy)]
        pairs.append(form.k.units(np.ones(1) if form.betas else c_size, energy))
        pairs += [beta.units(c_size[i : i + 1], 1.0) for i, beta in enumerate(form.betas)]
        if form.phi is not None:
            pairs.append(form.phi.units(np.ones(2), energy))
        return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])

    def residuals(self, w: ca.MX, small: ca.MX) -> ca.MX:
        """Rows y − jet(θ, ξ*) that tie lifted variables to networks."""
        bases = self.bases.call([small])
        parts = self.form.split(w)
        jets = [f(p, b) for f, p, b in zip(self.jet_functions, parts, bases, strict=True)]
        return small[self.terms.nc :] - ca.vertcat(*jets)

    def jets_at(self, w: Vector, xi: Vector) -> Vector:
        """Lifted variables (ξ, y) that weights w imply at ξ* = xi."""
        parts = self.form.split(w)
        order = [
            0,
            *range(2, 2 + len(self.form.betas)),
            1,
            *range(2 + len(self.form.betas), len(parts)),
        ]
        starts = np.cumsum([self.terms.nc, *[jet.y.numel() for jet in self.jets]])
        small = np.concatenate([xi, np.zeros(starts[-1] - self.terms.nc)])
        for index in order:  # inner networks before those that take their values
            base = self.bases.call([small])[index]
            jet = self.jet_functions[index](parts[index], base)
            small[starts[index] : starts[index + 1]] = np.asarray(jet).ravel()
        return small

    def at(self, small: Vector) -> tuple[Vector, Vector]:
        """∇V(z*) (n + nc,) and ∇²V(z*) for numeric lifted variables."""
        g, N = self.gradient_hessian.call([small])
        return np.asarray(g, float).ravel(), np.asarray(N, float)

    def loss(self, w: Vector, xi: Vector, a: float | Vector) -> float:
        """ε of eq. Loss as the solver sees it, through the lifted variables that w and ξ* imply.

        a is a number, a diagonal, or the matrix that ∇²V(z*) is to exceed.

        Of a finished design, :mod:`necc_casadi.designs.error_bound` asks V itself.
        """
        g, N = self.at(self.jets_at(w, xi))
        asked = a if np.ndim(a) == 2 else a * np.eye(len(N))
        return float(np.linalg.norm(g) + max(0.0, -np.linalg.eigvalsh(N - asked)[0]))

    def small_at(self, w_hat: Vector, xi: Vector) -> Vector:
        """Lifted variables of dimensionless weights ŵ at ξ* = xi."""
        return self.jets_at(self.sigma * w_hat + self.tau, xi)

    def quadratic_only(self, kappa: Sequence[float]) -> Vector:
        """Lifted variables of V without its networks, quadratic parts with these κ."""
        w_hat = np.zeros(self.form.size)
        return self.small_at(self.centred(w_hat, self.guess, kappa), self.guess)

    def centred(self, w_hat: Vector, xi: Vector, kappa: Sequence[float]) -> Vector:
        """ŵ with the quadratic parts centred at the networks' inputs at z*, κ at least these."""
        w_hat = w_hat.copy()
        bases = self.bases.call([self.small_at(w_hat, xi)])
        parts, units = self.form.split(w_hat), self.form.split(self.sigma)
        networks = zip(self.form.networks, parts, units, bases, kappa, strict=True)
        for network, part, unit, base, least in networks:
            if isinstance(network, Network) and network.quadratic:
                d = network.inputs
                part[-d:] = np.asarray(base, float).ravel() / unit[-d:]
                part[-2 * d : -d] = np.maximum(part[-2 * d : -d], least)
        return w_hat
