"""Input limits: the largest level c_u ≤ c at which |u| provably stays within them on Ω.

u = −A∇Hc − [D B] 𝒢ᵀ∇V with A = Gcᵀ or α, and [D B] the first m rows of 𝒟. With s the momenta of
H = ½ sᵀA(y)s + U(y) and y the other states, V(y, s) ≥ V(y, 0) + ½ δ sᵀAs, so by Cauchy–Schwarz
{V ≤ c} holds |wᵀAs|² ≤ 2(c − V(y, 0)) wᵀAw/δ for every w: the share of the momenta in u is bounded
on each cell of y by the room that is left below c. A u₀ that is quadratic in the momenta,
u₀ = a(y) + b(y)ᵀs + ½ sᵀN(y)s, takes A⁻¹b off w, and |½ sᵀNs| ≤ (c − V(y, 0)) ρ with
ρ² = tr (A⁻¹N)², which no square of an eigenvalue of A⁻¹N exceeds (docs/theory.md#input-limits).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import solve
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, matmul, point
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.zero import sign

__all__ = [
    "highest_at_rest",
    "holding_level",
    "holds_everywhere",
    "input_level",
    "without_damping",
]


#: Rounds in which the cells that limit c_u are halved, and cells per round.
_ROUNDS, _WORST = 20, 512


#: Share of the range of an input that stays free at each end.
_STRICT = 1e-6


#: Share of the height above V(z̄) that is kept, so that other arithmetic can confirm it.
_EASED = 0.99


def input_level(
    potential: Potential, cells: Interval, ceiling: float, bottom: float
) -> float | None:
    """The largest proved c_u ≤ `ceiling` above `bottom`, an upper bound of V(z̄); or None.

    `cells` are boxes of y that cover the component, (B, active). Where momenta enter u otherwise
    than through wᵀAs and a quadratic u₀, nothing is claimed.
    """
    if not _covered(potential):
        return None
    levels = _levels(potential, cells)
    for _ in range(_ROUNDS):
        worst = np.argsort(levels)[:_WORST]
        if _eased(levels, bottom) >= ceiling:
            break
        pieces = _halved(cells[worst], cells)
        others = np.setdiff1d(np.arange(len(levels)), worst)
        levels = np.concatenate([levels[others], _levels(potential, pieces)])
        cells = concatenate(cells[others], pieces)
    level = min(_eased(levels, bottom), ceiling)
    return level if level > bottom else None


def holds_everywhere(design: Design) -> bool:
    """Whether u without its damping is a constant strictly within the limits."""
    loop, limits = design.loop, design.loop.plant.u_limits
    if limits is None or not loop.feedback.is_zero_matrix:
        return False
    ahead = loop.plant.preliminary
    u0 = [sp.Integer(0)] * loop.plant.m if ahead is None else list(ahead.u0)
    inside = (
        sign(u - sp.Rational(*lo.as_integer_ratio())) == 1
        and sign(sp.Rational(*hi.as_integer_ratio()) - u) == 1
        for u, (lo, hi) in zip(u0, limits, strict=True)
    )
    return not any(u.free_symbols for u in u0) and all(inside)


def holding_level(
    potential: Potential, cells: Interval, ceiling: float, bottom: float
) -> float | None:
    """The largest proved level up to which −A∇Hc is strictly within the limits of u.

    There clip(−y_c − Dw) = −y_c − ΣDw with 0 ≺ Σ ⪯ I diagonal, w = Gᵀ∂V/∂x, where D is diagonal,
    and else all of 𝒟 is scaled by one 0 < τ ≤ 1, so that whatever is said of the loop holds with
    inputs that are limited (docs/theory.md#clipped-inputs).
    """
    return input_level(without_damping(potential), cells, ceiling, bottom)


def without_damping(potential: Potential) -> Potential:
    """The same V with u = −A∇Hc, and limits that are strictly within those of the model."""
    design = potential.design
    m, damping = design.loop.plant.m, design.damping.copy()
    damping[:m] = 0.0
    limits = design.loop.plant.u_limits or ()
    inner = tuple((lo + _STRICT * (hi - lo), hi - _STRICT * (hi - lo)) for lo, hi in limits)
    plant = replace(design.loop.plant, u_limits=inner)
    held = replace(design, damping=damping, loop=replace(design.loop, plant=plant))
    return replace(potential, design=held)


def highest_at_rest(potential: Potential) -> float:
    """The level at which the momenta alone may take u to its limits, y being as at z̄.

    No level above it is ever proved, so that a search may begin there; -∞ where it is not known.
    """
    z_bar = potential.design.z_bar[None, list(potential.active)]
    return float(_levels(potential, point(z_bar))[0]) if _covered(potential) else -np.inf


def _eased(levels: Vector, bottom: float) -> float:
    return bottom + _EASED * (float(levels.min()) - bottom)


def _covered(potential: Potential) -> bool:
    """Whether momenta enter u through wᵀAs and a quadratic u₀ alone.

    A and 𝒢 are to be functions of the other states.
    """
    loop, resting = potential.design.loop, potential.resting
    if not resting:
        return True
    s = [loop.z[i] for i in resting]
    driven = _driven(potential)
    A = sp.hessian(loop.plant.H, s)
    moved = any(A.has(loop.z[i]) for i in driven)
    scaled = potential.design.form.phi is not None
    ahead = loop.plant.preliminary
    if ahead is not None and (ahead.u0.has(*s) or ahead.gain.has(*s)):
        bent = any(sp.hessian(u, s).has(*s) for u in ahead.u0)
        moved = moved or scaled or bent or ahead.gain.has(*s)
    return not (_used(potential).has(*s) or loop.feedback.has(*s) or moved or (driven and scaled))


def _used(potential: Potential) -> sp.ImmutableMatrix:
    """The columns of 𝒢 that u sees ∇V through: those of v, and of v_c where it is coupled."""
    loop, damping = potential.design.loop, potential.design.damping
    m = loop.plant.m
    columns = [j for j in range(len(damping)) if j < m or damping[:m, j].any()]
    return sp.ImmutableMatrix(sp.Matrix(loop.ports)[:, columns])


def _driven(potential: Potential) -> list[int]:
    """The states that are no momenta along which u sees ∇V."""
    used = _used(potential)
    return [i for i in potential.active if any(used[i, :])]


def _halved(boxes: Interval, like: Interval) -> Interval:
    """Each box cut across its side that is the longest against the first cells."""
    sides = boxes.hi - boxes.lo
    axis = np.argmax(sides / (like.hi - like.lo).max(0), axis=1)
    rows = np.arange(len(axis))
    middle = boxes.mid[rows, axis]
    lo, hi = boxes.lo.copy(), boxes.hi.copy()
    lo[rows, axis], hi[rows, axis] = middle, middle
    return concatenate(Interval(boxes.lo, hi), Interval(lo, boxes.hi))


def _levels(potential: Potential, cells: Interval) -> Vector:
    """Level below which u stays within its limits on each cell; −∞ where nothing is known, (B,)."""
    with np.errstate(all="ignore"):
        jet = potential.sharp_jet(cells) if potential.has_sharp_jet else potential.jet(cells)
        given = _controller_output(potential, cells) + _passive_output(potential, cells, jet.grad)
        rest = _fed_ahead(potential, cells, -given)
        swing, bend = _momentum_gain(potential, cells), _momentum_bend(potential, cells)
        lo, hi = np.array(potential.design.loop.plant.u_limits, float).T
        room = Interval(np.minimum((hi - rest).lo, (rest - lo).lo), np.full(rest.shape, np.inf))
        margin = np.where(room.lo >= 0, room.lo, np.nan)
        height = _height(margin, swing, bend)
        height = np.where((swing.hi <= 0) & (bend <= 0) & (margin >= 0), np.inf, height)
        height = np.where(room.lo < 0, 0.0, height).min(-1)  # such a cell must stay out of reach
        bottom = jet.value.lo
        level = np.where(np.isinf(height), np.inf, (point(bottom) + point(height)).lo)
    return np.where(np.isfinite(bottom) & ~np.isnan(height), level, -np.inf)


def _height(margin: Vector, swing: Interval, bend: Vector) -> Vector:
    """The largest h, rounded down, with √(swing h) + bend h ≤ margin; (B, m)."""
    steepest = point(swing.hi)
    root = (steepest + point(bend) * point(margin) * 4.0).sqrt() + steepest.sqrt()
    return np.asarray((point(margin) * 2.0 / point(root.hi)).square().lo, float)


def _fed_ahead(potential: Potential, cells: Interval, given: Interval) -> Interval:
    """U = u₀ + Bũ of ũ, (B, m)."""
    loop = potential.design.loop
    if loop.plant.preliminary is None:
        return given
    symbols = [loop.z[i] for i in potential.active]
    at_rest = loop.plant.preliminary.u0.subs({loop.z[i]: 0 for i in potential.resting})
    u0 = matrix_enclosure(sp.Matrix(at_rest), symbols, cells)[..., 0]
    gain = matrix_enclosure(sp.Matrix(loop.plant.preliminary.gain), symbols, cells)
    return u0 + matmul(gain, given[..., None])[..., 0]


def _controller_output(potential: Potential, cells: Interval) -> Interval:
    """A∇Hc, (B, m)."""
    design, loop = potential.design, potential.design.loop
    controller = loop.controller
    xi = cells[:, -controller.nc :]
    ends = np.concatenate([xi.lo, xi.hi], axis=1)
    unique, inverse = np.unique(ends, axis=0, return_inverse=True)
    boxes = Interval(unique[:, : controller.nc], unique[:, controller.nc :])
    weights = design.form.split(design.weights)[0]
    slope = network_jet(design.form.hc, weights, boxes).grad[inverse.ravel()]
    symbols = [loop.z[i] for i in potential.active]
    gain = matrix_enclosure(sp.Matrix(loop.feedback), symbols, cells)
    return matmul(gain, slope[..., None])[..., 0]


def _passive_output(potential: Potential, cells: Interval, gradient: Interval) -> Interval:
    """[D B] 𝒢ᵀ∇V at rest, in ũ, without the momenta, (B, m); ∂V/∂ξ does not depend on them."""
    driven = set(_driven(potential))
    rows = [k for k, i in enumerate(potential.active) if i in driven]
    damped = _damped(potential, [potential.active[k] for k in rows], cells)
    return matmul(damped, gradient[:, rows][..., None])[..., 0]


def _momentum_gain(potential: Potential, cells: Interval) -> Interval:
    """2Φ₁² wᵀAw/δ for the rows w of D Gᵀ at the momenta: u moves by √(this · room), (B, m).

    With what u₀ has of the first power of the momenta, bᵀs, w is less by A⁻¹b.
    """
    loop, resting, m = potential.design.loop, potential.resting, potential.design.loop.plant.m
    if not resting:
        return point(np.zeros((cells.shape[0], m)))
    A = sp.hessian(loop.plant.H, [loop.z[i] for i in resting])
    w = _damped(potential, resting, cells)
    if loop.plant.preliminary is not None:
        symbols = [loop.z[i] for i in potential.active]
        w = matmul(matrix_enclosure(sp.Matrix(loop.plant.preliminary.gain), symbols, cells), w)
    stiff = matrix_enclosure(A, [loop.z[i] for i in potential.active], cells)
    product = (matmul(w, stiff) * w).sum()
    fed = _powers_of_momenta(potential)[0]
    if not fed.is_zero_matrix:
        linear = matrix_enclosure(fed, [loop.z[i] for i in potential.active], cells)
        columns = Interval(np.swapaxes(linear.lo, -1, -2), np.swapaxes(linear.hi, -1, -2))
        moved = solve(stiff, columns)
        turned = Interval(np.swapaxes(moved.lo, -1, -2), np.swapaxes(moved.hi, -1, -2))
        product = product - (w * linear).sum() * 2.0 + (turned * linear).sum()
    product = Interval(np.maximum(product.lo, 0.0), product.hi)  # A ≻ 0 on the domain
    form = potential.design.form
    if form.phi is None:
        return product * 2.0
    a, b, _, _ = np.split(form.split(potential.design.weights)[-1], 4)
    delta = float(form.phi.delta)
    steepest = (point(a) + point(b)).exp().sum() + delta
    return product * steepest.square() * 2.0 / delta


def _momentum_bend(potential: Potential, cells: Interval) -> Vector:
    """Bounds ρ of |sᵀNs|/sᵀAs, (B, m): u₀ = … + ½ sᵀNs moves by ρ · room."""
    loop, resting = potential.design.loop, potential.resting
    bends = _powers_of_momenta(potential)[1]
    found = np.zeros((cells.shape[0], loop.plant.m))
    symbols = [loop.z[i] for i in potential.active]
    for k, N in enumerate(bends):
        if N.is_zero_matrix:
            continue
        A = sp.hessian(loop.plant.H, [loop.z[i] for i in resting])
        share = solve(matrix_enclosure(A, symbols, cells), matrix_enclosure(N, symbols, cells))
        crossed = share * Interval(np.swapaxes(share.lo, -1, -2), np.swapaxes(share.hi, -1, -2))
        trace = crossed.sum().sum()
        found[:, k] = Interval(np.maximum(trace.lo, 0.0), trace.hi).sqrt().hi
    return found


def _powers_of_momenta(potential: Potential) -> tuple[sp.Matrix, list[sp.Matrix]]:
    """Rows b (m, s) and matrices N (s, s) of u₀ = a(y) + b(y)ᵀs + ½ sᵀN(y)s."""
    loop, ahead = potential.design.loop, potential.design.loop.plant.preliminary
    s = [loop.z[i] for i in potential.resting]
    if ahead is None or not s:
        return sp.zeros(loop.plant.m, len(s)), []
    rest = dict.fromkeys(s, 0)
    b = sp.Matrix(ahead.u0).jacobian(s).subs(rest)
    return b, [sp.Matrix(sp.hessian(u, s)).subs(rest) for u in ahead.u0]


def _damped(potential: Potential, states: Sequence[int], cells: Interval) -> Interval:
    """[D B] 𝒢ᵀ at some of the states, (B, m, states)."""
    design, m = potential.design, potential.design.loop.plant.m
    ports = sp.Matrix(design.loop.ports)[list(states), :]
    symbols = [design.loop.z[i] for i in potential.active]
    return matmul(design.damping[:m], matrix_enclosure(sp.Matrix(ports.T), symbols, cells))
