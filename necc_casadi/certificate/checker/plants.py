"""plant.json, or what design.json tells of parameters: the plant with these as symbols."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import sympy as sp

from necc_casadi.certificate.checker.evidence import Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.zero import is_zero

__all__ = ["StoredPlants", "stated_ranges"]


def stated_ranges(evidence: Evidence, claim: str) -> dict[str, tuple[str, str]]:
    """Ranges of parameters that a claim names, by parameter.

    Raises
    ------
    ValueError
        When a range has not two ends, or its name is no word.
    """
    ranges = {}
    for name, side in evidence.claims[claim].data.get("uncertain", {}).items():
        lo, hi = map(str, side)
        if not str(name).isidentifier():
            raise ValueError("a parameter whose name is no word")
        ranges[str(name)] = lo, hi
    return ranges


class StoredPlants:
    """The plant of plant.json with some parameters as symbols, in natural units but for these.

    Raises
    ------
    ValueError
        When there is no plant.json, or it is no plant of so many states.
    """

    def __init__(
        self,
        model: StoredDesign,
        text: str | Mapping[str, Any] | None,
        ranges: Mapping[str, Sequence[str]],
    ) -> None:
        if text is None:
            raise ValueError("plant.json is missing")
        data = json.loads(text) if isinstance(text, str) else text
        names, plain = data["names"], data["symbols"]
        if names[: model.n] != model.states[: model.n] or len(set(names)) != len(plain):
            raise ValueError("plant.json is of other states")
        theta = [sp.Symbol(name, real=True) for name in names[model.n :]]
        own = dict(zip(plain, (*model.z[: model.n], *theta), strict=True))
        values = {name: parse(v, {}) for name, v in data["parameters"].items()}
        self.nominal = {s: values[str(s)] for s in theta}
        self.ranges = {
            sp.Symbol(name, real=True): tuple(parse(v, {}) for v in side)
            for name, side in ranges.items()
        }
        if not set(self.ranges) <= set(self.nominal) or set(self.nominal) & set(model.z):
            raise ValueError("a parameter that plant.json has not, or that is a state")
        fixed = {s: v for s, v in self.nominal.items() if s not in self.ranges}
        matrices = data["J"], data["R"], data["G"]
        self.H, self.J, self.R, self.G = model.in_natural_units(
            data["H"], *matrices, symbols=own, known=fixed
        )
        k = model.n // 2
        self.p, self._rates = model.z[k : model.n], model.J[:k, k : model.n]

    @cached_property
    def inverse(self) -> sp.Matrix:
        """∂²H/∂p², of a mechanical plant."""
        return sp.hessian(self.H, self.p)

    @cached_property
    def inertia(self) -> sp.Matrix:
        """M, q̇ = A ∂H/∂p and p = M q̇."""
        return (self._rates * self.inverse).inv()

    def fits(self, model: StoredDesign) -> bool:
        """Whether θ is in M, U and R alone, and the nominal plant is that of the design."""
        at, k = self.nominal, model.n // 2
        pairs = [(self.H, model.H), *zip(self.R, model.R, strict=True)]
        same = all(is_zero(a.xreplace(at) - b) is True for a, b in pairs)
        own = [*(self.J - model.J), *(self.G - model.G), *self.R[:k, :], *self.R[:, :k]]
        own += [*(self.R - self.R.T)]
        rest = self.H - (sp.Matrix(self.p).T * self.inverse * sp.Matrix(self.p))[0, 0] / 2
        own += [sp.diff(rest, s) for s in self.p]
        plain = not any(set(self.p) & v.free_symbols for v in self.inverse)
        constant = not any(set(model.z) & v.free_symbols for v in self.R)
        ordered = all(
            bool(lo <= at[s]) and bool(at[s] <= hi) for s, (lo, hi) in self.ranges.items()
        )
        return same and plain and constant and ordered and all(is_zero(v) is True for v in own)
