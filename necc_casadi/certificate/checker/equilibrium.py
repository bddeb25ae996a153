"""z̄: one critical point of V near z*, a strict minimum there (eq. ErrorUpperBound, with μ)."""

from __future__ import annotations

import sympy as sp
from flint import arb, ctx

from necc_casadi.certificate.checker.arithmetic.balls import ball, by_bisection, ends
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims import statements

__all__ = ["check_equilibrium"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


#: Precision of ∇V at z* and z̄, where its parts cancel and rounding to doubles would remain.
_BITS = 128


def check_equilibrium(evidence: Evidence) -> Checked:
    """One critical point in the ball, ∇²V ⪰ μI there, and the distances: ‖z̄ − z*‖ ≤ g/μ.

    With g = ‖∇V(z*)‖ < μr, eq. ErrorUpperBound holds with μ, which is proved, for its a.
    """
    c, model = evidence.certificate, evidence.model
    mu, radius, bound, enclosure = c.mu, c.radius, c.bound_rigorous, c.enclosure
    if mu is None or radius is None or bound is None or enclosure is None:
        return Checked("equilibrium", False, "no equilibrium is claimed")
    with ctx.workprec(_BITS):
        target = model.target_balls()
        g = norm(evidence.full.gradient_at(target))
    claimed = evidence.number("equilibrium", "gradient_norm")
    cube = tuple(ends(t + ball(-radius, radius)) for t in target)
    near = norm([t - v for t, v in zip(target, evidence.minimum, strict=True)])
    natural = bound / model.units.largest

    def convex() -> bool:
        return by_bisection(
            cube, lambda box: positive(evidence.full.hessian(box), mu), _DEPTH, _bending(model)
        )

    return Checked.by(
        "equilibrium",
        statements.equilibrium(radius, mu, natural),
        [
            ("μ and the radius are positive", lambda: mu > 0 and radius > 0),
            ("‖∇V(z*)‖ is less than μ times the radius", lambda: bool(g < arb(mu) * arb(radius))),
            ("‖∇V(z*)‖ is at most what is claimed", lambda: bool(g <= claimed)),
            ("‖∇V(z*)‖/μ is at most the distance claimed", lambda: bool(g / mu <= natural)),
            (
                "z̄ is as near to the claimed point as is claimed",
                lambda: bool(_residual(evidence) / mu <= enclosure),
            ),
            ("the claimed z̄ is in the ball", lambda: bool(near < radius)),
            (
                "H, the Casimirs and the loop are smooth on the cube",
                lambda: is_smooth_on(model.written, model.z, cube),
            ),
            ("∇²V ⪰ μI on the cube around the ball", convex),
        ],
    )


def _bending(model: StoredDesign) -> list[bool]:
    """Which coordinates ∇²V varies with: it pays to halve no other side of a box."""
    found = set(model.z[model.n :]).union(*(c.free_symbols for c in model.casimirs))
    for term in sp.Add.make_args(model.H):
        for slope in (sp.diff(term, v) for v in term.free_symbols):
            found.update(*(sp.diff(slope, s).free_symbols for s in slope.free_symbols))
    return [v in found for v in model.z]


def _residual(evidence: Evidence) -> arb:
    """‖∇V‖ at the claimed z̄."""
    with ctx.workprec(_BITS):
        return norm(evidence.full.gradient_at([arb(v) for v in evidence.minimum]))
