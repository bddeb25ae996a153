"""z̄: one critical point near z*, a strict minimum there, and whether the damped loop goes to it."""

from __future__ import annotations

import sympy as sp
from flint import arb, ctx

from necc_casadi.certificate.checker.arithmetic.balls import ball, by_bisection, ends
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims import statements

__all__ = ["check_equilibrium"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


#: Precision of ∇V at z* and z̄, where its parts cancel and rounding to doubles would remain.
_BITS = 128


def check_equilibrium(evidence: Evidence) -> Checked:
    """One critical point in the ball, ∇²V ⪰ μI there, and the distances."""
    c = evidence.certificate
    if c["mu"] is None or c["radius"] is None:
        return Checked("equilibrium", False, "no equilibrium is claimed")
    mu, radius, bound = (float(c[key]) for key in ("mu", "radius", "bound_rigorous"))
    with ctx.workprec(_BITS):
        target = evidence.model.target_balls()
        g = norm(evidence.full.gradient_at(target))
    data = evidence.claims["equilibrium"]["data"]
    holds = mu > 0 and radius > 0 and bool(g < arb(mu) * arb(radius))
    holds = holds and bool(g <= float(data["gradient_norm"]))
    holds = holds and bool(g / mu <= bound) and _enclosed(evidence, target)
    cube = tuple(ends(t + ball(-radius, radius)) for t in target)
    holds = holds and by_bisection(
        cube,
        lambda box: positive(evidence.full.hessian(box), mu),
        _DEPTH,
        _bending(evidence.model),
    )
    return Checked("equilibrium", holds, statements.equilibrium(radius, mu, bound))


def _bending(model: StoredDesign) -> list[bool]:
    """Which coordinates ∇²V varies with: it pays to halve no other side of a box."""
    found = set(model.z[model.n :]).union(*(c.free_symbols for c in model.casimirs))
    for term in sp.Add.make_args(model.H):
        for slope in (sp.diff(term, v) for v in term.free_symbols):
            found.update(*(sp.diff(slope, s).free_symbols for s in slope.free_symbols))
    return [v in found for v in model.z]


def _enclosed(evidence: Evidence, target: list[arb]) -> bool:
    """The minimum is within the claimed distance of the claimed z̄, inside the ball."""
    c = evidence.certificate
    z_bar = [float(v) for v in c["z_bar"]]
    with ctx.workprec(_BITS):
        residual = norm(evidence.full.gradient_at([arb(v) for v in z_bar]))
    near = norm([t - v for t, v in zip(target, z_bar, strict=True)])
    return bool(residual / float(c["mu"]) <= float(c["enclosure"])) and bool(
        near < float(c["radius"])
    )
