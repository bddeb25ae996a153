"""The global claim: ∇²V ⪰ μI and ∂²H/∂s² ⪰ μI for all states, by bounds of the networks."""

from __future__ import annotations

import sympy as sp
from flint import arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.hessian_floor import curvature_above, hessian_floor
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.invariant_sets import largest_invariant_set_is_critical
from necc_casadi.certificate.checker.momenta import at_rest
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_global"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


def check_global(evidence: Evidence, sound: bool) -> Checked:
    """∇²V ⪰ μI and ∂²H/∂s² ⪰ μI for all states, by periodicity and bounds of the networks."""
    text = statements.GLOBAL
    model, form = evidence.model, evidence.model.form
    constant = not (model.Jcl - model.Rcl).free_symbols and not model.ports.free_symbols
    sound = sound and evidence.claimed("global")
    if not (sound and constant and form["phi"] is None and not form["betas"]):
        return Checked("global", False, text)
    named = evidence.claims["global"]["data"]["resting"]
    resting = [i for i in range(len(model.z)) if i in named]
    active = [i for i in range(len(model.z)) if i not in resting]
    y, s = ([model.z[i] for i in chosen] for chosen in (active, resting))
    slopes = [[sp.diff(c, v) for v in y] for c in model.casimirs]
    floors = _floors(evidence)
    holds = (
        floors is not None
        and not sp.Matrix(slopes).free_symbols
        and at_rest(model, resting)
        and largest_invariant_set_is_critical(model, resting, None)
        and _bowl(sp.hessian(model.H, s) if s else sp.eye(1), None)
        and _bowl(
            sp.hessian(model.H.subs(dict.fromkeys(s, 0)), y), _from_nets(slopes, floors, model.nc)
        )
    )
    return Checked("global", holds, text)


def _floors(evidence: Evidence) -> list[arb_mat] | None:
    """Matrices below ∇²Hc and ∇²K for all arguments; None where a claimed bend is not proved."""
    form, result = evidence.model.form, []
    nets, shapes = (evidence.full.hc, evidence.full.k), (form["hc"], form["k"])
    bends = evidence.claims["global"]["data"]["bends"]
    for net, shape, bend in zip(nets, shapes, bends, strict=True):
        if bend is None:
            result.append(hessian_floor(net, shape["activation"]))
            continue
        scalar = shape["activation"] == "tanh" and net.d == 1 and len(shape["hidden"]) > 0
        if not (scalar and curvature_above(net, float(bend))):
            return None
        floor = net.quadratic_curvature()
        floor[0, 0] = floor[0, 0] + float(bend)
        result.append(floor)
    return result


def _from_nets(slopes: list[list[sp.Expr]], floors: list[arb_mat], nc: int) -> arb_mat:
    N = arb_mat([[evaluate(v, {}) for v in row] for row in slopes])
    total = N.transpose() * floors[1] * N
    first = total.nrows() - nc
    for i in range(nc):
        for j in range(nc):
            total[first + i, first + j] = total[first + i, first + j] + floors[0][i, j]
    return total


def _bowl(matrix: sp.Matrix, added: arb_mat | None) -> bool:
    """Whether matrix + added ≻ 0 for all values of its symbols, in each of which it repeats."""
    symbols = sorted(matrix.free_symbols, key=str)
    shifted = [matrix.subs(v, v + 2 * sp.pi) - matrix for v in symbols]
    if not all(is_zero(entry) is True for change in shifted for entry in change):
        return False

    def test(box: Box) -> bool:
        values = {v: ball(*b) for v, b in zip(symbols, box, strict=True)}
        A = arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])
        return positive(A if added is None else A + added, 1e-9)

    return by_bisection(tuple((-3.15, 3.15) for _ in symbols), test, _DEPTH)
