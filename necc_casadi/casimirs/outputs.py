"""Outputs that are rates of functions of the plant's states, so that ξ need not be integrated.

Let Jc = Rc = 0, Gc be constant, and Casimirs have the values Aξ + g(x), A constant with a left
inverse A⁻. Then ξ − γ(x), γ = −A⁻g, is constant under every input u while v_c = 0:

    d(ξ − γ)/dt = Gc y − ∇γᵀ((J − R)∇H + Gu) = 0,   if ∇γᵀG = 0,

for the rows of x in ∇(ξ − γ)ᵀM = 0 say ∇γᵀ(J − R) = Gc Gᵀ. In canonical mechanics γ = Gc q.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import sympy as sp

from necc_casadi.errors import OptionError
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.symbolic.linear_algebra import reduced_rows
from necc_casadi.symbolic.zero import is_zero

__all__ = ["integrated_outputs", "refuse_kept", "refuse_without_time"]


def refuse_kept(why: str) -> NoReturn:
    """Say why ξ cannot be read off x.

    Raises
    ------
    OptionError
        Always.
    """
    raise OptionError("usage", f"--integrator casimir: {why}", "Use --integrator heun.")


def refuse_without_time() -> NoReturn:
    """Say that the steps of ξ depend on the longest time between two samples.

    Raises
    ------
    OptionError
        Always.
    """
    raise OptionError(
        "usage",
        "--integrator casimir without --sample-time",
        "Give the longest time between two samples: the steps of ξ depend on it.",
    )


def integrated_outputs(loop: ClosedLoop, casimirs: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
    """γ, (nc,) of x, with ξ − γ(x) constant under every u while v_c = 0.

    Parameters
    ----------
    loop
        Published; one of power shaping keeps ξ − γ(x) anyway.
    casimirs
        Proved functions of z, all linear in ξ.

    Raises
    ------
    OptionError
        Where there is no such γ, with the reason.
    """
    controller, x = loop.controller, loop.plant.x
    if isinstance(loop, ShapedLoop) or loop.plant.preliminary is not None:
        refuse_kept("it is for the published loop, and this target is held by another")
    if not (controller.Jc.is_zero_matrix and controller.Rc.is_zero_matrix):
        refuse_kept("ξ moves by itself, Jc and Rc are not 0")
    if controller.Gc.free_symbols:
        refuse_kept("Gc is not constant")
    columns = list(range(controller.nc))
    c = sp.Matrix(list(casimirs)) if casimirs else sp.zeros(0, 1)
    A = c.jacobian(controller.xi) if casimirs else sp.zeros(0, controller.nc)
    if A.free_symbols:
        refuse_kept("a Casimir is not linear in ξ")
    _, rows = reduced_rows(A.T)
    if len(rows) < controller.nc:
        refuse_kept("an output of the plant is not the rate of a function of its states")
    g = c.extract(rows, [0]).subs(dict.fromkeys(controller.xi, 0))
    gamma = -(A.extract(rows, columns).inv() * g)
    if not all(is_zero(entry) for entry in gamma.jacobian(x) * loop.plant.G):
        refuse_kept("an input moves a Casimir")
    return tuple(gamma)
