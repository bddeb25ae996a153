"""family.json: a loop seen from its set-points, tied by algebra to the plant of design.json.

At the nominal ϑ it is that plant, and for every other one its flow is that of a plant with the
unknown parameters at x̂ + x*(r) − x*(r₀), with the feed-forward and the disturbance on its inputs.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import sympy as sp

from necc_casadi.certificate.checker.arithmetic.balls import Box, ends, evaluate
from necc_casadi.certificate.checker.evidence import Obligation
from necc_casadi.certificate.checker.loops import StoredInterconnection
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants
from necc_casadi.certificate.checker.units import rationals
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero
from necc_casadi.texts import escaped

__all__ = ["StoredFamily"]


#: Parameters, and letters of an expression.
_MOST, _LONGEST = 50, 20_000


class _Parameter:
    """A symbol with a range, in the units of the model."""

    def __init__(self, entry: Mapping[str, Any], symbol: str) -> None:
        self.name, self.kind = _short(entry["name"]), entry["kind"]
        if escaped(self.name) != self.name:
            raise ValueError("a name that holds characters that cannot be shown")
        self.symbol = sp.Symbol(symbol, real=True)
        self.lo, self.hi = (parse(_short(v), {}) for v in entry["range"])
        self.nominal = parse(_short(entry["nominal"]), {})
        if self.kind not in ("setpoint", "uncertain", "disturbance"):
            raise ValueError(f"no such kind: {self.kind!r:.20}")
        if self.kind != "setpoint" and not self.name.isidentifier():
            raise ValueError("a parameter whose name is no word")

    @property
    def side(self) -> Side:
        """The range as doubles near its ends, for words."""
        lo, hi = (evaluate(v, {}) for v in (self.lo, self.hi))
        return float(lo.mid()), float(hi.mid())


def _short(text: Any) -> str:
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise ValueError(f"no expression, or one of more than {_LONGEST} characters")
    return text


class StoredFamily:
    """family.json as expressions in natural units."""

    def __init__(self, model: StoredDesign, data: Mapping[str, Any]) -> None:
        self.model = model
        names, entries = data["symbols"], data["parameters"]
        N, n = len(model.z), model.n
        if not (data["format"] == 1 and len(names) == N + len(entries) == len(set(names))):
            raise ValueError("family.json has another format, or symbols of other states")
        if names[:N] != list(model.symbols) or len(entries) > _MOST:
            raise ValueError("family.json names other states, or too many parameters")
        pairs = zip(entries, names[N:], strict=True)
        self.parameters = [_Parameter(entry, name) for entry, name in pairs]
        moved = {p.name for p in self.parameters if p.kind == "setpoint"}
        if not moved <= set(model.states[:n]):
            raise ValueError("family.json moves what is no state of the plant")
        S, U = rationals(model.units.state[:n]), rationals(model.input_units)
        E, T = rationals([model.units.energy, model.units.time])
        known = dict(zip(names, [*model.z, *self.symbols], strict=True))
        scale = {s: u * s for s, u in zip(model.z, S, strict=False) if u != 1}

        def read(text: Any) -> sp.Expr:
            found = parse(_short(text), known)
            if found.free_symbols & set(model.z[n:]):
                raise ValueError("the plant of a family knows no controller state")
            return found.xreplace(scale)

        def matrix(rows: Any, unit: Any) -> sp.Matrix:
            return sp.Matrix(
                [[read(v) * unit(i, j) for j, v in enumerate(row)] for i, row in enumerate(rows)]
            )

        self.H = read(data["H"]) / E
        self.J, self.R = (matrix(data[k], lambda i, j: T * E / (S[i] * S[j])) for k in "JR")
        self.G = matrix(data["G"], lambda i, j: T * U[j] / S[i])
        self.x_star = [read(v) / s for v, s in zip(data["x_star"], S, strict=True)]
        self.feed = sp.Matrix([read(v) / u for v, u in zip(data["feedforward"], U, strict=True)])
        if (self.J.shape, self.R.shape, self.G.shape) != ((n, n), (n, n), (n, model.m)):
            raise ValueError("the matrices of family.json do not fit the plant")
        self.U = U

    @property
    def symbols(self) -> list[sp.Symbol]:
        """ϑ."""
        return [p.symbol for p in self.parameters]

    @cached_property
    def box(self) -> Box:
        """The ranges, in doubles around their ends.

        Raises
        ------
        ValueError
            When one is empty.
        """
        sides = tuple((ends(evaluate(p.lo, {}))[0], ends(evaluate(p.hi, {}))[1])
                      for p in self.parameters)  # fmt: skip
        if not all(lo <= hi for lo, hi in sides):
            raise ValueError("a range without numbers")
        return sides

    @property
    def sides(self) -> dict[str, Side]:
        """The ranges by name, for words."""
        return {p.name: p.side for p in self.parameters}

    @property
    def has_unknown(self) -> bool:
        """Whether some parameters are not known."""
        return any(p.kind == "uncertain" for p in self.parameters)

    def without_energy(self) -> StoredDesign:
        """The design with H = 0: its networks and Casimirs."""
        nothing = copy.copy(self.model)
        nothing.H = sp.Integer(0)
        return nothing

    @property
    def units_of_states(self) -> list[sp.Expr]:
        """Natural units of the plant's states."""
        return list(rationals(self.model.units.state[: self.model.n]))

    def as_design(self) -> StoredDesign:
        """The design with ϑ as symbols in its plant."""
        member, inner = copy.copy(self.model), cast(StoredInterconnection, self.model.loop)
        loop = StoredInterconnection(self.J, self.R, self.G, inner.Jc, inner.Rc, inner.Gc)
        member.H, member.J, member.R, member.G, member.loop = self.H, self.J, self.R, self.G, loop
        member.Jcl, member.Rcl, member.ports = loop.Jcl, loop.Rcl, loop.ports
        return member

    def obligations(self) -> list[Obligation]:
        """What makes this the family of the design, and V fall for all of it."""
        return [
            ("each parameter is what its name says", self._is_named),
            ("Φ is the sum", lambda: self.model.form["phi"] is None),
            ("the loop is the published one", self._is_published),
            ("at the nominal parameters it is the plant of the design", self._is_of_the_design),
            ("x*(r) is the target at r₀", self._starts_at_the_target),
            ("the feed-forward is one of the set-points alone", self._feeds_what_is_known),
            ("it is the plant seen from the set-point", self._is_the_plant),
            ("y is measured but for what is known", self._is_measured),
            ("J = −Jᵀ and R = Rᵀ for every parameter", self._is_symmetric),
            ("R ⪰ 0 for every parameter", self._dissipates),
            ("∇Cᵀ(Jcl − Rcl) = 0 for every parameter", self._has_casimirs),
            ("no unknown stands in the damping", self._is_known),
        ]

    def _is_published(self) -> bool:
        return self.model.ahead is None and hasattr(self.model.loop, "Gc")

    def _is_named(self) -> bool:
        """Set-points are of states, which follow them; disturbances of inputs, and nominally 0."""
        model = self.model
        units = rationals(model.units.state)
        names = [p.name for p in self.parameters]
        own = {
            name: value * unit
            for name, value, unit in zip(model.states, self.x_star, units, strict=False)
        }
        moved = [p for p in self.parameters if p.kind == "setpoint"]
        pushed = [p for p in self.parameters if p.kind == "disturbance"]
        inputs = [f"d_{name}" for name in model.inputs]
        return (
            len(set(names)) == len(names)
            and all(p.name in own and _vanish([own[p.name] - p.symbol]) for p in moved)
            and [p.name for p in pushed] == inputs[: len(pushed)]
            and _vanish([p.nominal for p in pushed])
        )

    def _feeds_what_is_known(self) -> bool:
        """It is a function of r, and 0 at r₀."""
        known = self._nominal(("setpoint",))
        return self.feed.free_symbols <= set(known) and _vanish([*self.feed.subs(known)])

    def _nominal(self, kinds: Sequence[str]) -> dict[sp.Symbol, sp.Expr]:
        return {p.symbol: p.nominal for p in self.parameters if p.kind in kinds}

    def _is_of_the_design(self) -> bool:
        known = self._nominal(("setpoint", "uncertain", "disturbance"))
        pairs = [(self.J, self.model.J), (self.R, self.model.R), (self.G, self.model.G)]
        off = [e for own, other in pairs for e in own.subs(known) - other]
        slope = [sp.diff(self.H.subs(known) - self.model.H, s) for s in self._x]
        return _vanish([*off, *slope])

    @property
    def _x(self) -> tuple[sp.Symbol, ...]:
        return self.model.z[: self.model.n]

    def _starts_at_the_target(self) -> bool:
        known = self._nominal(("setpoint",))
        pairs = zip(self.x_star, self.model.target, strict=True)
        free = all(v.free_symbols <= set(known) for v in self.x_star)
        return free and _vanish([v.subs(known) - t for v, t in pairs])

    def _is_the_plant(self) -> bool:
        """The flow at (x̂; r, θ, d) is that at (x̂ + x*(r) − x*(r₀); r₀, θ, 0), and G(u_r + d)."""
        base, shift = self._nominal(("setpoint", "disturbance")), self._shift
        plain = (self.J - self.R) * sp.Matrix([sp.diff(self.H, s) for s in self._x])
        there = plain.subs(base).subs(shift, simultaneous=True)
        d = [p.symbol for p in self.parameters if p.kind == "disturbance"]
        added: list[sp.Expr] = [*d, *[sp.Integer(0)] * (self.model.m - len(d))]
        scaled = sp.Matrix([a / u for a, u in zip(added, self.U, strict=True)])
        G = self.G.subs(base).subs(shift, simultaneous=True)
        pairs = zip([*self.G], [*G], strict=True)
        moved = [a - b for a, b in pairs]
        return _vanish([*(plain - there - G * (self.feed + scaled)), *moved])

    @property
    def _shift(self) -> dict[sp.Symbol, sp.Expr]:
        """x̂ → x̂ + x*(r) − x*(r₀)."""
        moved = zip(self._x, self.x_star, self.model.target, strict=True)
        return {s: s + v - t for s, v, t in moved}

    @property
    def _outputs(self) -> sp.Matrix:
        """Gᵀ∇Ĥ."""
        return self.G.T * sp.Matrix([sp.diff(self.H, s) for s in self._x])

    def _is_measured(self) -> bool:
        """Gᵀ∇Ĥ is that of the plant and something that no unknown and no disturbance enters."""
        base = self._nominal(("setpoint", "disturbance"))
        there = self._outputs.subs(base).subs(self._shift, simultaneous=True)
        hidden = [p.symbol for p in self.parameters if p.kind != "setpoint"]
        return _vanish([sp.diff(e, s) for e in self._outputs - there for s in hidden])

    def is_written_in(self, text: str | None) -> bool:
        """Whether plant.json has these flows, inputs and outputs at r₀ for every θ."""
        if text is None:
            return False
        model, unknown = self.model, [p for p in self.parameters if p.kind == "uncertain"]
        plants = StoredPlants(model, text, {p.name: (str(p.lo), str(p.hi)) for p in unknown})
        named = {sp.Symbol(p.name, real=True): p.symbol for p in unknown}
        slope = sp.Matrix([sp.diff(plants.H, s) for s in self._x])
        G = plants.G.xreplace(plants.nominal)
        theirs = [*((plants.J - plants.R) * slope), *plants.G, *(G.T * slope)]
        here = self._nominal(("setpoint", "disturbance"))
        flow = (self.J - self.R) * sp.Matrix([sp.diff(self.H, s) for s in self._x])
        own = [v.subs(here) for v in [*flow, *self.G, *self._outputs]]
        same = all(is_zero(p.nominal - plants.nominal[sp.Symbol(p.name, real=True)]) is True
                   for p in unknown)  # fmt: skip
        return same and _vanish([a - b.xreplace(named) for a, b in zip(own, theirs, strict=True)])

    def _is_symmetric(self) -> bool:
        return _vanish([*(self.J + self.J.T), *(self.R - self.R.T)])

    def _dissipates(self) -> bool:
        beyond = {
            p.symbol: p.lo + sp.Dummy(f"above {p.name}", real=True) ** 2 for p in self.parameters
        }
        return is_positive_semidefinite(self.R.subs(beyond)) is True

    def _has_casimirs(self) -> bool:
        loop: Any = self.model.loop
        coupling = self.G * loop.Gc.T
        upper = (self.J - self.R).row_join(-coupling)
        M = upper.col_join(coupling.T.row_join(loop.Jc - loop.Rc))
        slopes = [sp.Matrix([[sp.diff(c, v) for v in self.model.z]]) for c in self.model.casimirs]
        return all(_vanish([*(slope * M)]) for slope in slopes)

    def _is_known(self) -> bool:
        unknown = {p.symbol for p in self.parameters if p.kind == "uncertain"}
        slopes = sp.Matrix([[sp.diff(c, v) for v in self._x] for c in self.model.casimirs])
        used = (slopes * self.G).applyfunc(sp.simplify)
        return not used.free_symbols & unknown


def _vanish(entries: Sequence[sp.Expr]) -> bool:
    return all(is_zero(sp.sympify(entry)) is True for entry in entries)
