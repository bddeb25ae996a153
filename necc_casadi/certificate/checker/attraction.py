"""Whether the damped loop goes to z̄, re-proved in balls: Lyapunov's indirect method, or no rate."""

from __future__ import annotations

import sympy as sp
from flint import arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import hurwitz
from necc_casadi.certificate.checker.arithmetic.potential import hessian_hull
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.vanishing_damping import no_motion_near
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_attraction", "check_only_stable"]


#: What an equilibrium of the loop and V̇ ≤ 0 are needed for.
_SOUND = "z̄ is an equilibrium of a loop along which V decreases"


def check_attraction(evidence: Evidence, sound: bool) -> Checked:
    """The linearisation plus the claimed rate is Hurwitz: AᵀP + PA ≺ 0, P ≻ 0 (Lyapunov).

    Without a rate: no motion near z̄ but rest keeps V constant (LaSalle).
    """
    if "rate" not in evidence.claims["attraction"].data:
        return _without_rate(evidence, sound)
    rate, time = evidence.number("attraction", "rate"), evidence.model.units.time

    def decays() -> bool:
        A = _linearisation(evidence, evidence.z_bar(range(len(evidence.model.z))))
        for i in range(A.nrows()):
            A[i, i] = A[i, i] + rate * time
        return hurwitz(A)

    return Checked.by(
        "attraction",
        statements.attraction(rate),
        [
            (_SOUND, lambda: sound),
            ("the rate is not negative", lambda: rate >= 0),
            ("the Lyapunov inequality at z̄", decays),
        ],
    )


def _without_rate(evidence: Evidence, sound: bool) -> Checked:
    def attracts() -> bool:
        return no_motion_near(evidence.full, evidence.z_bar(range(len(evidence.model.z))))

    return Checked.by(
        "attraction",
        statements.attraction(None),
        [(_SOUND, lambda: sound), ("no motion near z̄ but rest keeps V constant", attracts)],
    )


def check_only_stable(evidence: Evidence, sound: bool) -> Checked:
    """z̄ is stable, and nothing more is claimed; or a Casimir stays, so that z̄ cannot attract.

    𝒢ᵀ∇C = 0 keeps a Casimir C of the undamped loop constant along the damped one.
    """
    model, data = evidence.model, evidence.claims["stability"].data
    stable: list[Obligation] = [
        (_SOUND, lambda: sound),
        ("no more than stability is claimed", lambda: evidence.certificate.stability == "stable"),
    ]
    if "conserved" not in data:
        return Checked.by("stability", statements.ONLY_STABLE, stable)
    index = int(data["conserved"])
    name, slope = model.casimir_texts[index], [sp.diff(model.casimirs[index], v) for v in model.z]
    moved = model.ports.T * sp.Matrix(slope)
    return Checked.by(
        "stability",
        statements.conserved(name),
        [
            *stable,
            (f"no damping moves {name}", lambda: all(is_zero(e) is True for e in moved)),
            (f"{name} is not constant", lambda: any(is_zero(e) is False for e in slope)),
        ],
    )


def _linearisation(evidence: Evidence, box: Box) -> arb_mat:
    model = evidence.model
    values = {s: ball(*b) for s, b in zip(model.z, box, strict=True)}

    def enclose(matrix: sp.Matrix) -> arb_mat:
        return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])

    ports, damping = enclose(model.ports), arb_mat(model.damping)
    M = enclose(sp.Matrix(model.Jcl - model.Rcl))
    slope = evidence.full.slope(box)
    return (M / slope - ports * damping * ports.transpose()) * hessian_hull(evidence.full, box)
