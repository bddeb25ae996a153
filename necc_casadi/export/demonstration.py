"""``main.c``: the controller in closed loop with its plant."""

from __future__ import annotations

import casadi as ca

from necc_casadi.arrays import Vector
from necc_casadi.export.casadi2c import c_function
from necc_casadi.export.source import Source
from necc_casadi.export.templating import fill
from necc_casadi.symbolic.identifiers import identifiers

__all__ = ["demonstration"]


_STEPS = 2000


def demonstration(source: Source) -> str:
    """The text of ``main.c``."""
    terms, real = source.design.lyapunov.terms, source.number
    x, u = ca.SX.sym("x", source.n), ca.SX.sym("u", source.m)
    x_dot = terms.drift(x) + terms.directions(x) @ u
    measured = terms.measured
    maps = [
        c_function("measure", [("x", x)], [("y", measured.output(x))], real),
        c_function("model_state", [("y", x)], [("x", measured.state(x))], real),
    ]
    inner = [*source.design.loop.controller.states, *source.zeta_names]
    columns = [
        *source.design.measurement.names,
        *inner,
        *source.input_columns,
        "flags",
    ]
    text = fill(
        "main.c",
        sample_time=f"{source.step_time:.6g}",
        sample_literal=real.literal(source.step_time),
        plant=c_function("plant", [("x", x), ("u", u)], [("xdot", x_dot)], real),
        measure="\n".join(maps),
        rk4_fractions=real.literals((0, 0.5, 0.5, 1)),
        rk4_weights=real.literals((1, 2, 2, 1)),
        six=real.literal(6),
        zero=real.literal(0),
        digits=9 if real.suffix else 17,
        x_start=real.literals(_start(source)),
        steps=_STEPS,
        columns=",".join(["t", *identifiers(columns)]),
    )
    return source.named(text)


def _start(source: Source) -> Vector:
    """A quarter of the way from the target to the lower end of the domain, as measured, (n,)."""
    lo = source.design.domain.lo
    return source.design.lyapunov.measured((0.75 * source.design.z_star + 0.25 * lo)[: source.n])
