"""The global claim: ∇²V ⪰ μI and ∂²H/∂s² ⪰ μI for all states, by bounds of the networks.

LaSalle's principle then takes every solution to the one critical point.
"""

from __future__ import annotations

import sympy as sp
from flint import arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.hessian_floor import curvature_above, hessian_floor
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_everywhere
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.invariant_sets import largest_invariant_set_is_critical
from necc_casadi.certificate.checker.momenta import are_momenta
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_global"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


def check_global(evidence: Evidence, sound: bool) -> Checked:
    """∇²V ⪰ μI and ∂²H/∂s² ⪰ μI for all states, by periodicity and bounds of the networks.

    V then is radially unbounded with one critical point, and LaSalle's invariance principle
    takes every solution to it.
    """
    model, form = evidence.model, evidence.model.form

    def varying() -> set[sp.Symbol]:
        free: set[sp.Symbol] = (model.Jcl - model.Rcl).free_symbols | model.ports.free_symbols
        return free

    scope = Checked.by(
        "global",
        statements.GLOBAL,
        [
            ("z̄ attracts", lambda: sound),
            ("the claim is held", lambda: evidence.claimed("global")),
            ("the loop is of constant structure", lambda: not varying()),
            (
                "everything is smooth for all states",
                lambda: is_smooth_everywhere(model.written, model.z),
            ),
            ("Φ is the sum H + Hc + K(c)", lambda: form["phi"] is None and not form["betas"]),
        ],
    )
    return _on_the_whole_space(evidence) if scope.holds else scope


def _on_the_whole_space(evidence: Evidence) -> Checked:
    model, named = evidence.model, evidence.claims["global"].data["resting"]
    resting = [i for i in range(len(model.z)) if i in named]
    y, s = ([v for i, v in enumerate(model.z) if (i in resting) is rest] for rest in (False, True))
    slopes = [[sp.diff(c, v) for v in y] for c in model.casimirs]
    stiffness = sp.hessian(model.H, s) if s else sp.eye(1)

    def convex() -> bool:
        floors, rest = _floors(evidence), model.H.subs(dict.fromkeys(s, 0))
        return floors is not None and _bowl(
            sp.hessian(rest, y), _from_nets(slopes, floors, model.nc)
        )

    return Checked.by(
        "global",
        statements.GLOBAL,
        [
            ("the Casimirs are linear", lambda: not sp.Matrix(slopes).free_symbols),
            ("the resting states are momenta", lambda: are_momenta(model, resting)),
            (
                "invariant sets are critical points",
                lambda: largest_invariant_set_is_critical(model, resting, None),
            ),
            ("∂²H/∂s² ≻ 0 for all states", lambda: _bowl(stiffness, None)),
            ("∇²V ≻ 0 for all states, the momenta at rest", convex),
        ],
    )


def _floors(evidence: Evidence) -> list[arb_mat] | None:
    """Matrices below ∇²Hc and ∇²K for all arguments; None where a claimed bend is not proved."""
    form, result = evidence.model.form, []
    nets, shapes = (evidence.full.hc, evidence.full.k), (form["hc"], form["k"])
    bends = evidence.claims["global"].data["bends"]
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
