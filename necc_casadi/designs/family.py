"""Family: one finished design for many set-points and plants; a value, saved and loaded.

``family.json`` names the hash of its design.json, which alone holds networks, damping and Casimirs.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.designs.layout import BROKEN
from necc_casadi.errors import OutputError
from necc_casadi.files import read_text, refuse_unfinished, write_text
from necc_casadi.lyapunov.family_terms import control_law_over, value_over
from necc_casadi.model.build_family import family_loop
from necc_casadi.model.family_loop import FamilyLoop, NoFamily, Parameter
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.ranges import Ranges
from necc_casadi.symbolic.expressions import parse, to_text
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.symbolic.identifiers import identifiers

if TYPE_CHECKING:
    import casadi as ca

__all__ = ["FAMILY_FILE", "Family", "lift"]


FAMILY_FILE = "family.json"


#: Version of the layout of family.json.
_FAMILY_FORMAT = 1


_LARGEST = 1 << 26  # bytes


#: Values of parameters by name; those that are not named are nominal.
Values = Mapping[str, float | sp.Expr]


@dataclass(frozen=True, eq=False)
class Family:
    """A design and the loop that it closes for every set-point r, plant θ and disturbance d.

    States are x̂ = x − x*(r) + x*(r₀) and ξ: seen from the set-point, all members have the target,
    the Casimirs, the networks and the damping of the design, and energies of their own.

    Examples
    --------
    >>> import sympy as sp
    >>> from necc_casadi import design, find_casimirs, judge, load_model, parse_target
    >>> from necc_casadi.designs.family import lift
    >>> from necc_casadi.model.ranges import Ranges
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> family = lift(made, Ranges(setpoints={"q": (sp.Integer(-2), sp.Integer(2))}))
    >>> family.moved.x_star, family.moved.feedforward
    ((r_q, 0), Matrix([[sin(r_q) - sqrt(2)/2]]))
    >>> member = family.member({"q": 1.0})
    >>> bool(abs(member.lyapunov.gradient(member.z_star)).max() < 1e-12)
    True
    """

    design: Design
    moved: FamilyLoop

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What has a range: set-points, parameters of the plant, disturbances."""
        return self.moved.parameters

    @property
    def state_units(self) -> dict[str, float]:
        """Natural units of the states, by name."""
        design = self.design
        return dict(zip(design.loop.states, design.units.state.tolist(), strict=True))

    @cached_property
    def setpoints(self) -> tuple[Parameter, ...]:
        """What moves at run time."""
        return self.moved.of("setpoint")

    @cached_property
    def symbolic(self) -> Design:
        """The design with ϑ as symbols in its plant: for algebra and enclosures."""
        return replace(self.design, loop=self.moved.loop)

    def member(self, values: Values | None = None) -> Design:
        """One plant at one set-point, in the states x̂; domain and limits are seen from there too.

        Parameters
        ----------
        values
            Of parameters by name, in the units of the model.
        """
        known = self._known(values)
        loop, plant = self.moved.at(known), self.design.loop.plant
        shift, feed = self.shift(values), self.feedforward(values)
        domain = {
            name: (plant.domain[name][0] - _exactly(s), plant.domain[name][1] - _exactly(s))
            for name, s in zip(plant.states, shift.tolist(), strict=True)
            if name in plant.domain
        }
        limits = plant.u_limits and tuple(
            (lo - v, hi - v) for (lo, hi), v in zip(plant.u_limits, feed.tolist(), strict=True)
        )
        inner = {k: v for k, v in plant.domain.items() if k not in plant.states}
        own = replace(loop.plant, domain={**domain, **inner}, u_limits=limits)
        return replace(self.design, loop=replace(loop, plant=own))

    def shift(self, values: Values | None = None) -> Vector:
        """X − x̂ = x*(r) − x*(r₀), (n,)."""
        return self._numbers(self.moved.shift, values)

    def feedforward(self, values: Values | None = None) -> Vector:
        """What is added to u at this set-point, (m,)."""
        return self._numbers(self.moved.feedforward, values)

    def x_star(self, values: Values | None = None) -> Vector:
        """The equilibrium x*(r), (n,)."""
        return self._numbers(sp.ImmutableMatrix(self.moved.x_star), values)

    def control(
        self, x: npt.ArrayLike, xi: npt.ArrayLike, r: npt.ArrayLike = ()
    ) -> tuple[Vector, Vector]:
        """The controller: plant state (n,), controller state (nc,), set-points -> u (m,), ξ̇ (nc,).

        x is what is measured, in nominal terms: momenta are M₀ times the measured velocities.
        """
        u, xi_dot = self.control_law_function.call([np.asarray(v, float) for v in (x, xi, r)])
        return np.asarray(u, float).ravel(), np.asarray(xi_dot, float).ravel()

    @cached_property
    def control_law_function(self) -> ca.Function:
        """(x, ξ, r) -> (u, ξ̇), the exported controller: r (setpoints,) in order."""
        made = self.design
        return control_law_over(self.moved, made.casimirs, made.form, made.weights, made.damping)

    @cached_property
    def V_function(self) -> ca.Function:
        """(ẑ, ϑ) -> V, scalar: ẑ = (x̂, ξ), ϑ (parameters,) in order."""
        return value_over(self.moved, self.design.casimirs, self.design.form, self.design.weights)

    def _known(self, values: Values | None) -> dict[str, sp.Expr]:
        return {name: _exactly(v) for name, v in (values or {}).items()}

    def _numbers(self, matrix: sp.ImmutableMatrix, values: Values | None) -> Vector:
        known = self._known(values)
        at = {p.symbol: known.get(p.name, p.nominal) for p in self.parameters}
        return to_floats([entry.subs(at) for entry in matrix])

    # --- family.json --------------------------------------------------------------------------

    @cached_property
    def text(self) -> str:
        """The exact content of family.json."""
        return json.dumps(_to_dict(self), indent=1, ensure_ascii=False) + "\n"

    @cached_property
    def hash(self) -> str:
        """SHA-256 of family.json."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def save(self, path: str | Path) -> Path:
        """Write family.json at `path`, whole or not at all, and return the path."""
        return write_text(Path(path), self.text)

    @classmethod
    def load(cls, folder: str | Path) -> Family:
        """The family in a folder of necc-design.

        Raises
        ------
        OutputError
            When there is none, when it cannot be read, or when it is of another design.
        """
        folder = Path(folder)
        refuse_unfinished(folder)
        design, path = Design.load(folder), folder / FAMILY_FILE
        try:
            data = json.loads(read_text(path, _LARGEST))
            if data["design"] != design.hash:
                raise ValueError("it is of another design")
            return cls(design, _from_dict(data, design))
        except (*BROKEN, OSError) as problem:
            raise OutputError(
                "output", f"{path} cannot be read: {problem!r}", "Design again with necc-design."
            ) from None


def lift(design: Design, ranges: Ranges, parametric: Parametric | None = None) -> Family | NoFamily:
    """The family of a finished design: no training, the same controller at its own set-point.

    Parameters
    ----------
    design
        Finished; held by the published loop.
    ranges
        Set-points by state, uncertain parameters by name, disturbances by input.
    parametric
        The plant with its parameters as symbols; needed where some are uncertain.

    Returns
    -------
    Family or NoFamily
        Whether it is a good family the certificate says.
    """
    if design.learned is not None:
        return NoFamily("not_covered", "a learned Casimir is none exactly, at any set-point")
    found = family_loop(
        design.loop,
        design.casimirs.functions,
        design.x_star,
        ranges,
        parametric,
        phi_is_sum=design.form.phi is None,
    )
    return found if isinstance(found, NoFamily) else Family(design, found)


_MATRICES = ("J", "R", "G")


def _exactly(value: float | sp.Expr) -> sp.Expr:
    """A number as it is: a float is the binary number that it stands for."""
    return value if isinstance(value, sp.Expr) else sp.Rational(*float(value).as_integer_ratio())


def _to_dict(family: Family) -> dict[str, Any]:
    moved, plant = family.moved, family.moved.loop.plant
    names = (*family.design.loop.states, *(str(s) for s in moved.symbols))
    plain = identifiers(names)
    rename = {
        sp.Symbol(name, real=True): sp.Symbol(letter, real=True)
        for name, letter in zip(names, plain, strict=True)
    }

    def text(v: sp.Expr) -> str:
        return to_text(sp.sympify(v).xreplace(rename))

    def rows(matrix: sp.MatrixBase) -> list[list[str]]:
        return [[text(entry) for entry in row] for row in matrix.tolist()]

    return {
        "format": _FAMILY_FORMAT,
        "design": family.design.hash,
        "symbols": plain,
        "parameters": [
            {
                "name": p.name,
                "kind": p.kind,
                "symbol": str(p.symbol),
                "range": [text(v) for v in p.range],
                "nominal": text(p.nominal),
            }
            for p in moved.parameters
        ],
        "x_star": [text(v) for v in moved.x_star],
        "feedforward": [text(v) for v in moved.feedforward],
        **{name: rows(getattr(plant, name)) for name in _MATRICES},
        "H": text(plant.H),
    }


def _from_dict(data: Mapping[str, Any], design: Design) -> FamilyLoop:
    if data["format"] != _FAMILY_FORMAT:
        raise ValueError(f"format {data['format']!r}")
    names = (*design.loop.states, *(p["symbol"] for p in data["parameters"]))
    symbols = {
        plain: sp.Symbol(name, real=True)
        for plain, name in zip(data["symbols"], names, strict=True)
    }

    def read(text: str) -> sp.Expr:
        return parse(text, symbols)

    J, R, G = (
        sp.ImmutableMatrix([[read(v) for v in row] for row in data[name]]) for name in _MATRICES
    )
    plant = replace(design.loop.plant, H=read(data["H"]), J=J, R=R, G=G)
    parameters = tuple(
        Parameter(
            p["name"],
            p["kind"],
            sp.Symbol(p["symbol"], real=True),
            (read(p["range"][0]), read(p["range"][1])),
            read(p["nominal"]),
        )
        for p in data["parameters"]
    )
    return FamilyLoop(
        replace(design.loop, plant=plant),
        parameters,
        tuple(map(read, data["x_star"])),
        design.x_star,
        sp.ImmutableMatrix([read(v) for v in data["feedforward"]]),
    )
