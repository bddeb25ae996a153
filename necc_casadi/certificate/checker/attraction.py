"""Whether the damped loop goes to z̄, re-proved in balls."""

from __future__ import annotations

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import lyapunov_matrix, middle_of, positive
from necc_casadi.certificate.checker.arithmetic.potential import hessian_hull
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_attraction", "check_only_stable"]


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
    stays = all(is_zero(entry) is True for entry in model.ports.T * slope)
    varies = any(is_zero(entry) is False for entry in slope)
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
