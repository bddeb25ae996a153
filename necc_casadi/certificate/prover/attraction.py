"""Whether the damped loop goes to z̄: Lyapunov's indirect method, by a matrix inequality."""

from __future__ import annotations

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.decrease import casimir_texts
from necc_casadi.certificate.prover.equilibrium import Equilibrium
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.zero import is_zero

__all__ = [
    "is_hurwitz",
    "linearisation",
    "lyapunov_candidate",
    "prove_attraction",
    "prove_only_stable",
]


#: Shares of the spectral abscissa that are tried as a proved rate of decay, in this order.
_RATES = (0.99, 0.9, 0.5, 0.0)


#: Terms of the series for P are summed in powers of two; more are never needed in doubles.
_DOUBLINGS = 60


def linearisation(potential: Potential, Z: Interval) -> Interval:
    """A = (M/Φ₁ − 𝒢𝒟𝒢ᵀ)∇²V over a box (N,) that holds z̄, where ∇V = 0; N × N."""
    design, loop = potential.design, potential.design.loop
    M = matrix_enclosure(loop.M, loop.z, Z[None, :])[0]
    ports = matrix_enclosure(loop.ports, loop.z, Z[None, :])[0]
    transposed = Interval(ports.lo.T, ports.hi.T)
    injected = matmul(ports, matmul(design.damping, transposed))
    slope = potential.slope(Z[None, :])[0]
    return matmul(M / slope - injected, potential.jet(Z[None, :]).hess[0])


def prove_attraction(
    potential: Potential, equilibrium: Equilibrium, casimir: Claim, time: float
) -> Claim:
    """z̄ is locally asymptotically stable: AᵀP + PA ≺ 0 for some P ≻ 0 and every A enclosed.

    The rate is stated per unit of time of the model, of which natural time has `time`.
    A is of ż = (M/Φ₁ − 𝒢𝒟𝒢ᵀ)∇V, which is the damped loop only where M∇C = 0, as `casimir` says.
    """
    if not equilibrium.proved:
        return Claim("attraction", False, "no equilibrium is proved, so none is proved to attract")
    if not casimir.holds:
        text = "z̄ need not be an equilibrium of the loop: the Casimir condition is not proved"
        return Claim("attraction", False, text)
    with np.errstate(all="ignore"):
        A = linearisation(potential, equilibrium.box)
        abscissa = _abscissa(A.mid)
        for share in _RATES:
            rate = max(0.0, -share * abscissa)
            shifted = A + rate * np.eye(A.shape[-1])
            P = lyapunov_candidate(shifted.mid)
            if P is not None and is_hurwitz(shifted, P):
                stated = rate / time
                return Claim("attraction", True, statements.attraction(stated), {"rate": stated})
    text = (
        f"the linearisation at z̄ is not proved to be Hurwitz (abscissa about {abscissa / time:.3g})"
    )
    return Claim("attraction", False, text)


def _abscissa(A: Vector) -> float:
    return float(np.linalg.eigvals(A).real.max()) if np.isfinite(A).all() else float("nan")


def lyapunov_candidate(A: Vector) -> Vector | None:
    """P with AᵀP + PA = −I, in floating point, as a candidate; None where there is none.

    With U = (pI − A)⁻¹(pI + A), p > 0, the equation reads P = UᵀPU + 2p(pI − A)⁻ᵀ(pI − A)⁻¹, and
    the series for P is summed by doubling: n³ operations, where a Kronecker product takes n⁶
    (Smith's method). On purpose not the checker's way to guess a P, which by one method could
    share its faults, though either is proved to do before it counts.
    """
    if not np.isfinite(A).all():
        return None
    identity = np.eye(len(A))
    size = np.abs(np.linalg.eigvals(A))
    p = float(np.sqrt(size.max() * max(size.min(), 1e-12 * size.max())))
    try:
        inverse = np.linalg.inv(p * identity - A)
    except np.linalg.LinAlgError:
        return None
    U, P = inverse @ (p * identity + A), 2 * p * inverse.T @ inverse
    for _ in range(_DOUBLINGS):
        step = U.T @ P @ U
        P, U = P + step, U @ U
        if not np.isfinite(P).all():
            return None
        if np.abs(step).max() <= np.finfo(float).eps * np.abs(P).max():
            return np.asarray((P + P.T) / 2, float)
    return None


def is_hurwitz(A: Interval, P: Vector) -> bool:
    """Whether P ≻ 0 and AᵀP + PA ≺ 0 for every A enclosed, (d, d) each."""
    PA = matmul(P, A)
    rate = PA + Interval(PA.lo.T, PA.hi.T)
    return bool(positive_definite(point(P)[None])[0] and positive_definite(-rate[None])[0])


def prove_only_stable(design: Design) -> Claim | None:
    """Why z̄, stable because V is least there and never increases, cannot attract; None: unknown.

    Either a Casimir that damping cannot move, 𝒢ᵀ∇C ≡ 0 with C not constant, is conserved by the
    damped loop; or the exact verdict at the target names motions that no V can damp: then no more
    than stability is claimed.
    """
    conserved = _conserved(design)
    if conserved is not None:
        text = statements.conserved(casimir_texts(design)[conserved])
        return Claim("stability", True, text, {"conserved": conserved})
    verdict = design.verdict
    if verdict.stability == "stable" and verdict.witness:
        return Claim("stability", True, statements.ONLY_STABLE)
    return None


def _conserved(design: Design) -> int | None:
    """Which Casimir is conserved whatever the damping."""
    loop = design.loop
    for index, c in enumerate(design.casimirs.functions):
        slope = gradient(c, loop.z)
        moved = sp.Matrix(loop.ports).T * slope
        constant = all(is_zero(entry) is not False for entry in slope)
        conserved = [*moved, *(loop.M.T * slope)]
        if not constant and all(is_zero(entry) for entry in conserved):
            return index
    return None
