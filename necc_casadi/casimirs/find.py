"""Casimirs of the closed loop: ker Jcl ∩ ker Rcl to closed forms, counted and proved.

eq. CasimirCondition: ∇Cᵀ(Jcl − Rcl) = 0 for every z; because Rcl ⪰ 0 this is
∇C ∈ ker Jcl ∩ ker Rcl.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp
from sympy.functions.elementary.trigonometric import TrigonometricFunction

from necc_casadi.casimirs.ansatz import CasimirSearch, ClosedForm, find_closed_forms
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.condition import independent, rates
from necc_casadi.casimirs.involution import count_casimirs
from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.entries import scalar_entry
from necc_casadi.model.piece import LoopPiece, loop_piece
from necc_casadi.symbolic.linear_algebra import generic_rank, kernel
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = ["find_casimirs"]


def find_casimirs(
    loop: ClosedLoop,
    supplied: Sequence[sp.Expr] = (),
    target: Mapping[sp.Symbol, sp.Expr] | None = None,
) -> Casimirs:
    """Count the Casimirs of `loop` and find closed forms (eq. CasimirCondition).

    Parameters
    ----------
    loop
        Plant and controller.
    supplied
        Casimirs that the user knows; each is proved, and taken before others are sought.
    target
        Plant states at the target; forms without poles there are preferred.

    Returns
    -------
    Casimirs
        r closed forms of z and how many exist; fewer closed forms than exist are no error.

    Raises
    ------
    ModelError
        ``casimir_disproved`` for a supplied function that is not a Casimir, or that cannot be
        proved to be one.

    References
    ----------
    Nijmeijer and van der Schaft (1990), Frobenius' theorem: how many exist.

    Examples
    --------
    >>> from necc_casadi import find_casimirs, load_model
    >>> find_casimirs(load_model("pendulum.py").loop).functions
    (q - xi1,)
    """
    given = [_proved(loop, c, i) for i, c in enumerate(supplied)]
    around = loop_piece(loop, dict(target or {}))
    try:
        return _found(around, given, dict(target or {}))
    except Undecided as unknown:  # a pivot of the kernel: no count, no closed form but those given
        functions = tuple(f for k, f in enumerate(given) if independent(given[:k], f, loop.z))
        most, origins = loop.n, ("supplied",) * len(functions)
        return Casimirs(functions, most, most, origins, False, str(unknown))


def _found(
    around: LoopPiece, given: Sequence[sp.Expr], target: Mapping[sp.Symbol, sp.Expr]
) -> Casimirs:
    """What is found on the analytic piece around the target."""
    loop = around.loop
    kernel_rank = loop.n - generic_rank(sp.Matrix(loop.M))
    if not loop.M.free_symbols:
        return _constant(loop, kernel_rank)
    search = CasimirSearch(loop, kernel_rank, target)
    return _counted(around, search, given, kernel_rank)


def _constant(loop: ClosedLoop, kernel_rank: int) -> Casimirs:
    """All Casimirs of a constant structure: vᵀz for a basis v of the kernel.

    Every other one, so every supplied one, is a function of these.
    """
    basis = kernel(sp.Matrix(loop.M).T)
    functions = tuple(linear_form(basis[:, i], loop.z) for i in range(basis.cols))
    return Casimirs(functions, kernel_rank, kernel_rank, ("constant kernel",) * basis.cols)


def linear_form(v: sp.MatrixBase, z: Sequence[sp.Symbol]) -> sp.Expr:
    """vᵀz."""
    return sp.Add(*[v[i] * s for i, s in enumerate(z) if v[i] != 0])


def _counted(
    around: LoopPiece, search: CasimirSearch, given: Sequence[sp.Expr], kernel_rank: int
) -> Casimirs:
    """Constant sub-kernel and supplied ones, then the count, then closed forms up to the count."""
    loop = around.loop
    forms: list[ClosedForm] = []
    find_closed_forms(search, forms, kernel_rank, "constant")
    for c in given:
        if independent([form.function for form in forms], c, loop.z):
            forms.append(ClosedForm(c, "supplied"))
    find_closed_forms(search, forms, kernel_rank, "quick")
    count, proved = count_casimirs(sp.Matrix(loop.M), loop.z, len(forms), around.box)
    if len(forms) < count:
        find_closed_forms(search, forms, count)
    functions = tuple(
        form.function if form.function in given else _shortened(form.function) for form in forms
    )
    origins = tuple(form.origin for form in forms)
    return Casimirs(functions, kernel_rank, count, origins, proved and around.joined)


def _shortened(c: sp.Expr) -> sp.Expr:
    """The same function by addition theorems, where that is shorter and proved equal."""
    if not c.has(TrigonometricFunction):
        return c
    shorter = sp.trigsimp(c)
    same = sp.count_ops(shorter) < sp.count_ops(c) and is_zero(c - shorter) is True
    return shorter if same else c


def _proved(loop: ClosedLoop, c: sp.Expr, index: int) -> sp.Expr:
    c = scalar_entry(c, f"casimirs[{index}]", loop.z)
    label = f"casimirs[{index}] = {c}"
    for j, rate in enumerate(rates(c, loop)):
        verdict = is_zero(rate)
        if verdict is not True:
            how = "is not 0" if verdict is False else "could not be shown to be 0"
            shown = str(sp.factor_terms(rate))
            raise ModelError(
                "casimir_disproved",
                f"{label} is not a Casimir: entry {j} of ∇Cᵀ(Jcl − Rcl) = {shown[:80]} {how}",
                "Every entry of ∇Cᵀ(Jcl − Rcl) must vanish for all states; correct or drop it.",
            )
    if not c.free_symbols:
        raise ModelError(
            "casimir_disproved",
            f"{label} is a constant",
            "A Casimir must depend on the states; drop it.",
        )
    return c
