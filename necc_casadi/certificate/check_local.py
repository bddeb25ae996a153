"""z̄: one critical point near z*, a strict minimum there, and whether the damped loop goes to it."""

from __future__ import annotations

import sympy as sp
from flint import arb, arb_mat, ctx

import necc_casadi.certificate.statements as statements
from necc_casadi import exact as ex
from necc_casadi.certificate.ball_energy import hessian_hull
from necc_casadi.certificate.ball_matrices import lyapunov_matrix, middle_of, norm, positive
from necc_casadi.certificate.balls import Box, ball, ends, evaluate, everywhere
from necc_casadi.certificate.check_evidence import Checked, Evidence
from necc_casadi.certificate.check_model import Model

__all__ = ["check_attraction", "check_equilibrium", "check_only_stable"]

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
    holds = holds and everywhere(
        cube,
        lambda box: positive(evidence.full.hessian(box), mu),
        _DEPTH,
        _bending(evidence.model),
    )
    return Checked("equilibrium", holds, statements.equilibrium(radius, mu, bound))


def _bending(model: Model) -> list[bool]:
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


def check_attraction(evidence: Evidence, sound: bool) -> Checked:
    """The linearisation plus the claimed rate is Hurwitz, by a Lyapunov inequality."""
    rate = float(evidence.claims["attraction"]["data"]["rate"])
    text = statements.attraction(rate)
    if not sound or not rate >= 0:
        return Checked("attraction", False, text)
    box = evidence.z_bar(range(len(evidence.model.z)))
    A = _linearisation(evidence, box)
    n = A.nrows()
    for i in range(n):
        A[i, i] = A[i, i] + rate
    P = lyapunov_matrix(middle_of(A))
    if P is None:
        return Checked("attraction", False, text)
    P_exact = arb_mat(P.tolist())
    rate_matrix = -(P_exact * A + (P_exact * A).transpose())
    return Checked("attraction", positive(P_exact, 0) and positive(rate_matrix, 0), text)


def check_only_stable(evidence: Evidence, sound: bool) -> Checked:
    """z̄ is stable, and why no more is claimed: a Casimir that stays, or the verdict's witness."""
    model, data = evidence.model, evidence.claims["stability"]["data"]
    stable = sound and evidence.certificate["stability"] == "stable"
    if "conserved" not in data:
        witness, kind = model.verdict["witness"], model.verdict["stability"]
        text = statements.only_stable(str(witness))
        return Checked("stability", stable and kind == "stable" and bool(witness), text)
    index = int(data["conserved"])
    text = statements.conserved(model.casimir_texts[index])
    slope = sp.Matrix([sp.diff(model.casimirs[index], v) for v in model.z])
    stays = all(ex.is_zero(entry) is True for entry in model.ports.T * slope)
    varies = any(ex.is_zero(entry) is False for entry in slope)
    return Checked("stability", stable and stays and varies, text)


def _linearisation(evidence: Evidence, box: Box) -> arb_mat:
    model = evidence.model
    values = {s: ball(*b) for s, b in zip(model.z, box, strict=True)}

    def enclose(matrix: sp.Matrix) -> arb_mat:
        return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])

    ports, m = enclose(model.ports), model.m
    damping = arb_mat(2 * m, 2 * m)
    for i in range(m):
        for j in range(m):
            damping[i, j], damping[m + i, m + j] = arb(model.D[i][j]), arb(model.Dc[i][j])
    M = enclose(sp.Matrix(model.Jcl - model.Rcl))
    slope = evidence.full.slope(box)
    return (M / slope - ports * damping * ports.transpose()) * hessian_hull(evidence.full, box)
