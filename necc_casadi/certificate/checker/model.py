"""design.json as the checker reads it: expressions and exact numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import evaluate
from necc_casadi.symbolic.expressions import parse

__all__ = ["StoredDesign"]


class StoredDesign:
    """design.json as expressions and exact numbers."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        model = data["model"]
        self.symbols = {name: sp.Symbol(name, real=True) for name in model["symbols"]}
        self.z = tuple(self.symbols.values())
        self.states = [*model["states"], *model["controller_states"]]
        self.n, self.nc = len(model["states"]), len(model["controller_states"])
        self.H = self._read(model["H"])
        self.J, self.R, self.G = (self._matrix(model[key]) for key in "JRG")
        self.Jc, self.Rc, self.Gc = (self._matrix(model[key]) for key in ("Jc", "Rc", "Gc"))
        self.m = self.G.cols
        self.casimir_texts: list[str] = data["casimirs"]["functions"]
        self.casimirs = [self._read(text) for text in self.casimir_texts]
        self.target = [self._read(text) for text in data["target"]]
        self.xi_star = [float.fromhex(v) for v in data["xi_star"]]
        self.D, self.Dc = (
            [[float.fromhex(v) for v in row] for row in data[key]] for key in ("D", "Dc")
        )
        self.form, self.weights = data["form"], [float.fromhex(v) for v in data["weights"]]
        self.domain = {
            name: tuple(self._read(v) for v in bounds) for name, bounds in model["domain"].items()
        }
        self.verdict = data["verdict"]
        self.u_limits: list[list[float]] | None = model["u_limits"]

    def _read(self, text: str) -> sp.Expr:
        return parse(text, self.symbols)

    def _matrix(self, rows: list[list[str]]) -> sp.Matrix:
        return sp.Matrix([[self._read(v) for v in row] for row in rows])

    @property
    def Jcl(self) -> sp.Matrix:
        """The interconnection, plant first."""
        coupling = self.G * self.Gc.T
        top, bottom = self.J.row_join(-coupling), coupling.T.row_join(self.Jc)
        return sp.Matrix(top.col_join(bottom))

    @property
    def Rcl(self) -> sp.Matrix:
        """The dissipation."""
        return sp.diag(self.R, self.Rc)

    @property
    def ports(self) -> sp.Matrix:
        """𝒢 = diag(G, Gc)."""
        return sp.diag(self.G, self.Gc)

    def target_balls(self) -> list[arb]:
        """z* = (x*, ξ*)."""
        return [evaluate(v, {}) for v in self.target] + [arb(v) for v in self.xi_star]

    @cached_property
    def bounds(self) -> list[tuple[arb, arb]]:
        """The domain; target ± 2 where the model names none."""
        result = []
        for name, at in zip(self.states, self.target_balls(), strict=True):
            sides = self.domain.get(name)
            lo, hi = [at - 2, at + 2] if sides is None else [evaluate(v, {}) for v in sides]
            result.append((lo, hi))
        return result

    def in_domain(
        self, states: Sequence[int], sides: Iterable[tuple[arb | float, arb | float]]
    ) -> bool:
        """Whether a box of some of the states, by ends that are numbers or balls, is inside."""
        return all(
            bool(self.bounds[i][0] <= lo) and bool(hi <= self.bounds[i][1])
            for i, (lo, hi) in zip(states, sides, strict=True)
        )

    @property
    def delta(self) -> float:
        """A lower bound of Φ₁: the sum has 1, the neural form δ."""
        phi = self.form["phi"]
        return 1.0 if phi is None else float(phi["delta"])
