"""The same loop in other units, exactly.

With z = S ẑ, t = T τ, H = E Ĥ, u = U û and y = (E/TU) ŷ the loop keeps its form (eq. Plant,
Controller, PlantControllerInterconnection):

    Ĥ(x̂) = H(Sx̂)/E,  Ĵ = TE S⁻¹JS⁻¹ (R, Jc, Rc alike),  Ĝ = T S⁻¹GU,  Ĝc = E S⁻¹Gc U⁻¹;
    of power shaping γ̂ = S⁻¹γ(Sx̂),  α̂ = E U⁻¹αS⁻¹,  v̂_c = T S⁻¹v_c;
    of preliminary feedback  f̂ = T S⁻¹f,  ĝ = T S⁻¹gU,  û₀ = U⁻¹u₀,  B̂ = U⁻¹BU;
    of velocities  M̂ = T⁻¹S_p⁻¹M S_q,  p̂ = M̂q̂̇.

Powers of two make every number of the new loop the old one with another exponent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.control_affine import ControlAffine, Equilibria, Preliminary
from necc_casadi.model.controller import Controller
from necc_casadi.model.plant import Plant
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.model.sizes import Sizes

__all__ = [
    "exactly",
    "rescaled_functions",
    "rescaled_inertia",
    "rescaled_loop",
    "rescaled_motion",
]


def exactly(values: Vector) -> list[sp.Rational]:
    """Floats as the rationals that they are."""
    return [sp.Rational(*float(value).as_integer_ratio()) for value in values]


def rescaled_loop(loop: ClosedLoop, units: Sizes) -> ClosedLoop:
    """Plant and controller measured in `units`; names of states stay, names of units go.

    What is measured of it are its states.
    """
    plant, controller = loop.plant, loop.controller
    scale = _substitution(loop, units)
    state = exactly(units.state)
    energy, time = exactly(np.array([units.energy, units.time]))
    rows, inner = state[: plant.n], state[plant.n :]
    u = exactly(units.input)

    def structure(matrix: sp.MatrixBase, size: Sequence[sp.Expr]) -> sp.ImmutableMatrix:
        return _entries(matrix, scale, lambda i, j: time * energy / (size[i] * size[j]))

    measured = Plant(
        name=plant.name,
        x=plant.x,
        J=structure(plant.J, rows),
        R=structure(plant.R, rows),
        G=_entries(plant.G, scale, lambda i, j: time * u[j] / rows[i]),
        H=_scaled(plant.H, scale, 1 / energy),
        domain={
            name: (lo / state[loop.states.index(name)], hi / state[loop.states.index(name)])
            for name, (lo, hi) in plant.domain.items()
        },
        u_limits=None
        if plant.u_limits is None
        else tuple(
            (lo / float(size), hi / float(size))
            for (lo, hi), size in zip(plant.u_limits, units.input, strict=True)
        ),
        sizes=_sizes(loop, units),
        inputs=plant.inputs,
        properties=plant.properties,
        preliminary=None
        if plant.preliminary is None
        else Preliminary(
            f=_entries(plant.preliminary.f, scale, lambda i, j: time / rows[i]),
            g=_entries(plant.preliminary.g, scale, lambda i, j: time * u[j] / rows[i]),
            u0=_entries(plant.preliminary.u0, scale, lambda i, j: 1 / u[i]),
            gain=_entries(plant.preliminary.gain, scale, lambda i, j: u[j] / u[i]),
        ),
    )
    if isinstance(loop, ShapedLoop):
        pairs = zip(loop.shaping, inner, strict=True)
        return ShapedLoop(
            measured,
            controller,
            tuple(_scaled(g, scale, 1 / size) for g, size in pairs),
            _entries(loop.alpha, scale, lambda i, j: energy / (u[i] * inner[j])),
        )
    return ClosedLoop(
        measured,
        Controller(
            xi=controller.xi,
            Jc=structure(controller.Jc, inner),
            Rc=structure(controller.Rc, inner),
            Gc=_entries(controller.Gc, scale, lambda i, j: energy / (inner[i] * u[j])),
            properties=controller.properties,
        ),
    )


def rescaled_inertia(loop: ClosedLoop, units: Sizes) -> sp.ImmutableMatrix | None:
    """M of p = M(q)q̇ in `units`; None where no velocities are measured. The loop itself takes x."""
    plant, k = loop.plant, loop.plant.n // 2
    if plant.inertia is None:
        return None
    rows, (time,) = exactly(units.state), exactly(np.array([units.time]))
    scale = _substitution(loop, units)
    return _entries(plant.inertia, scale, lambda i, j: rows[j] / (time * rows[k + i]))


def rescaled_motion(system: Equilibria, units: Sizes) -> ControlAffine:
    """ẋ = f + g u in `units`, of which those of x, u and the time count."""
    time = exactly(np.array([units.time]))[0]
    rows, u = exactly(units.state[: system.n]), exactly(units.input)
    scale = {s: size * s for s, size in zip(system.x, rows, strict=True) if size != 1}
    return ControlAffine(
        name="",
        x=system.x,
        f=_entries(system.drift, scale, lambda i, j: time / rows[i]),
        g=_entries(system.directions, scale, lambda i, j: time * u[j] / rows[i]),
    )


def rescaled_functions(
    functions: Sequence[sp.Expr], loop: ClosedLoop, units: Sizes
) -> tuple[sp.Expr, ...]:
    """c(Sẑ)/S_c for functions c of z, such as Casimirs."""
    scale = _substitution(loop, units)
    sizes = exactly(units.casimir)
    return tuple(_scaled(c, scale, 1 / size) for c, size in zip(functions, sizes, strict=True))


def _substitution(loop: ClosedLoop, units: Sizes) -> dict[sp.Symbol, sp.Expr]:
    """Each state -> the same symbol times its unit."""
    pairs = zip(loop.z, exactly(units.state), strict=True)
    return {symbol: size * symbol for symbol, size in pairs if size != 1}


def _scaled(expr: sp.Expr, scale: Mapping[sp.Symbol, sp.Expr], factor: sp.Expr) -> sp.Expr:
    return expr.xreplace(scale) * factor


def _entries(
    matrix: sp.MatrixBase, scale: Mapping[sp.Symbol, sp.Expr], factor: Callable[[int, int], sp.Expr]
) -> sp.ImmutableMatrix:
    entries = {(i, j): _scaled(v, scale, factor(i, j)) for (i, j), v in matrix.todok().items()}
    return sp.ImmutableMatrix(sp.SparseMatrix(*matrix.shape, entries))


def _sizes(loop: ClosedLoop, units: Sizes) -> dict[str, sp.Expr]:
    """The sizes that the model names, in the new units."""
    names = (*loop.states, *loop.plant.input_names)
    unit = dict(zip(names, [*exactly(units.state), *exactly(units.input)], strict=True))
    return {name: size / unit[name] for name, size in loop.plant.sizes.items()}
