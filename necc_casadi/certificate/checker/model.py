"""design.json as the checker reads it: expressions and exact numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import ends, evaluate
from necc_casadi.certificate.checker.loops import (
    StoredFeedback,
    StoredInterconnection,
    StoredLoop,
    StoredShaping,
)
from necc_casadi.certificate.checker.units import StoredUnits, divided, numbers, rationals
from necc_casadi.symbolic.expressions import parse

__all__ = ["StoredDesign"]


class StoredIntegral:
    """Integral action: τ, gains and limits of ζ in natural units; these as they stand, too.

    Raises
    ------
    ValueError
        When a number is not positive, or not one for each input.
    """

    def __init__(self, data: Mapping[str, Any], scale: StoredUnits) -> None:
        (tau,), gain, self.stated = (
            numbers(v) for v in ([data["tau"]], data["gain"], data["limit"])
        )
        positive = all(0 < v < math.inf for v in (tau, *gain, *self.stated))
        if not positive or not len(gain) == len(self.stated) == len(scale.input):
            raise ValueError("integral action needs positive numbers, one for each input")
        self.tau = tau / scale.time
        self.limit = divided(self.stated, scale.input)
        unit = scale.energy * scale.time
        self.gain = [v * unit / (u * u) for v, u in zip(gain, scale.input, strict=True)]


class StoredDesign:
    """design.json as expressions and exact numbers, measured in the natural units that it names.

    With z = S ẑ, t = T τ, H = E Ĥ, u = U û, c = S_c ĉ the loop keeps its form; powers of two leave
    every number what it is.
    """

    def __init__(self, data: Mapping[str, Any]) -> None:
        model = data["model"]
        self.symbols = {name: sp.Symbol(name, real=True) for name in model["symbols"]}
        self.z = tuple(self.symbols.values())
        self.states = [*model["states"], *model["controller_states"]]
        self.n, self.nc = len(model["states"]), len(model["controller_states"])
        self.form = data["form"]
        scale = self._scale = StoredUnits(data, len(self.z))
        self.units = scale.proof
        self.input_units = scale.input
        S, U = rationals(scale.state), rationals(scale.input)
        E, T = rationals([scale.energy, scale.time])
        plant, inner = S[: self.n], S[self.n :]
        x, xi = self.z[: self.n], self.z[self.n :]
        self.H = self._read(model["H"], x) / E
        self.J, self.R = (
            self._matrix(model[key], x, lambda i, j: T * E / (plant[i] * plant[j])) for key in "JR"
        )
        self.G = self._matrix(model["G"], x, lambda i, j: T * U[j] / plant[i])
        self.m = self.G.cols
        words = ["u"] if self.m == 1 else [f"u{j + 1}" for j in range(self.m)]
        self.inputs: list[str] = model.get("inputs", words)
        self.inertia: sp.Matrix | None = None
        if "inertia" in model:
            k = self.n // 2
            self.inertia = self._matrix(
                model["inertia"], x[:k], lambda i, j: plant[j] / (T * plant[k + i])
            )
        self.loop: StoredLoop
        if "gamma" in model:
            pairs = zip(model["gamma"], inner, strict=True)
            gamma = [self._read(text, x) / unit for text, unit in pairs]
            alpha = self._matrix(model["alpha"], x, lambda i, j: E / (U[i] * inner[j]))
            self.loop = StoredShaping(self.J, self.R, self.G, x, gamma, alpha)
        else:
            Jc, Rc = (
                self._matrix(model[key], xi, lambda i, j: T * E / (inner[i] * inner[j]))
                for key in ("Jc", "Rc")
            )
            Gc = self._matrix(model["Gc"], xi, lambda i, j: E / (inner[i] * U[j]))
            self.loop = StoredInterconnection(self.J, self.R, self.G, Jc, Rc, Gc)
        self.ahead: StoredFeedback | None = None
        if "preliminary" in model:
            scales: dict[str, Callable[[int, int], sp.Expr]] = {
                "f": lambda i, j: T / plant[i],
                "g": lambda i, j: T * U[j] / plant[i],
                "u0": lambda i, j: 1 / U[i],
                "gain": lambda i, j: U[j] / U[i],
            }
            ahead = model["preliminary"]
            found = {key: self._matrix(ahead[key], x, unit) for key, unit in scales.items()}
            self.ahead = StoredFeedback(**found)
            shapes = [(self.n, 1), (self.n, self.m), (self.m, 1), (self.m, self.m)]
            if [matrix.shape for matrix in found.values()] != shapes:
                raise ValueError("f, g, u0 and gain do not fit the plant")
        self.Jcl, self.Rcl, self.ports = self.loop.Jcl, self.loop.Rcl, self.loop.ports
        self.feedback = self.loop.feedback
        self.casimir_texts: list[str] = data["casimirs"]["functions"]
        texts = zip(self.casimir_texts, rationals(scale.casimir), strict=True)
        self.casimirs = [self._read(text, self.z) / unit for text, unit in texts]
        self.target = [
            parse(text, {}) / unit for text, unit in zip(data["target"], plant, strict=True)
        ]
        self.xi_star = divided(numbers(data["xi_star"]), self.units.state[self.n :])
        u = scale.input
        self.damping = self._damping(data, u)
        self.casimir_units, self.stated_weights = scale.casimir, numbers(data["weights"])
        self.weights = divided(self.stated_weights, scale.weights)
        self.integral = StoredIntegral(data["integral"], scale) if "integral" in data else None
        #: Coordinate → ends of the range of its set-point, as texts in the units of the model.
        self.setpoints = {
            str(name): (str(lo), str(hi)) for name, (lo, hi) in data.get("setpoints", {}).items()
        }
        if not set(self.setpoints) <= set(model["states"][: self.n // 2]):
            raise ValueError("a set-point of what is no coordinate")
        #: Parameter → ends of its range, and the plant with these as symbols, where some are told.
        told = data.get("told", {"ranges": {}, "plant": None})
        self.told_ranges = {str(k): (str(lo), str(hi)) for k, (lo, hi) in told["ranges"].items()}
        self.told_plant: Mapping[str, Any] | None = told["plant"]
        if set(self.told_ranges) & set(self.states) or not all(
            name.isidentifier() for name in self.told_ranges
        ):
            raise ValueError("a parameter that is told needs a word of its own")
        units = dict(zip(self.states, S, strict=True))
        self.domain = {
            name: tuple(parse(v, {}) / units[name] for v in bounds)
            for name, bounds in model["domain"].items()
        }
        self.stated_limits: list[list[float]] | None = model["u_limits"]
        self.u_limits = None
        if self.stated_limits is not None:
            limits = zip(self.stated_limits, u, strict=True)
            self.u_limits = [divided(list(pair), [unit, unit]) for pair, unit in limits]

    def in_natural_units(
        self,
        H: str,
        *matrices: list[list[str]],
        symbols: Mapping[str, sp.Symbol],
        known: Mapping[sp.Symbol, sp.Expr],
    ) -> tuple[Any, ...]:
        """H, J, R and G of another plant of these states, with values of some of its symbols."""
        scale = self._scale
        S, U = rationals(scale.state)[: self.n], rationals(scale.input)
        E, T = rationals([scale.energy, scale.time])
        sizes = {s: u * s for s, u in zip(self.z, S, strict=False) if u != 1}

        def read(text: str) -> sp.Expr:
            return parse(text, symbols).xreplace(known).xreplace(sizes)

        def whole(rows: list[list[str]], unit: Callable[[int, int], sp.Expr]) -> sp.Matrix:
            return sp.Matrix(
                [[read(v) * unit(i, j) for j, v in enumerate(row)] for i, row in enumerate(rows)]
            )

        J, R, G = matrices
        return (
            read(H) / E,
            *(whole(A, lambda i, j: T * E / (S[i] * S[j])) for A in (J, R)),
            whole(G, lambda i, j: T * U[j] / S[i]),
        )

    def _damping(self, data: Mapping[str, Any], u: list[float]) -> list[list[float]]:
        """𝒟, which takes (y, u) to (u, y), each port in its unit.

        Raises
        ------
        ValueError
            When the blocks do not fit.
        """
        y = [self.units.energy / (self.units.time * v) for v in u]
        rates, slopes = y, u
        if isinstance(self.loop, StoredShaping):
            sizes = self.units.state[self.n :]
            rates = [v / self.units.time for v in sizes]
            slopes = [self.units.energy / v for v in sizes]
        channels = self.ports.cols - self.m
        above, below = [["0x0p+0"] * channels] * self.m, [["0x0p+0"] * self.m] * channels
        upper, lower = data.get("coupling", (above, below))
        top = [a + b for a, b in zip(data["D"], upper, strict=True)]
        bottom = [a + b for a, b in zip(lower, data["Dc"], strict=True)]
        if (len(top), len(bottom)) != (self.m, channels):
            raise ValueError("the damping needs one row for each entry of the ports")
        pairs = zip(top + bottom, u + rates, strict=True)
        return [divided(numbers(row), [unit / v for v in y + slopes]) for row, unit in pairs]

    def _read(self, text: str, states: Sequence[sp.Symbol]) -> sp.Expr:
        """An expression of these states, in natural units.

        ż = M∇(H + Hc) is plant and controller together only where each knows its own states.
        """
        return parse(text, {s.name: s for s in states}).xreplace(
            {s: u * s for s, u in zip(self.z, rationals(self._scale.state), strict=True) if u != 1}
        )

    def _matrix(
        self,
        rows: list[list[str]],
        states: Sequence[sp.Symbol],
        unit: Callable[[int, int], sp.Expr],
    ) -> sp.Matrix:
        return sp.Matrix(
            [
                [self._read(v, states) * unit(i, j) for j, v in enumerate(row)]
                for i, row in enumerate(rows)
            ]
        )

    @property
    def written(self) -> list[sp.Expr]:
        """H, what the loop is made of, and the Casimirs, undifferentiated."""
        ahead = [] if self.ahead is None else self.ahead.written
        return [self.H, *self.loop.written, *ahead, *self.casimirs]

    @property
    def is_coupled(self) -> bool:
        """Whether damping in u has to do with that in ξ̇."""
        m, rows = self.m, self.damping
        inner = range(m, len(rows))
        return any(rows[i][j] or rows[j][i] for i in range(m) for j in inner)

    @property
    def scales_damping(self) -> bool:
        """Whether the code keeps limits of u by scaling damping; else it clips each input."""
        size = range(self.m)
        full = any(self.damping[i][j] for i in size for j in size if i != j)
        alone = not (full or self.is_coupled) and (self.ahead is None or self.ahead.acts_alone)
        return self.u_limits is not None and not alone

    def target_balls(self) -> list[arb]:
        """z* = (x*, ξ*)."""
        return [evaluate(v, {}) for v in self.target] + [arb(v) for v in self.xi_star]

    @cached_property
    def named_bounds(self) -> list[tuple[float, float]]:
        """The bounds that the model names, rounded inwards; ±∞ where it names none."""
        result = [(-math.inf, math.inf)] * len(self.z)
        for name, sides in self.domain.items():
            lo, hi = (ends(evaluate(v, {})) for v in sides)
            result[self.states.index(name)] = (lo[1], hi[0])
        return result

    @property
    def domain_sizes(self) -> list[float]:
        """How far the domain reaches where the model names no bounds, halved; natural units."""
        return self._scale.size

    @property
    def delta(self) -> float:
        """A lower bound of Φ₁: the sum has 1, the neural form δ."""
        phi = self.form["phi"]
        return 1.0 if phi is None else float(phi["delta"])
