"""How far V over a level is off in the exported arithmetic: the room that the code leaves for it.

Each value is carried with its interval and a bound of its error, in the order of the operations of
the code; sums of networks may be taken in any order. u is half the spacing of the numbers next to
1; functions of the C library are within 2 spacings, those of the networks within 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.integral_margin import IntegralMargin
from necc_casadi.export.level_set import LevelSet
from necc_casadi.lyapunov.networks import Network

__all__ = ["integral_rounding", "level_rounding", "network_rounding", "rounded_values"]


#: Errors of functions in u, of the C library and of the networks' own.
_LIBRARY, _OWN = 4.0, 8.0


#: Over the bound: terms of second order.
_SECOND = 1.01


#: Rates are looked at up to this multiple of the level, over samples of the inertia.
_RATES, _SAMPLES, _BETWEEN = 2.0, 64, 1.5


@dataclass(frozen=True)
class _Value:
    """An interval, and how far the computed value is from the exact one at most."""

    lo: float
    hi: float
    error: float = 0.0

    @property
    def size(self) -> float:
        """The largest absolute value."""
        return max(abs(self.lo), abs(self.hi))


def level_rounding(found: LevelSet, real: Real) -> float:
    """|computed − exact| of V above its value at rest, in the box where V ≤ level; energy.

    ∞ where the energy has an operation of which no bound is known.
    """
    u, made, k = real.eps / 2, found.design, found.k
    half, (low, high), (least, most, _) = found.half, found.sides, found.told
    q = np.stack([found.q_star - half[:k], found.q_star + half[:k]], axis=1)
    turned = 4 * u * (np.abs(q).max(1) + np.maximum(np.abs(low), np.abs(high)))
    at, r = ca.SX.sym("at", 2 * k), ca.SX.sym("r", k)
    theta = ca.SX.sym("theta", len(least))
    energy = found.energy(at, r, theta)
    sides = [*zip(low, high, strict=True), *zip(least, most, strict=True)]
    rates = _rates(ca.Function("E", [at, r, theta], [energy]), k, q, sides, found.level)
    seen = [_Value(a, b, e) for (a, b), e in zip(q.tolist(), turned.tolist(), strict=True)]
    others = [*np.stack([-rates, rates], axis=1), *sides]
    given = [*seen, *(_Value(float(a), float(b)) for a, b in others)]
    (E,) = rounded_values(ca.Function("E", [at, r, theta], [energy]), given, u)
    return _with_networks(made, E, seen, made.xi_star, half[k:], found.rest, found.level, u)


def integral_rounding(found: IntegralMargin, real: Real) -> float:
    """|computed − exact| of W in the box where W ≤ level, energy; ∞ where no bound is known."""
    u, made, k, half = real.eps / 2, found.design, found.k, found.half
    q = np.stack([found.q_star - half[:k], found.q_star + half[:k]], axis=1)
    rates = np.zeros(k)
    for i in range(found.known.numel_out(0)):
        x = ca.SX.sym("x", 2 * k)
        one = ca.Function("W", [x], [found.known(x)[i]])
        rates = np.maximum(rates, _rates(one, k, q, [], found.level))
    rates = rates + half[:k] / found.integral.tau
    seen = [_Value(float(a), float(b)) for a, b in q]
    parts = rounded_values(found.known, [*seen, *(_Value(-v, v) for v in rates)], u)
    worst = max(parts, key=lambda v: v.error)
    low, high = found.resting
    reach = np.maximum(np.abs(low), np.abs(high)) + found.integral.limit
    zeta = float((found.weight * reach**2).sum())
    E = _Value(-worst.size - zeta, worst.size + zeta, worst.error + 8 * u * zeta)
    return _with_networks(made, E, seen, found.xi_bar, half[k:], found.rest, found.level, u)


def _with_networks(
    made: Design, energy: _Value, q: Sequence[_Value], xi_star: Vector, half: Vector, rest: float,
    level: float, u: float,
) -> float:  # fmt: skip
    """The bound for a closed form and the networks in a box of (q, ξ)."""
    k, nc = len(q), len(half)
    x, s = ca.SX.sym("q", k), ca.SX.sym("s", nc)
    z = ca.vertcat(x, ca.SX(k, 1), s)
    inner = [_Value(a, b) for a, b in zip((xi_star - half).tolist(), (xi_star + half).tolist(),
                                          strict=True)]  # fmt: skip
    casimirs = ca.Function("c", [x, s], [made.lyapunov.terms.c(z)])
    c = rounded_values(casimirs, [*q, *inner], u)
    form, weights = made.form, made.form.split(made.weights)
    hc = network_rounding(form.hc, weights[0], inner, u)
    kc = network_rounding(form.k, weights[1], c, u)
    sums = energy.size + 2 * (hc.size + kc.size) + 2 * abs(rest) + level
    return _SECOND * (energy.error + hc.error + kc.error + 4 * u * sums)


def _rates(
    energy: ca.Function, k: int, q: Vector, sides: Sequence[tuple[float, float]], level: float
) -> Vector:
    """Largest |q̇| with an energy of motion of so many levels, (k,), over samples of the rest.

    `energy` takes (q, q̇) first, and what else has `sides`.
    """
    rng = np.random.default_rng(0)
    given = [ca.SX.sym(f"a{i}", *energy.size_in(i)) for i in range(energy.n_in())]
    slopes = ca.hessian(energy.call(given)[0], given[0])[0][k:, k:]
    inertia = ca.Function("M", [ca.vertcat(*(ca.vec(a) for a in given))], [slopes])
    ends, largest = np.array([*q, *np.zeros((k, 2)), *sides], float).reshape(-1, 2), np.zeros(k)
    for _ in range(_SAMPLES):
        M = np.asarray(inertia(rng.uniform(*ends.T)), float)
        largest = np.maximum(largest, np.diagonal(np.linalg.inv(M)))
    return np.asarray(_BETWEEN * np.sqrt(2 * _RATES * level * largest), float)


# --- closed forms ---------------------------------------------------------------------------------


def rounded_values(function: ca.Function, given: Sequence[_Value], u: float) -> list[_Value]:
    """The outputs of an SX function over intervals, entry by entry, with bounds of their errors."""
    arguments = [ca.SX.sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
    flat = ca.vertcat(*(ca.vec(a) for a in arguments))
    outputs = ca.vertcat(*(ca.densify(ca.vec(v)) for v in function.call(arguments)))
    plain = ca.Function("plain", [flat], [outputs])
    work: dict[int, _Value] = {}
    found = [_Value(0.0, 0.0)] * plain.numel_out(0)
    for i in range(plain.n_instructions()):
        code = plain.instruction_id(i)
        inputs, targets = plain.instruction_input(i), plain.instruction_output(i)
        if code == ca.OP_OUTPUT:
            found[targets[1]] = work[inputs[0]]
        elif code == ca.OP_INPUT:
            work[targets[0]] = given[inputs[1]]
        elif code == ca.OP_CONST:
            v = plain.instruction_constant(i)
            work[targets[0]] = _Value(v, v, u * abs(v))
        else:
            work[targets[0]] = _operated(code, [work[j] for j in inputs], u)
    return found


def _operated(code: int, given: Sequence[_Value], u: float) -> _Value:
    a, b = given[0], given[-1]
    if code in (ca.OP_ADD, ca.OP_TWICE):
        return _rounded(a.lo + b.lo, a.hi + b.hi, a.error + b.error, u)
    if code == ca.OP_SUB:
        return _rounded(a.lo - b.hi, a.hi - b.lo, a.error + b.error, u)
    if code == ca.OP_NEG:
        return _Value(-a.hi, -a.lo, a.error)
    if code in (ca.OP_MUL, ca.OP_SQ):
        ends = [p * q for p in (a.lo, a.hi) for q in (b.lo, b.hi)]
        error = a.size * b.error + b.size * a.error + a.error * b.error
        return _rounded(min(ends), max(ends), error, u)
    if code in (ca.OP_DIV, ca.OP_INV) and (b.lo - b.error > 0 or b.hi + b.error < 0):
        top = _Value(1.0, 1.0) if code == ca.OP_INV else a
        ends = [p / q for p in (top.lo, top.hi) for q in (b.lo, b.hi)]
        least = min(abs(b.lo), abs(b.hi)) - b.error
        error = (top.error + max(map(abs, ends)) * b.error) / least
        return _rounded(min(ends), max(ends), error, u)
    if code in (ca.OP_SIN, ca.OP_COS):
        return _Value(-1.0, 1.0, a.error + _LIBRARY * u)
    if code == ca.OP_SQRT and a.lo - a.error > 0:
        root = np.sqrt([a.lo, a.hi])
        return _rounded(float(root[0]), float(root[1]), a.error / (2 * float(root[0])), 2 * u)
    if code == ca.OP_EXP:
        most = float(np.exp(a.hi + a.error))
        return _Value(float(np.exp(a.lo)), most, most * (a.error + _LIBRARY * u))
    return _Value(-np.inf, np.inf, np.inf)


def _rounded(lo: float, hi: float, error: float, u: float) -> _Value:
    return _Value(lo, hi, error + u * (max(abs(lo), abs(hi)) + error))


# --- networks -------------------------------------------------------------------------------------


def network_rounding(
    network: Network, weights: Vector, given: Sequence[_Value], u: float
) -> _Value:
    """The value of a network at inputs in intervals, with a bound of its error."""
    size = np.array([v.size for v in given])
    error = np.array([v.error for v in given])
    layers = network.layers(weights)
    for index, (W, b) in enumerate(layers):
        terms = np.abs(W) @ size + np.abs(b)
        error = np.abs(W) @ error + (W.shape[1] + 10) * u * (terms + np.abs(W) @ error)
        size = terms + error
        if index < len(layers) - 1:
            if network.activation == "squareplus":
                size = size + 1
                error = error + _OWN * u * size
            else:
                size, error = np.ones_like(size), error + _OWN * u
    total, off = float(size[0]), float(error[0])
    if network.quadratic:
        kappa, center = network.quadratic_part(weights)
        pairs = zip(given, center, strict=True)
        far = np.array([max(abs(v.lo - o), abs(v.hi - o)) for v, o in pairs])
        wrong = np.array([v.error for v in given]) + 2 * u * (far + np.abs(center))
        more = kappa * far**2 / 2
        total += float(more.sum())
        off += float((kappa * (far * wrong + wrong**2)).sum()) + (len(kappa) + 6) * u * total
    return _Value(-total, total, off)
