"""A region that curved Casimirs shape, proved again in Arb balls.

V − V(z̄) ≥ f = ½|c − c̄|²_{F_K} + ½|ξ − ξ̄|²_{F_H}, since ∇K(c̄) = 0 and ∇Hc(ξ̄) = 0: at z̄
∂c/∂qᵀ∇K = 0 with ∂c/∂q regular, as on all of the fibre where f ≤ h. Why f > h on the faces and no
fold on the fibre leave z̄ the one critical point is said in
:mod:`necc_casadi.certificate.claims.curved` and in docs/theory.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
    meet,
)
from necc_casadi.certificate.checker.arithmetic.definite import positive, regular
from necc_casadi.certificate.checker.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.evidence import Obligation
from necc_casadi.certificate.checker.momenta import are_momenta
from necc_casadi.certificate.checker.region.poles import Surroundings
from necc_casadi.certificate.claims.curved import CurvedRegion, Faces
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.zero import is_zero

__all__ = ["PERIOD", "CurvedProof"]

#: Half a period and a little more; how often a box may be halved; cells at most.
_HALF_PERIOD, _DEPTH, _MOST = 3.1415927, 14, 100_000
#: A little more than a period, of a state that may take every value.
PERIOD = (-_HALF_PERIOD, _HALF_PERIOD)


class CurvedProof:
    """Floors of K and Hc, faces that Ω does not reach, and a fibre without folds."""

    def __init__(self, energy: Energy, region: CurvedRegion, z_bar: Box) -> None:
        self.model, self.energy, self.region = energy.model, energy, region
        self.z_bar = [ball(*side) for side in z_bar]  # in the states of `energy`
        self.r, self.y = region.r, energy.variables
        self.h = arb(region.height)
        self.turning = [k for k in range(self.r) if k not in {f.state for f in region.faces}]

    def obligations(self) -> list[Obligation]:
        """What has to be proved of the region."""
        region = self.region
        return [
            ("V is a sum in as many Casimirs as states q, and in ξ", self._separate),
            ("the centre is z̄", self._centred),
            ("K and Hc are as strongly convex as claimed", self._floored),
            ("V(z̄) < c ≤ V(z̄) + h", self._rises),
            ("each state q has faces around z̄, or is an angle", self._faced),
            ("everything is smooth between the faces", self._is_smooth),
            ("∇Hc = 0 at critical points", self._block_is_regular),
            ("the momenta have positive definite inertia and stay in the domain", self._stiff),
            ("the region stays in the user's domain", self._in_domain),
            ("f > h on the faces", lambda: all(self._face_is_above(f) for f in region.faces)),
            ("on the fibre of z̄, f > h or ∂c/∂q is regular", self._fibre_is_regular),
        ]

    def hull(self) -> Box:
        """A box of y that holds the region, the angles wrapped."""
        sides = [(-_HALF_PERIOD, _HALF_PERIOD)] * self.r
        for face in self.region.faces:
            lo, hi = (evaluate(v, {}) for v in self._ends(face))
            sides[face.state] = (ends(lo)[0], ends(hi)[1])
        half = [(2 * self.h / arb(F)).sqrt() for F in self.region.floor_h]
        middles = self.z_bar[self.r :]
        xi = [ends(m + ball(-1.0, 1.0) * w.upper()) for m, w in zip(middles, half, strict=True)]
        return (*sides, *xi)

    def reaches(self, claimed: Sequence[Side | None]) -> bool:
        """Whether the sides of all states hold the region; None stands for angles alone."""
        for k, (i, side) in enumerate(zip(self.region.active, self.hull(), strict=True)):
            said = claimed[i]
            if (said is None) != (k in self.turning):
                return False
            if said is not None and not (said[0] <= side[0] and side[1] <= said[1]):
                return False
        momenta = [claimed[i] for i in self._resting]
        return all(
            side is not None and self._momentum_within(k, arb(min(-side[0], side[1])))
            for k, side in enumerate(momenta)
        )

    def ports_repeat(self) -> bool:
        """Whether 𝒢 has the period of the angles."""
        turned = [(self.y[k], self.y[k] + 2 * sp.pi) for k in self.turning]
        return all(
            is_zero(e.subs(*turn) - e) is True for turn in turned for e in set(self.model.ports)
        )

    # --- form -------------------------------------------------------------------------------------

    @property
    def _resting(self) -> list[int]:
        return [i for i in range(len(self.model.z)) if i not in self.region.active]

    def _separate(self) -> bool:
        model, region, energy = self.model, self.region, self.energy
        active = list(region.active)
        counted = (
            self.r == len(model.casimirs) == len(active) - model.nc
            and len(region.floor_h) == model.nc
            and active == sorted(set(active)) == list(energy.active)
            and active[self.r :] == list(range(model.n, len(model.z)))
        )
        at_rest = dict.fromkeys((model.z[i] for i in self._resting), 0)
        flat = not sp.sympify(model.H).subs(at_rest).free_symbols
        plain = energy.phi is None and not energy.betas
        return counted and flat and plain and are_momenta(model, self._resting)

    def _centred(self) -> bool:
        pairs = zip(self.z_bar, self.region.center, strict=True)
        return all(bool(z.contains(arb(v))) for z, v in pairs)

    def _floored(self) -> bool:
        form, region = self.model.form, self.region
        for net, kind, floor in (
            (self.energy.k, form["k"], region.floor_k),
            (self.energy.hc, form["hc"], region.floor_h),
        ):
            below = hessian_floor(net, kind["activation"])
            for i, F in enumerate(floor):
                below[i, i] = below[i, i] - F
            if not (all(F > 0 for F in floor) and positive(below, 0)):
                return False
        return True

    def _rises(self) -> bool:
        at: Box = tuple(ends(v) for v in self.z_bar)
        rise = self.region.level - self.energy.value(at)
        return bool(rise > 0) and bool(rise <= self.h)

    # --- faces ------------------------------------------------------------------------------------

    def _ends(self, face: Faces) -> tuple[sp.Expr, sp.Expr]:
        return parse(face.lo), parse(face.hi)

    def _faced(self) -> bool:
        seen = [face.state for face in self.region.faces]
        if len(set(seen)) < len(seen) or not all(0 <= k < self.r for k in seen):
            return False
        for face in self.region.faces:
            lo, hi = (evaluate(v, {}) for v in self._ends(face))
            if not (bool(lo < self.z_bar[face.state]) and bool(self.z_bar[face.state] < hi)):
                return False
        shifts = [(c, self.y[k]) for c in self.model.casimirs for k in self.turning]
        return all(is_zero(c.subs(v, v + 2 * sp.pi) - c) is True for c, v in shifts)

    @cached_property
    def surroundings(self) -> Surroundings:
        """Where the active states of Ω are."""
        hull = self.hull()
        between = {self.y[face.state]: self._ends(face) for face in self.region.faces}
        within = {v: side for v, side in zip(self.y, hull, strict=True) if v not in between}
        return Surroundings(between, within, [self.y[k] for k in self.turning])

    def _is_smooth(self) -> bool:
        """The loop strictly between the faces, the Casimirs on them too."""
        model, hull = self.model, self.hull()
        closed = Surroundings({}, dict(zip(self.y, hull, strict=True)), self.surroundings.turning)
        at = dict(zip(self.y, self.z_bar, strict=True))
        smooth = self.surroundings.is_smooth(model.written, at)
        return smooth and closed.is_smooth(model.casimirs, at)

    def _block_is_regular(self) -> bool:
        """A block of the rows of ξ in Jcl − Rcl has a determinant off 0."""
        model, columns = self.model, list(self.region.columns)
        inside = all(0 <= j < len(model.z) for j in columns)
        if not inside or len(columns) != model.nc:
            return False
        M = sp.Matrix(model.Jcl - model.Rcl)
        block = M.extract(list(range(model.n, len(model.z))), columns)
        return self.surroundings.is_regular(block)

    def _stiff(self) -> bool:
        """A ≻ 0, and no momentum leaves the user's bounds."""
        model = self.model
        for k, i in enumerate(self._resting):
            if model.states[i] in model.domain:
                lo, hi = (evaluate(b, {}) for b in model.domain[model.states[i]])
                if not self._momentum_within(k, (-lo).min(hi)):
                    return False
        return not self._resting or self._inertia_exceeds(0, arb(0))

    def _momentum_within(self, k: int, reach: arb) -> bool:
        """½ b²/(A⁻¹)ₖₖ > h for the bound b: A − (2h/b²)eₖeₖᵀ ≻ 0."""
        return bool(reach > 0) and self._inertia_exceeds(k, 2 * self.h / (reach * reach))

    def _inertia_exceeds(self, k: int, t: arb) -> bool:
        """Whether A − t eₖeₖᵀ ≻ 0 for all y of the hull."""
        model, hull = self.model, self.hull()
        A = sp.hessian(model.H, [model.z[i] for i in self._resting])
        used = [j for j, v in enumerate(self.y) if A.has(v)]
        turned = [A.subs(self.y[j], self.y[j] + 2 * sp.pi) - A for j in used if j in self.turning]
        if not all(is_zero(e) is True for change in turned for e in change):
            return False

        def test(box: Box) -> bool:
            values = {self.y[j]: ball(*side) for j, side in zip(used, box, strict=True)}
            matrix = arb_mat([[evaluate(e, values) for e in row] for row in A.tolist()])
            matrix[k, k] = matrix[k, k] - t
            return positive(matrix, 0)

        return by_bisection(tuple(hull[j] for j in used), test, _DEPTH)

    def _in_domain(self) -> bool:
        """No bound is met; an angle, which may turn as far as it likes, has none."""
        model, hull = self.model, self.hull()
        faces = {face.state: self._ends(face) for face in self.region.faces}
        for k, i in enumerate(self.region.active):
            if model.states[i] not in model.domain:
                continue
            if k in self.turning:
                return False
            lo, hi = model.domain[model.states[i]]
            if k in faces:
                pairs = ((faces[k][0] - lo), (hi - faces[k][1]))
                if not all(is_zero(d) is True or bool(evaluate(d, {}) >= 0) for d in pairs):
                    return False
            elif not (
                bool(evaluate(lo, {}) <= hull[k][0]) and bool(hull[k][1] <= evaluate(hi, {}))
            ):
                return False
        return True

    # --- cells ------------------------------------------------------------------------------------

    @cached_property
    def _c_bar(self) -> list[arb]:
        return Tape(self.model.casimirs, self.y)(self.z_bar)

    def _face_is_above(self, face: Faces) -> bool:
        return all(self._value_is_above(face.state, value) for value in self._ends(face))

    def _value_is_above(self, state: int, value: sp.Expr) -> bool:
        """Whether f > h wherever a state q has this value."""
        c, left = self._reduced([e.subs(self.y[state], value) for e in self.model.casimirs], state)
        hull = self.hull()
        cells = _Cells(self, c, left)
        return cells.all_settled(tuple(hull[k] for k in left), lambda slopes: False)

    def _reduced(self, c: list[sp.Expr], state: int) -> tuple[list[sp.Expr], list[int]]:
        """The Casimirs on a face by fewer states.

        If turning an angle by t makes up for moving another state by ±t, the latter may stand at 0
        while the angle goes all around; a ξ that no longer occurs adds a square to f at least 0.
        """
        t = sp.Dummy("t", real=True)
        left = [k for k in range(len(self.y)) if k != state]
        for k in list(left):
            v = self.y[k]
            moves = [{v: v + t}] + [
                {v: v + t, self.y[a]: self.y[a] + sign * t}
                for a in self.turning
                if a in left and a != k
                for sign in (1, -1)
            ]
            may_go = k in self.turning or k >= self.r
            if may_go and any(self._unchanged(c, move) for move in moves):
                left.remove(k)
                c = [e.subs(v, 0) for e in c]
        short = [sp.simplify(e) for e in c]
        return [a if is_zero(a - b) is True else b for a, b in zip(short, c, strict=True)], left

    @staticmethod
    def _unchanged(c: Sequence[sp.Expr], move: dict[sp.Symbol, sp.Expr]) -> bool:
        return all(is_zero(e.subs(move, simultaneous=True) - e) is True for e in c)

    def _fibre_is_regular(self) -> bool:
        """Whether f > h or det ∂c/∂q ≠ 0 wherever ξ = ξ̄."""
        cells = _Cells(self, list(self.model.casimirs), list(range(self.r)))
        return cells.all_settled(self.hull()[: self.r], regular)


