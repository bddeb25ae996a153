"""V in plain floating point over many points at once: a guide for the proofs, never one of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import LyapunovFunction

__all__ = ["Landscape", "Minima"]

#: Points per call of a mapped CasADi function.
_ROWS = 256
#: Newton steps at most, halvings of a step, and the decrease that Armijo's rule asks for.
_STEPS, _HALVINGS, _ARMIJO = 40, 12, 1e-4
#: A Newton step this short, in natural units, is rounding.
_STILL = 1e-11


@dataclass(frozen=True, eq=False)
class Minima:
    """ε(s) = argmin V(s, ·) and w(s) = V(s, ε(s)) at points s (B, ds)."""

    e: Vector  # (B, de)
    tangent: Vector  # (B, de, ds) dε/ds = −V_ee⁻¹V_es
    w: Vector  # (B,)
    grad: Vector  # (B, ds) ∇w = V_s
    hess: Vector  # (B, ds, ds) Schur complement V_ss − V_se V_ee⁻¹ V_es


@dataclass(frozen=True, eq=False)
class Landscape:
    """V in the active states y, the others at rest, split into y = (s, e)."""

    lyapunov: LyapunovFunction
    z_star: Vector  # (N,)
    active: tuple[int, ...]  # the states y, indices in z
    kept: tuple[int, ...]  # s, positions in y
    gone: tuple[int, ...]  # e, positions in y

    @cached_property
    def _functions(self) -> tuple[ca.Function, ca.Function]:
        y = ca.MX.sym("y", len(self.active))
        z = ca.MX.zeros(len(self.z_star))
        z[list(self.active)] = y
        V = self.lyapunov(z)
        hess, grad = ca.hessian(V, y)
        both = ca.Function("jet", [y], [V, grad, ca.densify(hess)])
        return ca.Function("V", [y], [V]).map(_ROWS), both.map(_ROWS)

    def values(self, Y: Vector) -> Vector:
        """V at points (B, d), (B,)."""
        return self._mapped(self._functions[0], Y)[0][:, 0]

    def jets(self, Y: Vector) -> tuple[Vector, Vector, Vector]:
        """V (B,), ∇V (B, d) and ∇²V (B, d, d) at points (B, d)."""
        d = len(self.active)
        V, grad, hess = self._mapped(self._functions[1], Y)
        return V[:, 0], grad, hess.reshape(-1, d, d)

    def _mapped(self, function: ca.Function, Y: Vector) -> list[Vector]:
        """Outputs of a function at points, each flattened to (B, size)."""
        count = function.n_out()
        parts: list[list[Vector]] = [[] for _ in range(count)]
        for first in range(0, len(Y), _ROWS):
            rows = Y[first : first + _ROWS]
            filled = np.concatenate([rows, np.repeat(rows[-1:], _ROWS - len(rows), 0)])
            found = function(filled.T)
            for k, value in enumerate(found if count > 1 else [found]):
                dense = np.asarray(value, float)
                blocks = dense.reshape(len(dense), _ROWS, -1).swapaxes(0, 1)
                parts[k].append(blocks.reshape(_ROWS, -1)[: len(rows)])
        if not len(Y):
            sizes = [function.numel_out(k) // _ROWS for k in range(count)]
            return [np.zeros((0, size)) for size in sizes]
        return [np.concatenate(part) for part in parts]

    def joined(self, s: Vector, e: Vector) -> Vector:
        """States y (B, d) from s (B, ds) and e (B, de)."""
        Y = np.empty((len(s), len(self.active)))
        Y[:, self.kept], Y[:, self.gone] = s, e
        return Y

    def states(self, s: Vector, e: Vector) -> Vector:
        """States z (B, N), the momenta at rest, from s (B, ds) and e (B, de)."""
        z = np.zeros((len(s), len(self.z_star)))
        z[:, list(self.active)] = self.joined(s, e)
        return z

    def minima(self, s: Vector, start: Vector | None = None) -> Minima:
        """ε, w and their derivatives at points s (B, ds), by Newton's method from `start` or ξ*."""
        e = np.repeat(self.z_star[list(self.active)][list(self.gone)][None], len(s), 0)
        e = e if start is None else start.copy()
        with np.errstate(all="ignore"):
            if self.gone:
                e = self._descended(s, e)
            V, grad, hess = self.jets(self.joined(s, e))
            ss, es, ee = (
                hess[:, rows][:, :, columns]
                for rows, columns in (
                    (self.kept, self.kept),
                    (self.gone, self.kept),
                    (self.gone, self.gone),
                )
            )
            tangent = -_solved(ee, es)
            w_hess = ss + np.swapaxes(es, 1, 2) @ tangent
        return Minima(e, tangent, V, grad[:, self.kept], w_hess)

    def _descended(self, s: Vector, e: Vector) -> Vector:
        gone = list(self.gone)
        active = np.arange(len(s))
        for _ in range(_STEPS):
            Y = self.joined(s[active], e[active])
            V, grad, hess = self.jets(Y)
            g = grad[:, gone]
            step = -_solved(hess[:, gone][:, :, gone], g[..., None])[..., 0]
            slope = (g * step).sum(1)
            length = np.ones(len(active))
            trial = e[active] + step
            for _ in range(_HALVINGS):
                reached = self.values(self.joined(s[active], trial))
                noise = 1e-13 * np.abs(V)
                bad = ~(reached <= V + _ARMIJO * length * slope + noise)
                if not bad.any():
                    break
                length[bad] /= 2
                trial = e[active] + length[:, None] * step
            e[active] = np.where(np.isfinite(trial), trial, e[active])
            active = active[np.abs(step).max(1, initial=0.0) > _STILL]
            if active.size == 0:
                break
        return e


def _solved(A: Vector, b: Vector) -> Vector:
    """A⁻¹b for stacks of symmetric matrices; NaN where one is singular."""
    if A.shape[-1] == 0:
        return np.zeros(b.shape)
    determinant = np.linalg.det(A)
    usable = np.isfinite(determinant) & (determinant != 0)
    safe = np.where(usable[:, None, None], A, np.eye(A.shape[-1]))
    return np.where(usable[:, None, None], np.linalg.solve(safe, b), np.nan)
