"""V never increases: the Casimir condition, the structure, Φ₁ > 0 and the damping, exactly.

Of V̇ = −∇Vᵀ Rcl ∇V / Φ₁ − ∇Vᵀ 𝒢𝒟𝒢ᵀ ∇V (Lemma EnergyCasimirControl) every sign is proved again.
"""

from __future__ import annotations

import math
from functools import partial

import sympy as sp

from necc_casadi.certificate.checker.arithmetic.definite import exactly_positive
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.loops import StoredFeedback, StoredShaping
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_decrease"]


def check_decrease(evidence: Evidence) -> list[Checked]:
    """The conditions of V̇ ≤ 0, then V̇ ≤ 0 itself."""
    model = evidence.model
    conditions = [_casimir(model), _structure(model), _slope(evidence), _damping(model)]
    conditions += [] if model.ahead is None else [_matching(model, model.ahead)]
    proved = ((condition.name, partial(bool, condition.holds)) for condition in conditions)
    return [*conditions, Checked.by("decrease", statements.DECREASE, proved)]


def _casimir(model: StoredDesign) -> Checked:
    """∇CᵀM = 0 for every closed form (eq. CasimirCondition)."""
    M = model.Jcl - model.Rcl

    def stays(c: sp.Expr) -> bool:
        return _vanishes(sp.Matrix([[sp.diff(c, v) for v in model.z]]) * M)

    named = zip(model.casimir_texts, model.casimirs, strict=True)
    obligations = ((f"the condition for {text}", partial(stays, c)) for text, c in named)
    return Checked.by("casimir", statements.casimir(model.casimir_texts), obligations)


def _structure(m: StoredDesign) -> Checked:
    """Skewness, semidefiniteness and what ties α to γ, exactly."""
    loop = m.loop
    skew = [(f"{name} = −{name}ᵀ", partial(_vanishes, A + A.T)) for name, A in loop.skew.items()]
    dissipative = [
        (f"{name} = {name}ᵀ ⪰ 0", partial(_is_dissipative, A))
        for name, A in loop.dissipative.items()
    ]
    zero = [(f"{name} = 0", partial(_vanishes, A)) for name, A in loop.zero.items()]
    shaped = isinstance(loop, StoredShaping)
    text = statements.SHAPED_STRUCTURE if shaped else statements.STRUCTURE
    return Checked.by("structure", text, [*skew, *dissipative, *zero])


def _matching(model: StoredDesign, ahead: StoredFeedback) -> Checked:
    """The plant ẋ = f + g u under u = u₀ + Bũ is the structure that everything else is about."""
    slope = sp.Matrix([sp.diff(model.H, s) for s in model.z[: model.n]])
    flow = (model.J - model.R) * slope
    obligations = [
        ("f + g u₀ = (J − R)∇H", partial(_vanishes, ahead.f + ahead.g * ahead.u0 - flow)),
        ("g B = G", partial(_vanishes, ahead.g * ahead.gain - model.G)),
    ]
    return Checked.by("matching", statements.MATCHING, obligations)


def _vanishes(A: sp.Matrix) -> bool:
    return all(is_zero(entry) is True for entry in A)


def _is_dissipative(R: sp.Matrix) -> bool:
    return _vanishes(R - R.T) and is_positive_semidefinite(R) is True


def _slope(evidence: Evidence) -> Checked:
    """Φ₁ > 0: the sum has 1, the neural form δ."""
    model = evidence.model
    claimed = evidence.number("slope", "slope")
    neural = model.form["phi"] is not None
    return Checked.by(
        "slope",
        statements.slope(claimed if neural else None),
        [
            ("the weights are finite", lambda: all(math.isfinite(w) for w in model.weights)),
            ("the bound of Φ₁ is positive", lambda: claimed > 0),
            (f"the form has Φ₁ ≥ {claimed:.6g}", lambda: claimed <= model.delta),
        ],
    )


def _damping(model: StoredDesign) -> Checked:
    """𝒟 + 𝒟ᵀ ≻ 0 by elimination over the rationals."""
    obligations = [("the symmetric part is ≻ 0", partial(exactly_positive, model.damping))]
    return Checked.by("damping", statements.DAMPING, obligations)