class _Cells:
    """f over boxes of some states; the others do not occur, or are as at z̄."""

    def __init__(self, proof: CurvedProof, c: Sequence[sp.Expr], left: Sequence[int]) -> None:
        self.proof, self.left = proof, list(left)
        self.count = len(c)
        slopes = [sp.diff(e, proof.y[k]) for e in c for k in left]
        self._value, self._all = Tape(c, proof.y), Tape([*c, *slopes], proof.y)
        #: (position in `left`, its middle, weight) of controller states
        self.held = [
            (a, proof.z_bar[k], arb(proof.region.floor_h[k - proof.r]))
            for a, k in enumerate(self.left)
            if k >= proof.r
        ]

    def all_settled(self, box: Box, otherwise: Callable[[arb_mat], bool]) -> bool:
        """Whether f > h on cells that cover a box, or `otherwise` of ∂c/∂y holds on them."""
        todo, seen = [box], 0
        while todo:
            cell = todo.pop()
            seen += 1
            axis = self._axis_to_cut(cell, otherwise)
            if axis is None:
                continue
            lo, hi = cell[axis]
            middle = lo / 2 + hi / 2
            if seen > _MOST or not lo < middle < hi:
                return False
            todo += [
                (*cell[:axis], half, *cell[axis + 1 :]) for half in ((lo, middle), (middle, hi))
            ]
        return True

    def _axis_to_cut(self, cell: Box, otherwise: Callable[[arb_mat], bool]) -> int | None:
        """None where the cell is settled."""
        proof, d = self.proof, len(self.left)
        weights = [arb(F) for F in proof.region.floor_k]
        y, at = list(proof.z_bar), list(proof.z_bar)
        for k, (lo, hi) in zip(self.left, cell, strict=True):
            y[k], at[k] = ball(lo, hi), arb(lo / 2 + hi / 2)
        found = self._all(y)
        slopes = [found[self.count + j * d : self.count + (j + 1) * d] for j in range(self.count)]
        steps = [y[k] - at[k] for k in self.left]
        errors, middle = [], arb(0)
        for j, value in enumerate(self._value(at)):
            away = value - proof._c_bar[j]
            middle = middle + weights[j] * away * away / 2
            moved = sum((s * t for s, t in zip(slopes[j], steps, strict=True)), away)
            errors.append(meet(moved, found[j] - proof._c_bar[j]))
        least = sum(
            (w * e.abs_lower() ** 2 / 2 for w, e in zip(weights, errors, strict=True)), arb(0)
        )
        change = [
            sum((weights[j] * errors[j] * slopes[j][a] for j in range(self.count)), arb(0))
            for a in range(d)
        ]
        for a, centre, w in self.held:
            away = y[self.left[a]] - centre
            least = least + w * away.abs_lower() ** 2 / 2
            middle = middle + w * (at[self.left[a]] - centre) ** 2 / 2
            change[a] = change[a] + w * away
        centred = sum((g * t for g, t in zip(change, steps, strict=True)), middle)
        if bool(least > proof.h) or bool(centred > proof.h):
            return None
        if otherwise(arb_mat(slopes)):
            return None
        pulls = [float((g * t).abs_upper()) for g, t in zip(change, steps, strict=True)]
        widths = [hi - lo for lo, hi in cell]
        scores = pulls if all(p < float("inf") for p in pulls) else widths
        return max(range(d), key=scores.__getitem__)
