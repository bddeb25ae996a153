"""Quadratic parts just stiff enough for V to have one critical point, where the plant allows it.

With the momenta at rest and quadratic K and Hc of curvature κ in natural units,

    V_κ = H + λᵀ(c − c*) − λᵀ(∂c/∂ξ)*(ξ − ξ*) + ½κE (‖ξ − ξ*‖² + ‖c − c*‖²),

is quadratic in every state e but the few, s, on which ∇²H depends. Minimised over e it is a
function w_κ(s) of those: the plant's own potential and springs in series. Where

    ∇w_κ(s)ᵀ(s − s*) ≥ η E ‖s − s*‖²  for all s,

V_κ has no other critical point. That asks for far less stiffness than a V that is convex
everywhere, and for less of it than H's worst curvature where springs in series limit what
stiffness can do (docs/theory.md#the-whole-space). A certificate, not this search, says whether the
trained V has one critical point.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import Terms
from necc_casadi.model.samples import quasi_random
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.verdict.verdict import Verdict

__all__ = ["bent_states", "kappa_of_one_minimum"]


#: η: least growth along rays that quadratic parts alone must reach, for the networks to take away.
_GROWTH = 0.05


#: Samples of s, and how far they reach, in turns of an angle.
_SAMPLES, _TURNS = 4096, 1.5


#: The stiffest quadratic parts that are tried, and halvings of the interval that holds κ.
_STIFFEST, _HALVINGS = 64.0, 14


#: Newton steps to a member's minimum at most, and the slope at which it is reached, natural units.
_NEWTON, _STILL = 30, 1e-9


#: Least eigenvalue of ∇²V_κ(z*) in natural units, or this share of the most that is in reach.
_CURVED, _OF_REACH = 0.1, 0.5


def kappa_of_one_minimum(
    terms: Terms,
    scales: Sizes,
    verdict: Verdict,
    x_star: Vector,
    xi_star: Vector,
    angle: Vector,
    momenta: Sequence[int] = (),
    energies: Sequence[ca.Function] = (),
) -> float | None:
    """The least κ, in natural units, for which V_κ grows along every ray of samples from z*.

    Parameters
    ----------
    terms, scales
        Of the loop and its sizes, in training units.
    verdict
        Its λ is the slope of K at the target.
    x_star, xi_star
        z* (n,), (nc,).
    angle
        A radian of the model in training units, (n + nc,).
    momenta
        Plant states that are at rest.
    energies
        H of the members of a family: V_κ of each is to grow from its own minimum.

    Returns
    -------
    float or None
        None where no stiffness makes V_κ grow along every ray.
    """
    z_star = np.concatenate([x_star, xi_star])
    members = [
        _Reduced(terms, energy, scales, verdict, z_star, angle, momenta)
        for energy in (terms.H, *energies)
    ]
    top = min(reduced.curvature(_STIFFEST) for reduced in members)
    needed = min(_CURVED, _OF_REACH * top)

    def grows(kappa: float) -> bool:
        return all(
            reduced.curvature(kappa) >= needed and reduced.growth(kappa) >= _GROWTH
            for reduced in members
        )

    if top <= 0 or not grows(_STIFFEST):
        return None
    lower, upper = 0.0, _STIFFEST
    for _ in range(_HALVINGS):
        middle = np.sqrt(lower * upper) if lower else upper / 4
        lower, upper = (lower, middle) if grows(middle) else (middle, upper)
    return upper


class _Reduced:
    """V_κ minimised over the states in which it is quadratic, at samples of the others."""

    def __init__(
        self,
        terms: Terms,
        H: ca.Function,
        scales: Sizes,
        verdict: Verdict,
        z_star: Vector,
        angle: Vector,
        momenta: Sequence[int],
    ) -> None:
        z, kappa = ca.SX.sym("z", len(z_star)), ca.SX.sym("kappa")
        V = _quadratic_parts(terms, H, scales, verdict, z_star, z, kappa)
        active = [i for i in range(len(z_star)) if i not in momenta]
        block, grad, bends = _derivatives(V, z, active)
        self.kept = [k for k, i in enumerate(active) if bends[i]]
        self.gone = [k for k, i in enumerate(active) if not bends[i]]
        self.size = scales.state[active]
        self.energy, self.z_star, self.active = scales.energy, z_star, active
        self._hessian = ca.Function("hessian", [z, kappa], [block])
        self._gradient = ca.Function("gradient", [z, kappa], [grad])
        self._mapped = self._gradient.map(_SAMPLES)
        shares = 2 * quasi_random(_SAMPLES, len(self.kept), 0) - 1
        self.away = shares * (2 * np.pi * _TURNS * angle[active][self.kept])

    def curvature(self, kappa: float) -> float:
        """The least eigenvalue of ∇²V_κ at its minimum in natural units, momenta left out."""
        return self._least_curvature(self._minimum(kappa), kappa)

    def _least_curvature(self, z: Vector, kappa: float) -> float:
        hessian = np.asarray(self._hessian(z, kappa), float)
        relative = hessian * np.outer(self.size, self.size) / self.energy
        return float(np.linalg.eigvalsh(relative)[0])

    def _minimum(self, kappa: float) -> Vector:
        """Where V_κ has no slope, by Newton's method from z*: z* itself but for a member.

        The last point at which V_κ curves upwards, where the way ends before.
        """
        z, unit = self.z_star.copy(), self.energy / self.size
        for _ in range(_NEWTON):
            slope = np.asarray(self._gradient(z, kappa), float).ravel()
            if np.abs(slope / unit).max(initial=0.0) <= _STILL:
                break
            hessian = np.asarray(self._hessian(z, kappa), float)
            if self._least_curvature(z, kappa) <= 0:
                break
            z[self.active] -= np.linalg.solve(hessian, slope)
        return z

    def growth(self, kappa: float) -> float:
        """The least of ∇w_κᵀ(s − s*)/(E‖s − s*‖²) over the samples; −∞ where w_κ is not defined."""
        centre = self._minimum(kappa)
        hessian = np.asarray(self._hessian(centre, kappa), float)
        V_ee = hessian[np.ix_(self.gone, self.gone)]
        if len(V_ee) and np.linalg.eigvalsh(V_ee)[0] <= 0:
            return -np.inf
        if not self.kept:
            return np.inf
        kept, gone = ([self.active[k] for k in part] for part in (self.kept, self.gone))
        samples = np.repeat(centre[None], _SAMPLES, 0)
        samples[:, kept] += self.away
        slopes = np.asarray(self._mapped(samples.T, kappa), float).T
        if gone:  # one step of Newton's method: V_κ is quadratic in e
            samples[:, gone] -= np.linalg.solve(V_ee, slopes[:, self.gone].T).T
            slopes = np.asarray(self._mapped(samples.T, kappa), float).T
        along = (slopes[:, self.kept] * self.away).sum(1)
        square = ((self.away / self.size[self.kept]) ** 2).sum(1)
        return float(np.min(along / (self.energy * square)))


def bent_states(
    terms: Terms, scales: Sizes, verdict: Verdict, z_star: Vector, momenta: Sequence[int]
) -> list[int]:
    """The states on which ∇²V_κ depends, momenta at rest: V_κ is quadratic in the others."""
    z = ca.SX.sym("z", len(z_star))
    V = _quadratic_parts(terms, terms.H, scales, verdict, z_star, z, ca.SX(1))
    active = [i for i in range(len(z_star)) if i not in momenta]
    return [i for i in active if _derivatives(V, z, active)[2][i]]


def _derivatives(V: ca.SX, z: ca.SX, active: list[int]) -> tuple[ca.SX, ca.SX, list[bool]]:
    """∇²V and ∇V in the active states, and on which states the former depends."""
    hess, grad = ca.hessian(V, z)
    block = ca.densify(hess[active, active])
    return block, ca.densify(grad[active]), ca.which_depends(ca.vec(block), z, 1, False)


def _quadratic_parts(
    terms: Terms,
    H: ca.Function,
    scales: Sizes,
    verdict: Verdict,
    z_star: Vector,
    z: ca.SX,
    kappa: ca.SX,
) -> ca.SX:
    """V_κ of the module's head, with this energy of the plant; λ is that of the nominal one."""
    n, s = terms.n, ca.SX.sym("s", len(z_star))
    slope = ca.Function("dc", [s], [ca.jacobian(terms.c(s), s)])
    N = np.asarray(slope(z_star), float)
    c, c_star = terms.c(z), np.asarray(terms.c(z_star), float)
    reach = (np.abs(N) * scales.state).max(axis=1, initial=0.0)
    reach[reach == 0] = 1.0
    if verdict.lam is not None and len(verdict.lam) == terms.r:
        lam = to_floats(verdict.lam)
    else:
        force = np.asarray(terms.grad_H(z_star[:n]), float).ravel()
        lam = np.linalg.lstsq(N[:, :n].T, -force, rcond=None)[0]
    moved = z[n:] - ca.DM(z_star[n:])
    held = ca.dot(ca.DM(lam), c - c_star) - ca.dot(ca.DM(N[:, n:].T @ lam), moved)
    stretch = ca.sumsqr(moved / scales.state[n:]) + ca.sumsqr((c - c_star) / reach)
    result: ca.SX = H(z[:n]) + held + kappa * scales.energy / 2 * stretch
    return result
