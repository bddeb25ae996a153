"""A box that holds every critical point of V, and whether V is radially unbounded.

With the momenta at rest let V(y) = ½yᵀQy + lᵀy + b(y), Q ≻ 0 and |∂b| ≤ β for all y: the networks
without their quadratic parts, whose slopes absolute weights bound, and terms of H that are
periodic. Then every critical point lies in −Q⁻¹l ± |Q⁻¹|β, and V is radially unbounded; with the
momenta too, wherever their inertia is positive definite (docs/theory.md#the-whole-space).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.lyapunov.networks import Network
from necc_casadi.symbolic.zero import is_zero

__all__ = ["critical_box", "is_periodic", "periods"]

#: A little more than π: cells of a whole period.
_HALF_PERIOD = 3.15
#: Cells of the periodic states, in all.
_CELLS = 4096


def critical_box(potential: Potential) -> Interval | None:
    """The box (d,) of the active states; None where the form of V does not give one."""
    design, form = potential.design, potential.design.form
    symbols = [design.loop.z[i] for i in potential.active]
    slopes = sp.Matrix([[sp.diff(c, s) for s in symbols] for c in design.casimirs.functions])
    plain = form.phi is None and not form.betas and form.hc.quadratic and form.k.quadratic
    if not plain or slopes.free_symbols:
        return None
    quadratic, rest = _split(potential.energy, symbols)
    periodic = _periodic_slopes(rest, symbols)
    if periodic is None:
        return None
    of_hc, of_k = form.split(design.weights)[:2]
    N = _constant(slopes)
    E = point(np.eye(len(symbols))[len(symbols) - design.loop.controller.nc :])
    (kappa_k, centre_k), (kappa_h, centre_h) = (
        form.k.quadratic_part(of_k),
        form.hc.quadratic_part(of_hc),
    )
    at_zero = dict.fromkeys(symbols, 0)
    offset = _constant(sp.Matrix([c.subs(at_zero) for c in design.casimirs.functions]))[:, 0]
    linear = _constant(sp.Matrix([sp.diff(quadratic, s).subs(at_zero) for s in symbols]))[:, 0]
    Q = _constant(sp.hessian(quadratic, symbols))
    Q = Q + _sandwich(N, kappa_k) + _sandwich(E, kappa_h)
    pull_k = (point(kappa_k) * (offset - centre_k))[:, None]
    pull_h = (point(kappa_h) * centre_h)[:, None]
    linear = linear + (matmul(_transposed(N), pull_k) - matmul(_transposed(E), pull_h))[:, 0]
    if not positive_definite(Q[None])[0]:
        return None
    inverse = _inverse(Q)
    if inverse is None:
        return None
    steep = (
        matmul(_magnitude(matmul(inverse, _transposed(N))), _steepest(form.k, of_k)[:, None])
        + matmul(_magnitude(matmul(inverse, _transposed(E))), _steepest(form.hc, of_hc)[:, None])
        + matmul(_magnitude(inverse), point(periodic)[:, None])
    ).hi[:, 0]
    centre = -matmul(inverse, linear[:, None])[:, 0]
    return centre + Interval(-steep, steep)


def is_periodic(entries: Sequence[sp.Expr], symbol: sp.Symbol) -> bool:
    """Whether expressions are proved to have the period 2π in a symbol that they contain."""
    turning = (sp.sin, sp.cos)
    for entry in entries:
        inside = [f for f in entry.atoms(sp.Function) if f.has(symbol)]
        if not all(isinstance(f, turning) for f in inside):
            return False
        if not is_zero(entry.subs(symbol, symbol + 2 * sp.pi) - entry):
            return False
    return True


def periods(count: int) -> Interval:
    """Cells (B, count) of one period in each of some angles."""
    reach = np.full(count, _HALF_PERIOD)
    return subdivide(Interval(-reach, reach), max(8, int(_CELLS ** (1 / max(1, count)))))


def _split(energy: sp.Expr, symbols: Sequence[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """Terms of degree at most two, and the rest."""
    quadratic: sp.Expr = sp.Integer(0)
    rest: sp.Expr = sp.Integer(0)
    for term in sp.Add.make_args(sp.expand(energy)):
        low = term.is_polynomial(*symbols) and sp.Poly(term, *symbols).total_degree() <= 2
        quadratic, rest = (quadratic + term, rest) if low else (quadratic, rest + term)
    return quadratic, rest


def _periodic_slopes(rest: sp.Expr, symbols: Sequence[sp.Symbol]) -> Vector | None:
    """Upper bounds of |∂rest| for all states; None where a slope is not periodic, or has a pole."""
    bounds = np.zeros(len(symbols))
    for i, symbol in enumerate(symbols):
        slope = sp.diff(rest, symbol)
        used = sorted(slope.free_symbols, key=str)
        if not all(is_periodic([slope], s) for s in used):
            return None
        if slope != 0:
            cells = periods(len(used))
            bounds[i] = matrix_enclosure(sp.Matrix([[slope]]), used, cells).magnitude.max()
    return bounds if np.isfinite(bounds).all() else None


def _steepest(network: Network, weights: Vector) -> Interval:
    """|∂f/∂vⱼ| of a network without its quadratic part is at most this for every v, (d,)."""
    layers = network.layers(weights)
    bound = point(np.abs(layers[-1][0]))
    for W, _ in reversed(layers[:-1]):
        bound = matmul(bound, point(np.abs(W)))
    return point(bound.hi[0])


def _constant(matrix: sp.Matrix) -> Interval:
    return matrix_enclosure(matrix, [], point(np.zeros((1, 0))))[0]


def _transposed(A: Interval) -> Interval:
    return Interval(A.lo.T, A.hi.T)


def _magnitude(A: Interval) -> Interval:
    return point(A.magnitude)


def _sandwich(N: Interval, kappa: Vector) -> Interval:
    return matmul(_transposed(N), N * kappa[:, None])


def _inverse(Q: Interval) -> Interval | None:
    """Matrices that hold Q⁻¹: with T near it and E = I − TQ, (I − E)⁻¹T."""
    T = np.asarray(np.linalg.inv(Q.mid), float)
    excess = float(point((matmul(T, Q) - np.eye(len(T))).magnitude).sum().hi.max())
    if not excess < 0.5:
        return None
    slack = (point(2 * excess) * np.abs(T).max(0)).hi
    return Interval(T - slack, T + slack) + 0.0
