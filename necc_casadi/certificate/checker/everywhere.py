"""A family in the whole space, proved again: every V_ϑ convex with the momenta at rest.

∂²V_ϑ/∂y² ⪰ F ≻ 0 for every y and ϑ by matrices below ∇²K and ∇²Hc; A ≻ 0; and from the slope g at
the target (z̄ − z*)ᵀF(z̄ − z*) ≤ gᵀF⁻¹g.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    widths,
)
from necc_casadi.certificate.checker.arithmetic.definite import positive, solve
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_everywhere
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.family import Minima, StoredMembers
from necc_casadi.certificate.checker.invariant_sets import (
    OverBox,
    largest_invariant_set_is_critical,
)
from necc_casadi.certificate.checker.region.floor import evaluated, is_periodic, network_floor
from necc_casadi.certificate.claims.everywhere import EverywhereClaim, everywhere
from necc_casadi.symbolic.zero import is_zero

__all__ = ["StoredWhole", "check_everywhere"]


#: Half a period, a little more than π; how often a box of states and ϑ, and one of ϑ, is halved.
_HALF_PERIOD, _ANGLES, _RANGES = 3.15, 22, 14


def check_everywhere(evidence: Evidence, members: StoredMembers) -> Checked:
    """Every V_ϑ is radially unbounded with one critical point, and what follows."""
    claim = EverywhereClaim.read(evidence.claims["everywhere"].data)
    units = dict(zip(evidence.model.states, evidence.model.units.state, strict=True))
    family = members.family
    text = everywhere(family.sides, claim.error, units, family.has_unknown, claim.follows)
    whole = _Everywhere(evidence, members, claim)
    return Checked.by(
        "everywhere", text, [*members.obligations(claim.family), *whole.obligations()]
    )


class StoredWhole:
    """States y and momenta s of every member, and what holds wherever the states are."""

    def __init__(self, evidence: Evidence, members: StoredMembers, active: Sequence[int]) -> None:
        self.model, self.family, self.active = evidence.model, members.family, list(active)
        z, N = self.model.z, len(self.model.z)
        shaped = sorted(set(active)) == list(active) and len(active) > 0
        if not shaped or not 0 <= active[0] <= active[-1] < N:
            raise ValueError("no list of states")
        self.resting = [i for i in range(N) if i not in active]
        self.y, self.s = [z[i] for i in active], [z[i] for i in self.resting]
        self.inertia = sp.hessian(self.family.H, self.s) if self.s else sp.zeros(0)

    def of_the_loop(self) -> list[Obligation]:
        """Its form, its structure and its momenta."""
        form = self.model.form
        return [
            ("Φ is the sum H + Hc + K(c)", lambda: form["phi"] is None and not form["betas"]),
            ("the loop is of constant structure", self._is_constant),
            ("the resting states are momenta of every member", self._has_momenta),
        ]

    def _is_constant(self) -> bool:
        structure = sp.Matrix([*self.family.J, *self.family.R, *self.family.G])
        inner = self.model.Jcl - self.model.Rcl
        return not (structure.free_symbols | inner.free_symbols) & set(self.model.z)

    def _has_momenta(self) -> bool:
        s, H = self.s, self.family.H
        zero = dict.fromkeys(s, sp.Integer(0))
        plain = all(i < self.model.n for i in self.resting)
        unseen = not any(c.has(*s) for c in self.model.casimirs if s)
        still = all(self.model.target[i] == 0 for i in self.resting) if plain else False
        flat = all(is_zero(sp.diff(a, v)) is True for a in self.inertia for v in s)
        level = all(is_zero(sp.diff(H, v).subs(zero)) is True for v in s)
        return plain and unseen and still and flat and level

    def converges(self) -> bool:
        """Whether no motion but rest keeps V constant, for any ϑ."""
        member = self.family.as_design()
        nowhere: Box = tuple((0.0, 0.0) for _ in self.model.z)
        constants = OverBox((*self.model.z, *self.family.symbols), (*nowhere, *self.family.box))
        return largest_invariant_set_is_critical(member, self.resting, None, constants)


class _Everywhere(StoredWhole):
    """What has to be proved for all states and ϑ."""

    def __init__(self, evidence: Evidence, members: StoredMembers, claim: EverywhereClaim) -> None:
        super().__init__(evidence, members, claim.active)
        self.claim, self.minima = claim, Minima(members.family)
        d = len(claim.active)
        if len(claim.floor) != d or any(len(row) != d for row in claim.floor):
            raise ValueError("everywhere: a floor of another size")
        self.F = arb_mat([list(row) for row in claim.floor])

    def obligations(self) -> list[Obligation]:
        """One critical point of every V_ϑ, and all solutions bounded."""
        stable = self.claim.follows == "stable"
        return [
            *self.of_the_loop(),
            ("everything is smooth for all states", self._is_smooth),
            ("∂²H/∂p² ≻ 0 for all states and parameters", self._has_inertia),
            ("∂²V/∂y² ⪰ F ≻ 0 for all states and parameters", self._is_convex),
            ("how far from the set-point it rests", self._rests_within),
            ("what follows for solutions", lambda: stable or self.converges()),
        ]

    def _seen(self, entries: Sequence[sp.Expr]) -> list[sp.Expr]:
        """Expressions at x̂ = x − x*(r) + x*(r₀), x anywhere: of where the plant is."""
        pairs = zip(self.model.z, self.family.x_star, self.model.target, strict=False)
        place = {s: s - v + t for s, v, t in pairs}
        return [sp.sympify(e).subs(place, simultaneous=True) for e in entries]

    def _is_smooth(self) -> bool:
        family = self.family
        written = [family.H, *family.J, *family.R, *family.G, *self.model.written]
        within = dict(zip(family.symbols, family.box, strict=True))
        return is_smooth_everywhere(self._seen(written), self.model.z, within)

    def _has_inertia(self) -> bool:
        return not self.s or self._holds(self.inertia, lambda A: positive(A, 0))

    def _is_convex(self) -> bool:
        U = self.family.H.subs(dict.fromkeys(self.s, sp.Integer(0)))
        added = self._of_networks()
        if added is None or not positive(self.F, 0):
            return False
        below = added - self.F
        return self._holds(sp.hessian(U, self.y), lambda A: positive(A + below, 0))

    def _of_networks(self) -> arb_mat | None:
        """A matrix below what Hc and K add to ∂²V/∂y²."""
        model, networks = self.model, self.minima.networks
        of_hc = network_floor(networks.hc, model.form["hc"], self.claim.bends[0])
        of_k = network_floor(networks.k, model.form["k"], self.claim.bends[1])
        slopes = sp.Matrix([[sp.diff(c, v) for v in self.y] for c in model.casimirs])
        if of_hc is None or of_k is None or slopes.free_symbols:
            return None
        N = evaluated(slopes, {})
        total = N.transpose() * of_k * N
        for a, i in enumerate(self.claim.active):
            for b, j in enumerate(self.claim.active):
                if i >= model.n and j >= model.n:
                    total[a, b] = total[a, b] + of_hc[i - model.n, j - model.n]
        return total

    def _holds(self, matrix: sp.Matrix, test: Callable[[arb_mat], bool]) -> bool:
        """Whether a test of a matrix holds for all states and ϑ.

        What is positive definite at both ends of a ϑᵢ that the matrix has to the first power is so
        between them.
        """
        seen = sp.Matrix(*matrix.shape, self._seen(list(matrix)))
        used, sides = sorted(seen.free_symbols, key=str), []
        for s in used:
            if s in self.family.symbols:
                sides.append(self.family.box[self.family.symbols.index(s)])
            elif all(is_periodic(e, s) for e in set(seen) if e.has(s)):
                sides.append((-_HALF_PERIOD, _HALF_PERIOD))
            else:
                return False

        def at(cell: Box) -> bool:
            values = {v: ball(*side) for v, side in zip(used, cell, strict=True)}
            return test(evaluated(seen, values))

        def ends(s: sp.Symbol, side: tuple[float, float]) -> Box:
            affine = s in self.family.symbols and all(
                is_zero(sp.diff(sp.diff(e, s), s)) is True for e in set(seen) if e.has(s)
            )
            return tuple((v, v) for v in side) if affine else (side,)

        corners = product(*(ends(s, side) for s, side in zip(used, sides, strict=True)))
        sizes = widths(tuple(sides))
        return all(by_bisection(corner, at, _ANGLES, sizes=sizes) for corner in corners)

    def _rests_within(self) -> bool:
        """|x̄ᵢ − xᵢ*|² ≤ (F⁻¹)ᵢᵢ gᵀF⁻¹g for every ϑ, and momenta at 0."""
        claim, model = self.claim, self.model
        if set(claim.error) != set(model.states[: model.n]):
            return False
        d, allowed = len(claim.active), arb("inf")
        for k, i in enumerate(claim.active):
            column = solve(self.F, [arb(int(j == k)) for j in range(d)])
            if column is None:
                return False
            if i < model.n:
                most = arb(claim.error[model.states[i]]) / model.units.state[i]
                if not most >= 0:
                    return False
                allowed = allowed.min((most * most / column[k]).lower())
        if any(claim.error[model.states[i]] != 0 for i in self.resting):
            return False
        z = self.minima.target

        def near(box: Box) -> bool:
            theta = {s: ball(*v) for s, v in zip(self.family.symbols, box, strict=True)}
            whole = self.minima.gradient(z, theta, box)
            g = [whole[i] for i in claim.active]
            turned = solve(self.F, g)
            if turned is None:
                return False
            size = sum((a * b for a, b in zip(turned, g, strict=True)), arb(0))
            return bool(size.upper() <= allowed)

        return by_bisection(self.family.box, near, _RANGES, sizes=self.minima.reaches)
