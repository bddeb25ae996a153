"""Inertia matrix and potential of a tree of rigid bodies, exactly.

The twist (ω, v) of each body along its own axes is passed down the tree,

    ω = Eᵀω₀ (+ a q̇),  v = Eᵀ(v₀ + ω₀ × r) (+ a q̇),  M = Σ m v_cᵀv_c + ωᵀIω,  V = Σ m g h_c

in polynomials of exp(±iq), so that M and V come out as sums of cosines and sines: a form that
is unique, and short where axes are parallel.

References
----------
Featherstone (2008), *Rigid Body Dynamics Algorithms*, chapters 2 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import sympy as sp
from sympy.polys.domains import QQ, QQ_I
from sympy.polys.rings import PolyElement, ring

__all__ = ["Body", "Motion", "inertia_and_potential"]


#: What a joint does about or along its axis.
Motion = Literal["turns", "slides"]


@dataclass(frozen=True, eq=False)
class Body:
    """A body and the joint that it hangs on; arrays are of rational numbers."""

    parent: int | None  # an earlier body; None: the ground
    motion: Motion | None  # about or along the axis; None: fixed
    rotation: Any  # 3 × 3, of its frame at q = 0 in the parent's
    offset: Any  # (3,), of its origin in the parent's frame
    axis: Any  # (3,), a unit vector in its own frame
    mass: sp.Expr
    centre: Any  # (3,), of mass, in its own frame
    inertia: Any  # 3 × 3, about the centre of mass, along its own axes


@dataclass(frozen=True, eq=False)
class _Frame:
    """A body's frame as it moves with q; vectors and Jacobians are along its own axes."""

    up: Any  # (3,)
    height: PolyElement  # of the origin
    turning: Any  # 3 × k: ω = turning q̇
    moving: Any  # 3 × k: v = moving q̇


def inertia_and_potential(
    bodies: Sequence[Body], q: Sequence[sp.Symbol], gravity: sp.Expr
) -> tuple[sp.Matrix, sp.Expr]:
    """M(q), k × k, and V(q) of a tree that stands on the ground, with the vertical along z.

    Parameters
    ----------
    bodies
        Parents stand before their children.
    q
        One coordinate for each body that turns or slides, in their order.
    gravity
        The acceleration g.

    Returns
    -------
    tuple
        Sums of cosines and sines with rational coefficients times the masses; V(0) = 0.
    """
    waves, coordinate = _Waves(q), 0
    frames: list[_Frame] = []
    M, V = sp.zeros(len(q)), sp.Integer(0) * gravity
    for body in bodies:
        last = waves.ground if body.parent is None else frames[body.parent]
        frame = waves.carried(last, body, coordinate)
        coordinate += body.motion is not None
        frames.append(frame)
        inertia, centre = waves.constant(body.inertia), waves.constant(body.centre)
        moving = frame.moving + _cross(frame.turning, centre)
        M += body.mass * waves.matrix(moving.T @ moving)
        M += waves.matrix(frame.turning.T @ inertia @ frame.turning)
        V += body.mass * gravity * waves.expression(frame.height + frame.up @ centre)
    return M.applyfunc(sp.expand), sp.expand(V - V.subs(dict.fromkeys(q, 0)))


def _cross(turning: Any, r: Any) -> Any:
    """ω × r for every column ω."""
    (a, b, c), (x, y, z) = turning, r
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x], dtype=object)


class _Waves:
    """Polynomials of exp(iq), exp(−iq) and q over the complex rationals, three unknowns per q."""

    def __init__(self, q: Sequence[sp.Symbol]) -> None:
        self.q = tuple(q)
        names = [f"{kind}{j}" for j in range(len(q)) for kind in ("forth", "back", "along")]
        self.ring, *self.unknowns = ring(names, QQ_I)
        still = self.constant(np.zeros((3, len(q)), dtype=int))
        self.ground = _Frame(self.constant([0, 0, 1]), self.ring.zero, still, still)

    def constant(self, numbers: Any) -> Any:
        """An array of rational numbers."""
        return self._each(lambda number: self.ring(QQ_I.from_sympy(sp.Rational(number))), numbers)

    def carried(self, last: _Frame, body: Body, j: int) -> _Frame:
        """The frame of a body from that of its parent; its joint moves with the j-th coordinate."""
        E, r = self.constant(body.rotation), self.constant(body.offset)
        axis = self.constant(body.axis)
        if body.motion == "turns":
            E = E @ self._turn(axis, j)
        elif body.motion == "slides":
            r = r + E @ axis * self.unknowns[3 * j + 2]
        turning = E.T @ last.turning
        moving = E.T @ (last.moving + _cross(last.turning, r))
        if body.motion is not None:
            (turning if body.motion == "turns" else moving)[:, j] += axis
        up, height = E.T @ last.up, self._short(last.height + last.up @ r)
        return _Frame(*(self._each(self._short, part) for part in (up, height, turning, moving)))

    def _turn(self, axis: Any, j: int) -> Any:
        """exp([a]× q) = I + sin q [a]× + (1 − cos q) [a]×²."""
        forth, back = self.unknowns[3 * j : 3 * j + 2]
        cos, sin = (forth + back) / 2, (back - forth) * QQ_I(0, 1) / 2
        skew = _cross(self.constant(np.eye(3, dtype=int)), -axis)
        return self.constant(np.eye(3, dtype=int)) + skew * sin + skew @ skew * (1 - cos)

    @staticmethod
    def _each(function: Any, values: Any) -> Any:
        return np.vectorize(function, otypes=[object])(values)

    def _short(self, value: PolyElement) -> PolyElement:
        """The same with exp(iq) exp(−iq) = 1."""
        terms: dict[tuple[int, ...], Any] = {}
        for powers, factor in value.terms():
            rest = list(powers)
            for j in range(0, len(rest), 3):
                pairs = min(rest[j : j + 2])
                rest[j], rest[j + 1] = rest[j] - pairs, rest[j + 1] - pairs
            terms[tuple(rest)] = terms.get(tuple(rest), QQ_I.zero) + factor
        return self.ring.from_dict(terms)

    def matrix(self, values: Any) -> sp.Matrix:
        """Real values, as sympy has them."""
        return sp.Matrix(values.shape[0], values.shape[1], list(map(self.expression, values.flat)))

    def expression(self, value: PolyElement) -> sp.Expr:
        """A real value: c exp(ik·q) and its conjugate are 2 Re c cos(k·q) − 2 Im c sin(k·q)."""
        result = sp.Integer(0)
        for powers, factor in self._short(value).terms():
            turns = [forth - back for forth, back in zip(powers[::3], powers[1::3], strict=True)]
            way = sp.Mul(*(x**power for x, power in zip(self.q, powers[2::3], strict=True)))
            real, imaginary = QQ.to_sympy(factor.x), QQ.to_sympy(factor.y)
            leading = next((turn for turn in turns if turn), 0)
            angle = sum((k * x for k, x in zip(turns, self.q, strict=True)), sp.Integer(0))
            if leading == 0:
                result += real * way
            elif leading > 0:
                result += 2 * way * (real * sp.cos(angle) - imaginary * sp.sin(angle))
        return result
