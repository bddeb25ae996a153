"""V and the control law of a family as CasADi functions of its parameters ϑ, beside the state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.lyapunov.lyapunov import Terms, control_law, make_terms, value
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.model.rescale import exactly, rescaled_loop
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.floats import to_float

__all__ = ["control_law_over", "energies_of", "value_over"]


@dataclass(frozen=True, eq=False)
class _Moved:
    """Terms at one ϑ, and what leads from x to x̂ and from û to u."""

    terms: Terms
    shift: ca.MX  # (n,) x − x̂
    feedforward: ca.MX  # (m,) u − û


def control_law_over(
    moved: FamilyLoop, casimirs: Casimirs, form: Form, weights: Vector, damping: Vector
) -> ca.Function:
    """(x, ξ, r) -> (u, ξ̇): the plant nominal, r (setpoints,) in order."""
    n, nc = moved.loop.plant.n, moved.loop.controller.nc
    x, xi = ca.MX.sym("x", n), ca.MX.sym("xi", nc)
    free = moved.of("setpoint")
    r = ca.MX.sym("r", len(free), 1)
    own = {p.name: r[k] for k, p in enumerate(free)}
    theta = [own.get(p.name, ca.MX(to_float(p.nominal))) for p in moved.parameters]
    at = _at(moved, casimirs, ca.vertcat(*theta))
    u, xi_dot = control_law(at.terms, form, ca.DM(weights), ca.DM(damping), x - at.shift, xi)
    names = ["x", "xi", "r"], ["u", "xi_dot"]
    return ca.Function("necc", [x, xi, r], [u + at.feedforward, xi_dot], *names)


def value_over(moved: FamilyLoop, casimirs: Casimirs, form: Form, weights: Vector) -> ca.Function:
    """(ẑ, ϑ) -> V: ẑ = (x̂, ξ), ϑ (parameters,) in order."""
    z = ca.MX.sym("z", moved.loop.n)
    theta = ca.MX.sym("theta", len(moved.parameters), 1)
    terms, w = _at(moved, casimirs, theta).terms, ca.DM(weights)
    V = value(terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))
    return ca.Function("V", [z, theta], [V], ["z", "theta"], ["V"])


def energies_of(
    moved: FamilyLoop, units: Sizes, shares: Vector
) -> tuple[ca.Function, list[ca.Function]]:
    """H(x̂) of the nominal member, and of those at these shares (S, parameters) of each range.

    Energy and states are measured in `units`.
    """

    def energy(values: dict[str, Any]) -> ca.Function:
        plant = rescaled_loop(moved.at(values), units).plant
        return casadi_function("H", plant.x, [plant.H])

    def place(row: Vector) -> dict[str, Any]:
        return {
            p.name: p.range[0] + share * (p.range[1] - p.range[0])
            for p, share in zip(moved.parameters, exactly(row), strict=True)
        }

    return energy({}), [energy(place(row)) for row in shares]


def _at(moved: FamilyLoop, casimirs: Casimirs, theta: ca.MX) -> _Moved:
    """The terms of the loop at ϑ, in the states x̂."""
    loop, plant = moved.loop, moved.loop.plant
    terms = make_terms(moved.at({}), casimirs)

    def of(name: str, states: Sequence[Any], matrix: Any) -> Any:
        function = casadi_function(name, (*states, *moved.symbols), matrix)
        return lambda at: function(ca.vertcat(at, theta))

    inside = replace(
        terms,
        H=of("H", plant.x, [plant.H]),
        grad_H=of("grad_H", plant.x, gradient(plant.H, plant.x)),
        drift=of("drift", plant.x, plant.drift),
        directions=of("directions", plant.x, plant.directions),
        M=of("M", loop.z, loop.M),
        ports=of("ports", loop.z, loop.ports),
        own_structure=of("own_structure", loop.z, loop.own_structure),
        own_ports=of("own_ports", loop.z, loop.own_ports),
    )
    nothing = ca.MX.zeros(0)
    return _Moved(
        inside,
        of("shift", (), moved.shift)(nothing),
        of("feedforward", (), moved.feedforward)(nothing),
    )
