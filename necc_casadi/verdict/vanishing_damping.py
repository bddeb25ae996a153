"""Dissipation that vanishes at the target and still brings every motion there.

Rcl = Σ φₖ(z) rₖrₖᵀ with φₖ(z*) = 0 adds nothing to the linearisation. But along an analytic motion
without loss every φₖ·(rₖᵀ∇V)² ≡ 0, so that one factor of it vanishes identically. Where the pair is
observable whichever factors do, z* attracts; convergence need not be exponential
(docs/theory.md#damping-that-vanishes-at-the-target).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.derivatives import at, gradient, sparse_hessian, value_at
from necc_casadi.symbolic.finite_field import PRIMES, NoFiniteFieldValue
from necc_casadi.symbolic.gains import Gains, factors, gains, has_one_sign, is_never_negative
from necc_casadi.symbolic.observability import is_observable, observability_matrix
from necc_casadi.symbolic.smoothness import is_analytic_at
from necc_casadi.symbolic.zero import sign

__all__ = ["vanishing_damping_attracts"]


#: Choices of vanishing factors that are looked at; beyond, nothing is decided.
_MOST_CHOICES = 1000


def vanishing_damping_attracts(
    loop: ClosedLoop,
    functions: Sequence[sp.Expr],
    z_star: Mapping[sp.Symbol, sp.Expr],
    P: sp.Matrix,
) -> bool:
    """Whether z* is proved to attract with ∇²V(z*) = P ≻ 0, for gains that vanish there.

    Parameters
    ----------
    loop, functions
        Closed loop and its Casimirs c, (r,).
    z_star
        Exact value of every state.
    P
        An admissible Hessian, (n + nc) × (n + nc).
    """
    split = gains(sp.Matrix(loop.R))
    if not any(gain.phi.free_symbols for gain in split.terms):
        return False
    structure = [*loop.M.todok().values(), *loop.ports.todok().values()]
    if not is_analytic_at([loop.plant.H, *functions, *structure], z_star):
        return False
    choices = _Choices(loop, z_star, P)
    return choices.sort(split) and choices.all_observable()


class _Choices:
    """What is left to observe of a motion without loss, one choice of vanishing factors at a time.

    A choice names, for every gain φₖ that may vanish at z*, rₖᵀ∇V or a factor ψ of φₖ. What it
    names is an output that vanishes: the rows are rₖᵀP, or ∇ψᵀ and, where ψ has one sign, ∇²ψ. If
    ψ(z*) ≠ 0 after all, no motion near z* makes that choice, and every row is true of it.
    """

    def __init__(self, loop: ClosedLoop, z_star: Mapping[sp.Symbol, sp.Expr], P: sp.Matrix) -> None:
        self.z, self.z_star, self.P = loop.z, z_star, P
        self.J, self.ports = (sp.Matrix(at(m, z_star)) for m in (loop.J, loop.ports))
        self.always = sp.zeros(0, P.cols)
        self.open: list[list[sp.Matrix]] = []
        self.tests = 0

    def sort(self, split: Gains) -> bool:
        """Sort the gains into outputs and choices; False where one is not known well enough."""
        self.always = sp.Matrix(at(split.rest, self.z_star)) * self.P
        for phi, r in split.terms:
            seen = r.T * self.P
            if sign(value_at(phi, self.z_star)) == 1:
                self.always = self.always.col_join(seen)
            else:
                vanishing = self._rows(phi) if is_never_negative(phi) else None
                if vanishing is None:
                    return False
                self.open.append([seen, *vanishing])
        return True

    def _rows(self, phi: sp.Expr) -> list[sp.Matrix] | None:
        """The rows that vanish with each factor of a gain that may vanish at z*.

        None where a factor is not proved to be analytic there.
        """
        left = [f for f in factors(phi) if sign(value_at(f.psi, self.z_star)) not in (1, -1)]
        if not is_analytic_at([factor.psi for factor in left], self.z_star):
            return None
        found = []
        for factor in left:
            rows = sp.Matrix(at(gradient(factor.psi, self.z), self.z_star)).T
            if has_one_sign(factor, [other for other in left if other is not factor]):
                bent = at(sparse_hessian(factor.psi, self.z), self.z_star)
                rows = rows.col_join(sp.Matrix(bent))
            found.append(rows)
        return found

    def all_observable(self) -> bool:
        """Whether the pair is observable for every choice."""
        return self._from(self.always, self.open)

    def _from(self, rows: sp.Matrix, choices: Sequence[Sequence[sp.Matrix]]) -> bool:
        """With the rows that are chosen, for every choice that is left."""
        self.tests += 1
        if self.tests > _MOST_CHOICES:
            return False
        if self._sees_everything(rows):
            return True
        if not choices:
            return False
        return all(self._from(rows.col_join(more), choices[1:]) for more in choices[0])

    def _sees_everything(self, rows: sp.Matrix) -> bool:
        for prime in PRIMES:
            try:
                observed = observability_matrix(self.J, self.ports, self.P, prime, rows)
            except NoFiniteFieldValue:
                continue  # a root that occurs does not exist modulo this prime
            whole = len(observed) == self.P.rows
            return whole and is_observable(self.J, self.ports, self.P, rows)
        return False
