"""V decreases along the damped loop, by algebra (Lemma EnergyCasimirControl).

V̇ = −∇Vᵀ Rcl ∇V / Φ₁ − ∇Vᵀ 𝒢𝒟𝒢ᵀ ∇V ≤ 0 everywhere, given ∇Cᵀ(Jcl − Rcl) = 0, Φ₁ > 0, Rcl ⪰ 0 and
𝒟 + 𝒟ᵀ ≻ 0. Each of the four is proved here again from the design's own expressions and numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.definite import exactly_positive_definite
from necc_casadi.designs.design import Design
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.identifiers import identifiers
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Decrease", "casimir_texts", "prove_decrease"]


@dataclass(frozen=True)
class Decrease:
    """The conditions of V̇ ≤ 0, and V̇ ≤ 0 itself."""

    casimir: Claim
    structure: Claim
    slope: Claim
    damping: Claim
    matching: Claim | None = None  # of feedback ahead of the loop

    @property
    def conditions(self) -> tuple[Claim, ...]:
        """What V̇ ≤ 0 takes."""
        found = (self.casimir, self.structure, self.slope, self.damping)
        return found if self.matching is None else (*found, self.matching)

    @property
    def decrease(self) -> Claim:
        """V̇ ≤ 0."""
        missing = [claim.name for claim in self.conditions if not claim.holds]
        if missing:
            text = f"V is not proved to decrease, for want of: {', '.join(missing)}"
            return Claim("decrease", False, text)
        return Claim("decrease", True, statements.DECREASE)

    @property
    def claims(self) -> tuple[Claim, ...]:
        """All of them."""
        return *self.conditions, self.decrease


def prove_decrease(design: Design) -> Decrease:
    """The conditions of V̇ ≤ 0, from the design's own expressions and numbers."""
    parts = _casimir(design), _structure(design), _slope(design), _damping(design)
    return Decrease(*parts, _matching(design))


def _matching(design: Design) -> Claim | None:
    plant = design.loop.plant
    if plant.preliminary is None:
        return None
    if not plant.preliminary.matches(plant.flow, plant.G):
        text = "the feedback ahead of the loop is not proved to give the plant its structure"
        return Claim("matching", False, text)
    return Claim("matching", True, statements.MATCHING)


def _casimir(design: Design) -> Claim:
    """The Casimir condition (eq. CasimirCondition) for every closed form that the design uses."""
    loop = design.loop
    left = [
        c
        for c in design.casimirs.functions
        if not all(is_zero(entry) for entry in loop.M.T * gradient(c, loop.z))
    ]
    if left:
        return Claim("casimir", False, f"∇Cᵀ(Jcl − Rcl) = 0 is not proved for {left[0]}")
    return Claim("casimir", True, statements.casimir(casimir_texts(design)))


def casimir_texts(design: Design) -> list[str]:
    """The closed forms as design.json writes them."""
    loop = design.loop
    names = [sp.Symbol(name, real=True) for name in identifiers(loop.states)]
    rename = dict(zip(loop.z, names, strict=True))
    return [to_text(sp.sympify(c).xreplace(rename)) for c in design.casimirs.functions]


def _structure(design: Design) -> Claim:
    loop, plant, controller = design.loop, design.loop.plant, design.loop.controller
    proved = {"J = −Jᵀ": _is_skew(plant.J), "R = Rᵀ ⪰ 0": _is_dissipative(plant.R)}
    if isinstance(loop, ShapedLoop):
        text = statements.SHAPED_STRUCTURE
        proved |= {"(J − R)∇γ = −Gα": all(is_zero(entry) for entry in loop.mismatch)}
    else:
        text = statements.STRUCTURE
        proved |= {
            "Jc = −Jcᵀ": _is_skew(controller.Jc),
            "Rc = Rcᵀ ⪰ 0": _is_dissipative(controller.Rc),
        }
    missing = [name for name, holds in proved.items() if not holds]
    if missing:
        return Claim("structure", False, f"held at sampled points only: {', '.join(missing)}")
    return Claim("structure", True, text)


def _is_skew(J: sp.MatrixBase) -> bool:
    return all(is_zero(entry) for entry in J + J.T)


def _is_dissipative(R: sp.MatrixBase) -> bool:
    symmetric = all(is_zero(entry) for entry in R - R.T)
    return symmetric and is_positive_semidefinite(sp.Matrix(R)) is True


def _slope(design: Design) -> Claim:
    phi = design.form.phi
    if phi is None:
        return Claim("slope", True, statements.slope(None), {"slope": 1.0})
    holds = phi.delta > 0 and bool(np.isfinite(design.weights).all())
    delta = float(phi.delta)
    return Claim("slope", holds, statements.slope(delta), {"slope": delta})


def _damping(design: Design) -> Claim:
    if not exactly_positive_definite(design.damping):
        return Claim("damping", False, "the symmetric part of the damping is not positive definite")
    return Claim("damping", True, statements.DAMPING)
