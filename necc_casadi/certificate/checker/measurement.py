"""What is measured in place of the momenta, and whether the law needs the model's masses."""

from __future__ import annotations

from functools import partial

import sympy as sp

from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.loops import StoredShaping
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_measurement", "gives_momenta"]


def check_measurement(evidence: Evidence) -> Checked | None:
    """P = M q̇, from ẋ of the plant; None where the states are measured and nothing is claimed."""
    model = evidence.model
    if model.inertia is None and "measurement" not in evidence.claims:
        return None
    text = statements.MEASURED_OF_THIS_MASS
    if _needs_no_mass(model):
        text = statements.MEASURED_OF_ANY_MASS
    return Checked.by(
        "measurement", text, [("q̇ of the plant at p = M q̇", partial(gives_momenta, model))]
    )


def gives_momenta(model: StoredDesign) -> bool:
    """Whether q̇ of the plant at p = M q̇ is q̇, and no input enters it."""
    M, (k, odd) = model.inertia, divmod(model.n, 2)
    if M is None or odd or M.shape != (k, k):
        return False
    x = model.z[: model.n]
    rates = [sp.Dummy(real=True) for _ in range(k)]
    there = dict(zip(x[k:], M * sp.Matrix(rates), strict=True))
    if model.ahead is None:
        flow = (model.J - model.R) * sp.Matrix([sp.diff(model.H, s) for s in x])
        inputs = model.G
    else:
        flow, inputs = model.ahead.f, model.ahead.g
    left = [flow[i, 0].xreplace(there) - rates[i] for i in range(k)]
    return all(is_zero(entry) is True for entry in (*left, *inputs[:k, :]))


def _needs_no_mass(model: StoredDesign) -> bool:
    """Published loop, Φ the sum, no momentum in c and G, no friction in the rows of q."""
    published = not isinstance(model.loop, StoredShaping) and model.ahead is None
    k = model.n // 2
    momenta = set(model.z[k : model.n])
    seen = set().union(
        *(entry.free_symbols for entry in (*model.casimirs, *model.G, *model.J[:k, :]))
    )
    unresisted = all(entry == 0 for entry in model.R[:k, :])
    canonical = all(
        bool(model.J[i, j].is_positive) if j == k + i else model.J[i, j] == 0
        for i in range(k)
        for j in range(model.n)
    )
    plain = published and model.form["phi"] is None and unresisted
    return bool(plain and canonical and not momenta & seen)
