"""How far the C code's u and ξ̇ are from the law, over a box, in Arb balls.

Running errors along the operations that the certificate names, which are tried against the law of
the design at points; networks by the order of their sums (docs/theory.md#rounding-noise-and-delay).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.sampled.measured import MeasuredProof
from necc_casadi.certificate.checker.sampled.step import StepProof
from necc_casadi.certificate.claims.rounding import (
    ACTIVATIONS,
    CONSTANTS,
    LIBRARY,
    MOST_SINE,
    UNARY,
    Number,
    Program,
)

__all__ = ["RoundingProof", "fits", "rounded", "units"]


#: More than what is left out of second order.
_SECOND = arb("1.001")
#: Points at which the operations are tried.
_TRIED = 16

_BINARY = ("add", "sub", "mul", "div")
_OTHERS = ("neg", "square", "sqrt", *UNARY)


def units(number: Number) -> tuple[arb, arb]:
    """(u, the least normal number) of a type."""
    bits, least = (24, -126) if number == "float" else (53, -1022)
    return arb(2) ** -bits, arb(2) ** least


def fits(program: Program, inputs: int, outputs: int) -> bool:
    """Whether a program takes and gives so many numbers, each step what is known before it."""
    if program.inputs != inputs or len(program.outputs) != outputs:
        return False
    for k, (name, places, _) in enumerate(program.steps, program.inputs):
        takes = 2 if name in _BINARY else 1 if name in _OTHERS else 0 if name == "const" else -1
        if len(places) != takes or not all(0 <= place < k for place in places):
            return False
    return all(0 <= place < inputs + len(program.steps) for place in program.outputs)


#: The range of an exact value, and how far the computed one is from it at most.
_Value = tuple[arb, arb]


def rounded(
    program: Program, given: Sequence[arb], errors: Sequence[arb], number: Number | None
) -> list[_Value]:
    """Outputs of a program over balls, with bounds of their errors; not finite: none is known.

    Without a type nothing is rounded but the constants.
    """
    u, tiny = (arb(0), arb(0)) if number is None else units(number)
    known: list[_Value] = list(zip(given, errors, strict=True))
    for name, places, constant in program.steps:
        if name == "const":
            off = (u + arb(CONSTANTS)) * abs(arb(constant)) + tiny
            known.append((arb(constant), off))
        else:
            known.append(_applied(name, [known[k] for k in places], u, tiny))
    return [(v, (e * _SECOND).upper()) for v, e in (known[k] for k in program.outputs)]


def _applied(name: str, given: Sequence[_Value], u: arb, tiny: arb) -> _Value:
    (a, a_off), (b, b_off) = given[0], given[-1]
    if name == "neg":
        return -a, a_off
    times = arb(1)
    if name in ("add", "sub"):
        value, error = (a + b if name == "add" else a - b), a_off + b_off
    elif name in ("mul", "square"):
        value = a * a if name == "square" else a * b
        error = a.abs_upper() * b_off + b.abs_upper() * a_off + a_off * b_off
    elif name == "div":
        value, least = a / b, b.abs_lower() - b_off
        error = (a_off + value.abs_upper() * b_off) / least if bool(least > 0) else arb.nan()
    else:
        wide = a + ball(-1.0, 1.0) * a_off
        value = getattr(a, name)()
        error = a_off * _steepness(name, wide).abs_upper()
        times = arb(1) if name == "sqrt" else arb(2 * LIBRARY)
    error = error + times * (u * (value.abs_upper() + error) + tiny)
    return value, error.upper()


def _steepness(name: str, v: arb) -> arb:
    """Enclosures of the derivative."""
    slopes: dict[str, Callable[[], arb]] = {
        "sqrt": lambda: 1 / (2 * v.sqrt()),
        "tan": lambda: 1 + v.tan() ** 2,
        "asin": lambda: 1 / (1 - v * v).sqrt(),
        "acos": lambda: 1 / (1 - v * v).sqrt(),
        "sinh": lambda: v.cosh(),
        "cosh": lambda: v.sinh(),
        "acosh": lambda: 1 / (v * v - 1).sqrt(),
        "atanh": lambda: 1 / (1 - v * v),
        "exp": lambda: v.exp(),
        "log": lambda: 1 / v,
    }
    return slopes[name]() if name in slopes else arb(1)


class _Layers:
    """A network's weights by absolute value, in the units of the model."""

    def __init__(self, shape: Mapping[str, Any], weights: Sequence[float]) -> None:
        at, self.layers = 0, list[tuple[arb_mat, arb_mat]]()
        for columns, rows in pairwise([shape["inputs"], *shape["hidden"], 1]):
            W = [weights[k : k + columns] for k in range(at, at + rows * columns, columns)]
            at += rows * columns
            b = weights[at : at + rows]
            at += rows
            self.layers.append(
                (
                    arb_mat([[arb(abs(v)) for v in row] for row in W]),
                    arb_mat([[arb(abs(v))] for v in b]),
                )
            )
        d = self.inputs = shape["inputs"]
        self.activation, self.parts = shape["activation"], list[tuple[arb, arb]]()
        if shape["quadratic"]:
            kappa, center = weights[at : at + d], weights[at + d : at + 2 * d]
            self.parts = [(arb(k), arb(abs(o))) for k, o in zip(kappa, center, strict=True)]
            at += 2 * d
        self.used = at

    def rounding(self, size: Sequence[arb], number: Number) -> list[arb]:
        """|computed − exact| of the gradient where |v| ≤ size; not finite: none is known."""
        (u, tiny), errors = units(number), ACTIVATIONS[self.activation, number]
        (W, b), *others = self.layers
        d, wide = self.inputs, self.activation == "squareplus"
        slope, off = W, W * u
        a = W * arb_mat([[v] for v in size]) + b
        delta = _each(a, lambda v: (d + 3) * u * v + 2 * (d + 1) * tiny)
        value_error, slope_error = arb(errors.value) * 2 * u, arb(errors.slope) * 2 * u
        for index, (V, c) in enumerate(others):
            if self.activation == "sin" and not all(bool(v <= MOST_SINE) for (v,) in a.tolist()):
                return [arb.nan()] * d
            bent = _each(delta, lambda v: slope_error + arb(errors.curvature) * v + u)
            off = off + _rows(bent, slope + off) + _each(slope, lambda v: 2 * tiny)
            t = _each(a, lambda v: v + 1 if wide else arb(1))
            t_off = delta + _each(t, lambda v: value_error * v + tiny)
            columns, last = 16 * -(-V.ncols() // 16), index == len(others) - 1
            gamma = ((columns // 16 + 7) if last else (columns // 4 + 6)) * u
            off = V * off + V * (slope + off) * gamma
            off = off + arb_mat([[2 * columns * tiny] * d] * off.nrows())
            slope = V * slope
            a, delta = V * t + c, V * t_off + (V * (t + t_off) + c) * gamma
            delta = delta + arb_mat([[2 * columns * tiny]] * delta.nrows())
        found = []
        for i in range(d):
            total, wrong = slope[0, i], off[0, i]
            if self.parts:
                kappa, center = self.parts[i]
                wrong = wrong + u * (6 * kappa * (size[i] + center) + total) + 4 * tiny
            found.append((wrong * _SECOND).upper())
        return found


def _each(A: arb_mat, f: Callable[[arb], arb]) -> arb_mat:
    return arb_mat([[f(v).upper() for v in row] for row in A.tolist()])


def _rows(column: arb_mat, A: arb_mat) -> arb_mat:
    """Each row times a number of its own."""
    pairs = zip(column.tolist(), A.tolist(), strict=True)
    return arb_mat([[v * w for w in row] for (v,), row in pairs])


@dataclass(frozen=True)
class RoundingProof:
    """The rounding of the code of a stored design; natural units outside."""

    step: StepProof
    measured: MeasuredProof
    number: Number
    casimirs: Program
    law: Program

    @property
    def model(self) -> StoredDesign:
        """The design."""
        return self.step.model

    @property
    def energy(self) -> Energy:
        """V."""
        return self.step.energy

    def is_of_this_law(self, box: Box) -> bool:
        """Whether the operations are those of the law, at points of a box.

        In exact arithmetic they may differ by what their constants are rounded, which is within
        the bounds.
        """
        model = self.model
        size, outputs = len(model.z), model.m + model.nc
        inner = size + model.nc + len(model.casimirs)
        first = fits(self.casimirs, size, len(model.casimirs))
        if not (first and fits(self.law, inner, outputs)):
            return False
        rng = random.SystemRandom()  # nobody knows the points beforehand
        for _ in range(_TRIED):
            z = [rng.uniform(lo, hi) for lo, hi in box]
            place: Box = tuple((v, v) for v in z)
            seen = [v * arb(s) for v, s in self._measured_at(place)]
            c = rounded(self.casimirs, seen, [arb(0)] * size, None)
            own = zip(self.energy.casimirs(place)[0], model.casimir_units, strict=True)
            hc, k = self._slopes(place)
            found = rounded(self.law, [*seen, *hc, *k], [arb(0)] * inner, None)
            exact = [*(v * arb(s) for v, s in own), *self._law_at(place)]
            if not _agree([*c, *found], exact):
                return False
        return True

    def _law_at(self, place: Box) -> list[arb]:
        """(u, ξ̇) at a point, in the units of the model."""
        model = self.model
        gradient = self.energy.gradient(place)
        u = self.step.inputs(place, gradient)
        rates = self.step.rates(place, gradient)[model.n :]
        units = zip(model.units.state[model.n :], rates, strict=False)
        return [
            *(v * arb(s) for v, s in zip(u, model.input_units, strict=True)),
            *(v * arb(s) / arb(model.units.time) for s, v in units),
        ]

    def _slopes(self, box: Box) -> tuple[list[arb], list[arb]]:
        """∇Hc and ∇K over a box, in the units of the model."""
        model = self.model
        E, inner = arb(model.units.energy), box[model.n :]
        c = tuple(ends(v) for v in self.energy.casimirs(box)[0])
        hc, k = self.energy.hc(inner)[1], self.energy.k(c)[1]
        sizes = model.units.state[model.n : len(model.z)]
        return (
            [v * E / arb(s) for v, s in zip(hc, sizes, strict=True)],
            [v * E / arb(s) for v, s in zip(k, model.casimir_units, strict=True)],
        )

    def _measured_at(self, box: Box) -> list[tuple[arb, float]]:
        """(y, ξ) of a box of what is taken for (x, ξ), and what 1 is of each."""
        return list(zip(self.measured.over(box), self.measured.units, strict=True))

    def over(self, box: Box) -> tuple[list[arb], list[arb]]:
        """Bounds of |computed − exact| of u and of ξ̇ over a box of what is taken for (x, ξ)."""
        model = self.model
        n, m, E = model.n, model.m, arb(model.units.energy)
        state = model.units.state[: len(model.z)]
        seen = [v * arb(s) for v, s in self._measured_at(box)]
        c = rounded(self.casimirs, seen, [arb(0)] * len(seen), self.number)
        hc = _Layers(model.form["hc"], model.stated_weights)
        k = _Layers(model.form["k"], model.stated_weights[hc.used :])
        hc_off = hc.rounding([v.abs_upper() for v in seen[n:]], self.number)
        k_off = k.rounding([(v.abs_upper() + e).upper() for v, e in c], self.number)
        if not all(e.is_finite() for _, e in c):
            return [arb.nan()] * m, [arb.nan()] * model.nc
        scales = model.casimir_units
        wide = [
            ends((v + ball(-1.0, 1.0) * e) / arb(s)) for (v, e), s in zip(c, scales, strict=True)
        ]
        curved = self.energy.k.curvature_on_grid(tuple(wide))
        for i in range(len(c)):
            for j, (_, e) in enumerate(c):
                bend = (
                    curved[min(i, j), max(i, j)].abs_upper() * E / arb(scales[i]) / arb(scales[j])
                )
                k_off[i] = (k_off[i] + bend * e).upper()
        slopes_hc, slopes_k = self._wide_slopes(box, tuple(wide))
        given = [*seen, *slopes_hc, *slopes_k]
        errors = [*[arb(0)] * len(seen), *hc_off, *k_off]
        off = [e for _, e in rounded(self.law, given, errors, self.number)]
        rates = [v / arb(model.units.time) for v in map(arb, state[n:])]
        return (
            [(v / arb(s)).upper() for v, s in zip(off[:m], model.input_units, strict=True)],
            [(v / s).upper() for v, s in zip(off[m:], rates, strict=True)],
        )

    def _wide_slopes(self, box: Box, c: Box) -> tuple[list[arb], list[arb]]:
        model = self.model
        E, sizes = arb(model.units.energy), model.units.state[model.n : len(model.z)]
        hc, k = self.energy.hc.slope_on_grid(box[model.n :]), self.energy.k.slope_on_grid(c)
        return (
            [v * E / arb(s) for v, s in zip(hc, sizes, strict=True)],
            [v * E / arb(s) for v, s in zip(k, model.casimir_units, strict=True)],
        )


def _agree(found: Sequence[_Value], exact: Sequence[arb]) -> bool:
    """Whether no value is proved to be farther off than its error."""
    pairs = zip(found, exact, strict=True)
    return all(v.is_finite() and bool(abs(v - w).lower() <= e) for (v, e), w in pairs)
