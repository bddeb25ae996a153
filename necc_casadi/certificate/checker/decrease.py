"""V never increases: the Casimir condition, the structure, Φ₁ > 0 and the damping, exactly."""

from __future__ import annotations

import math

import sympy as sp

from necc_casadi.certificate.checker.arithmetic.definite import exactly_positive
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_casimir", "check_damping", "check_slope", "check_structure"]


def check_casimir(model: StoredDesign) -> Checked:
    """∇CᵀM = 0 for every closed form (eq. CasimirCondition)."""
    M = model.Jcl - model.Rcl
    rows = [sp.Matrix([[sp.diff(c, v) for v in model.z]]) * M for c in model.casimirs]
    holds = all(is_zero(entry) is True for row in rows for entry in row)
    return Checked("casimir", holds, statements.casimir(model.casimir_texts))


def check_structure(m: StoredDesign) -> Checked:
    """Skewness and semidefiniteness, exactly."""
    skew = all(is_zero(e) is True for A in (m.J, m.Jc) for e in A + A.T)
    symmetric = all(is_zero(e) is True for A in (m.R, m.Rc) for e in A - A.T)
    dissipative = all(is_positive_semidefinite(A) is True for A in (m.R, m.Rc))
    return Checked("structure", skew and symmetric and dissipative, statements.STRUCTURE)


def check_slope(evidence: Evidence) -> Checked:
    """Φ₁ > 0: the sum has 1, the neural form δ."""
    model = evidence.model
    claimed = float(evidence.claims["slope"]["data"]["slope"])
    holds = all(math.isfinite(w) for w in model.weights) and 0 < claimed <= model.delta
    neural = model.form["phi"] is not None
    return Checked("slope", holds, statements.slope(claimed if neural else None))


def check_damping(model: StoredDesign) -> Checked:
    """D, Dc ≻ 0 by elimination over the rationals."""
    holds = all(exactly_positive(A) for A in (model.D, model.Dc))
    return Checked("damping", holds, statements.DAMPING)
