"""How far the C code's u and ξ̇ are from the law, over a box: running errors in its own order.

u is half the spacing of the numbers next to 1. A program is followed step by step, each value in an
interval and with a bound of its error; the networks by the order of their sums.

References
----------
docs/theory.md#rounding-noise-and-delay. Higham (2002), chapters 3 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.rounding import (
    ACTIVATIONS,
    CONSTANTS,
    LIBRARY,
    MOST_SINE,
    Number,
    Program,
    Step,
)
from necc_casadi.certificate.prover.arithmetic.boxes import hull, subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.jets import Jet
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.certificate.prover.sampled.measured import Measured
from necc_casadi.designs.design import Design
from necc_casadi.designs.law import law_of
from necc_casadi.lyapunov.networks import Network

__all__ = ["Rounding", "gradient_rounding", "programs", "rounded", "unit"]


#: More than what is left out of second order, and by the roundings of these bounds.
_SECOND = 1 + 1e-3
#: Pieces of a box of a network's inputs along each side, by their number.
_PIECES = {1: 256, 2: 16, 3: 6}

#: Names of the operations.
_BINARY = {ca.OP_ADD: "add", ca.OP_SUB: "sub", ca.OP_MUL: "mul", ca.OP_DIV: "div"}
_UNARY = {
    ca.OP_NEG: "neg", ca.OP_SQ: "square", ca.OP_SQRT: "sqrt", ca.OP_SIN: "sin", ca.OP_COS: "cos",
    ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh", ca.OP_EXP: "exp", ca.OP_LOG: "log",
}  # fmt: skip


def unit(number: Number) -> tuple[float, float]:
    """(u, the least normal number) of a type."""
    info = np.finfo(np.float32 if number == "float" else np.float64)
    return float(info.eps) / 2, float(info.tiny)


def programs(design: Design) -> tuple[Program, Program] | None:
    """(y, ξ) -> c and (y, ξ, ∇Hc, ∇K) -> (u, ξ̇) of the C code; None: one is not covered."""
    law = law_of(design)
    seen = [law.x, law.s]
    first = _program(seen, law.casimirs)
    second = _program([*seen, law.grad_hc, law.gamma], ca.vertcat(law.u, law.rate))
    return None if first is None or second is None else (first, second)


def _program(arguments: Sequence[ca.SX], result: ca.SX) -> Program | None:
    """The operations in the order of the C code; None: one is not covered."""
    function = ca.Function("program", arguments, [ca.densify(ca.vec(result))])
    starts = np.cumsum([0, *(a.numel() for a in arguments)]).tolist()
    outputs = [0] * function.numel_out(0)
    held: dict[int, int] = {}  # work vector: the place of what it holds now
    steps: list[Step] = []

    def add(name: str, places: Sequence[int], constant: float = 0.0) -> int:
        steps.append((name, tuple(places), constant))
        return int(starts[-1]) + len(steps) - 1

    for i in range(function.n_instructions()):
        code = function.instruction_id(i)
        taken, made = function.instruction_input(i), function.instruction_output(i)
        if code == ca.OP_INPUT:
            held[made[0]] = int(starts[taken[0]]) + taken[1]
        elif code == ca.OP_OUTPUT:
            outputs[made[1]] = held[taken[0]]
        elif code == ca.OP_CONST:
            held[made[0]] = add("const", (), float(function.instruction_constant(i)))
        elif code in _BINARY:
            held[made[0]] = add(_BINARY[code], [held[k] for k in taken])
        elif code == ca.OP_TWICE:
            held[made[0]] = add("add", [held[taken[0]]] * 2)
        elif code == ca.OP_INV:
            held[made[0]] = add("div", [add("const", (), 1.0), held[taken[0]]])
        elif code in _UNARY:
            held[made[0]] = add(_UNARY[code], [held[taken[0]]])
        else:
            return None
    return Program(int(starts[-1]), tuple(steps), tuple(outputs))


@dataclass(frozen=True)
class _Value:
    """An interval, (1,), and how far the computed value is from the exact one at most."""

    range: Interval
    error: float

    @property
    def size(self) -> float:
        """Of the exact value, at most."""
        return float(self.range.magnitude[0])


def rounded(
    program: Program, given: Sequence[tuple[float, float]], errors: Sequence[float], number: Number
) -> tuple[Interval, Vector]:
    """A program over intervals (lo, hi) of its inputs, with errors: its outputs (k,), and theirs.

    The errors are infinite where no bound is known.
    """
    (u, tiny), ends = unit(number), zip(given, errors, strict=True)
    known = [_Value(Interval(np.array([lo]), np.array([hi])), e) for (lo, hi), e in ends]
    with np.errstate(all="ignore"):
        for name, places, constant in program.steps:
            if name == "const":
                off = (u + CONSTANTS) * abs(constant) + tiny
                known.append(_Value(point(np.array([constant])), off))
            else:
                known.append(_applied(name, [known[k] for k in places], u, tiny))
    found = [known[k] for k in program.outputs]
    lo, hi = ([float(getattr(v.range, end)[0]) for v in found] for end in ("lo", "hi"))
    bounds = np.array([v.error for v in found]) * _SECOND
    return Interval(np.array(lo), np.array(hi)), np.where(np.isnan(bounds), np.inf, bounds)


def _applied(name: str, given: Sequence[_Value], u: float, tiny: float) -> _Value:
    a, b = given[0], given[-1]
    if name == "neg":
        return _Value(-a.range, a.error)
    times = 1.0
    if name == "add":
        value, error = a.range + b.range, a.error + b.error
    elif name == "sub":
        value, error = a.range - b.range, a.error + b.error
    elif name in ("mul", "square"):
        value = a.range.square() if name == "square" else a.range * b.range
        error = a.size * b.error + b.size * a.error + a.error * b.error
    elif name == "div":
        value = a.range / b.range
        least = _least(b)
        size = float(value.magnitude[0])
        error = (a.error + size * b.error) / least if least > 0 else np.inf
    else:
        wide = Interval(a.range.lo - a.error, a.range.hi + a.error)
        value = getattr(a.range, name)()
        error = a.error * _steepness(name, wide)
        times = 1.0 if name == "sqrt" else 2 * LIBRARY
    size = float(value.magnitude[0]) + error
    return _Value(value, error + times * (u * size + tiny))


def _least(v: _Value) -> float:
    """A lower bound of the absolute value that was computed."""
    return float(max(v.range.lo[0], -v.range.hi[0])) - v.error


def _steepness(name: str, v: Interval) -> float:
    """A bound of the derivative over an interval (1,)."""
    if name in ("sin", "cos", "tanh", "atan", "asinh"):
        return 1.0
    slopes = {
        "sqrt": lambda: 0.5 / v.sqrt(),
        "tan": lambda: 1.0 + v.tan().square(),
        "asin": lambda: 1.0 / (1.0 - v.square()).sqrt(),
        "acos": lambda: 1.0 / (1.0 - v.square()).sqrt(),
        "sinh": lambda: v.cosh(),
        "cosh": lambda: v.sinh(),
        "acosh": lambda: 1.0 / (v.square() - 1.0).sqrt(),
        "atanh": lambda: 1.0 / (1.0 - v.square()),
        "exp": lambda: v.exp(),
        "log": lambda: 1.0 / v,
    }
    found = slopes[name]().magnitude[0]
    return float(found) if np.isfinite(found) else np.inf


def gradient_rounding(
    network: Network, weights: Vector, size: Vector, number: Number
) -> tuple[Vector, Vector]:
    """|computed − exact| of a network's gradient where |v| ≤ size (d,), and of the exact one: (d,).

    v is what the code takes for its input.
    """
    (u, tiny), errors = unit(number), ACTIVATIONS[network.activation, number]
    (W, b), *others = network.layers(weights)
    d, wide = W.shape[1], network.activation == "squareplus"
    W, value_error = np.abs(W), 2 * u * errors.value
    total = np.zeros(d)
    off = np.zeros(d)
    if not others:
        total, off = W[0].copy(), u * W[0]
    else:
        a = W @ size + np.abs(b)  # |argument|, its error, |∂/∂v| and its error
        delta = (d + 3) * u * a + 2 * (d + 1) * tiny
        slope, slope_off = W.copy(), u * W
        t, t_off = a, delta
        for index, (V, c) in enumerate(others):
            if network.activation == "sin" and (a > MOST_SINE).any():
                return np.full(d, np.inf), np.full(d, np.inf)
            bent = 2 * u * errors.slope + errors.curvature * delta  # of σ′
            slope_off = slope_off + (bent[:, None] + u) * (slope + slope_off) + 2 * tiny
            t = a + 1 if wide else np.ones_like(a)
            t_off = delta + value_error * (t if wide else 1.0) + tiny
            V, last, columns = np.abs(V), index == len(others) - 1, 16 * -(-V.shape[1] // 16)
            gamma = ((columns // 16 + 7) if last else (columns // 4 + 6)) * u
            slope_off = V @ slope_off + gamma * (V @ (slope + slope_off))
            slope_off = slope_off + 2 * columns * tiny
            slope = V @ slope
            a = V @ t + np.abs(c)
            delta = V @ t_off + gamma * (V @ (t + t_off) + np.abs(c)) + 2 * columns * tiny
        total, off = slope[0], slope_off[0]
    if network.quadratic:
        kappa, center = network.quadratic_part(weights)
        part = kappa * (size + np.abs(center))
        off = off + u * (6 * part + total) + 4 * tiny
        total = total + part
    return off * _SECOND, total


@dataclass(frozen=True, eq=False)
class Rounding:
    """The rounding of a design's code; natural units outside."""

    design: Design  # in the units of its model
    number: Number
    casimirs: Program
    law: Program

    def over(self, Y: Interval) -> tuple[Vector, Vector]:
        """Bounds of |computed − exact| of u (m,) and ξ̇ (nc,) over a box (N,) of (y, ξ)."""
        design, units = self.design, self.design.units
        n, m = design.loop.plant.n, design.loop.plant.m
        size = Measured(design).units
        lo, hi = Y.lo * size, Y.hi * size
        seen, exact = list(zip(lo, hi, strict=True)), [0.0] * len(lo)
        c, c_off = rounded(self.casimirs, seen, exact, self.number)
        form = design.form
        hc, k, *_ = form.split(design.weights)
        inner = _over(form.hc, hc, Interval(lo[n:], hi[n:]))
        outer = _over(form.k, k, c + Interval(-c_off, c_off))
        hc_off, _ = gradient_rounding(
            form.hc, hc, np.maximum(np.abs(lo[n:]), np.abs(hi[n:])), self.number
        )
        k_off, _ = gradient_rounding(form.k, k, c.magnitude + c_off, self.number)
        k_off = k_off + outer.hess.magnitude[0] @ c_off
        given = [*seen, *_sides(inner), *_sides(outer)]
        errors = [*exact, *map(float, hc_off), *map(float, k_off)]
        _, off = rounded(self.law, given, errors, self.number)
        rates = units.state[n:] / units.time
        return off[:m] / units.input, off[m:] / rates


def _over(network: Network, weights: Vector, box: Interval) -> Jet:
    """A network over one box (d,) in pieces, (1,)."""
    pieces = subdivide(box, _PIECES.get(len(box.lo), 3))
    jet = network_jet(network, weights, pieces)
    return Jet(*(hull(v, 1) for v in (jet.value, jet.grad, jet.hess)))


def _sides(jet: Jet) -> list[tuple[float, float]]:
    return list(zip(jet.grad.lo[0].tolist(), jet.grad.hi[0].tolist(), strict=True))
