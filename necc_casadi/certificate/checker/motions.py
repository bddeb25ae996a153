"""No motion without loss, replayed: every premise of every step is proved again.

A solution on which V stays constant keeps 𝒢ᵀw = 0 and Rcl w = 0, w = ∇V, and obeys ż = Jcl w. What
each step concludes from that is said in :mod:`necc_casadi.certificate.claims.motions`. Forms that
vanish are kept as reduced rows of fractions, values over a box as balls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction

import sympy as sp
from flint import arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.momenta import are_momenta
from necc_casadi.certificate.claims.motions import Rule, Step
from necc_casadi.symbolic.zero import is_zero

__all__ = ["no_motion_without_loss"]

#: How often a box may be halved before a test on it counts as failed; half a period, and more.
_DEPTH, _HALF_PERIOD = 12, 3.15

Form = list[Fraction]


def no_motion_without_loss(
    energy: Energy, resting: Sequence[int], steps: Sequence[Step], z_bar: Box, box: Box | None
) -> bool:
    """Whether the steps prove ∇V = 0 along solutions that stay in a compact set and keep V.

    `box` holds that set, in all states; None stands for the whole space, where all solutions must
    be bounded. `z_bar` holds the critical point.
    """
    model = energy.model
    structure = [*model.Jcl, *model.Rcl]
    slopes = [sp.diff(c, v) for c in model.casimirs for v in model.z]
    rational = all(e.is_Rational for e in structure) and not any(e.free_symbols for e in slopes)
    plain = model.form["phi"] is None and not model.form["betas"]
    if not (rational and plain and are_momenta(model, resting)):
        return False
    known = _Solution(energy, tuple(resting), z_bar, box)
    if not known.inertia_is_finite():
        return False
    for step in steps:
        if not all(0 <= i < len(model.z) for i in step.states) or not known.follow(step):
            return False
    return known.forms.rank == len(model.z)


class _Forms:
    """Linear forms in w that vanish, as reduced rows."""

    def __init__(self, rows: Iterable[Form] = ()) -> None:
        self._rows: dict[int, Form] = {}  # by their leading column
        for row in rows:
            self.add(row)

    @property
    def rank(self) -> int:
        return len(self._rows)

    def rest(self, form: Form) -> Form:
        """What is left of a form after elimination; zeros where it vanishes."""
        left = list(form)
        for column in sorted(self._rows):
            if left[column]:
                factor, row = left[column], self._rows[column]
                left = [a - factor * b for a, b in zip(left, row, strict=True)]
        return left

    def add(self, form: Form) -> None:
        left = self.rest(form)
        lead = next((k for k, v in enumerate(left) if v), None)
        if lead is not None:
            self._rows[lead] = [v / left[lead] for v in left]

    def within(self, columns: set[int]) -> list[Form]:
        """A basis of the forms that are made of these columns alone."""
        left = [list(row) for row in self._rows.values()]
        for column in sorted({k for row in left for k in range(len(row))} - columns):
            pivot = next((row for row in left if row[column]), None)
            if pivot is None:
                continue
            left.remove(pivot)
            for row in left:
                share = row[column] / pivot[column]
                row[:] = [a - share * b for a, b in zip(row, pivot, strict=True)]
        return left

    def holds(self, form: Form, others: Iterable[Form] = ()) -> bool:
        """Whether a form is a combination of these and of others."""
        wider = _Forms([*self._rows.values(), *others])
        return not any(wider.rest(form))


class _Solution:
    """What is known of a solution that keeps V."""

    def __init__(
        self, energy: Energy, resting: tuple[int, ...], z_bar: Box, box: Box | None
    ) -> None:
        self.energy, self.model, self.s = energy, energy.model, resting
        self.z_bar, self.box = z_bar, box
        model = self.model
        self.count, self.z = len(model.z), model.z
        self.xi = list(range(model.n, self.count))
        self.constant, self.steady, self.placed = set[int](), set[int](), set[int]()
        self.rates = [_fractions(model.Jcl.row(i)) for i in range(self.count)]
        rows = [
            model.ports.T.col_join(model.Rcl).row(i) for i in range(self.count + model.ports.cols)
        ]
        known = [row for row in rows if all(e.is_Rational for e in row)]  # the others say less
        self.forms = _Forms(map(_fractions, known))
        at_rest = model.H.subs({self.z[i]: 0 for i in resting})
        self.pull = [sp.diff(at_rest, v) for v in self.z]
        momenta = [self.z[i] for i in resting]
        self.A = sp.hessian(model.H, momenta) if momenta else sp.zeros(0)
        self.M = self._inverse()

    def _inverse(self) -> sp.Matrix | None:
        """A⁻¹ by cofactors, if it is one."""
        if not self.s:
            return sp.zeros(0)
        size, det = len(self.s), self.A.det()
        if is_zero(det) is not False:
            return None
        M = (self.A.adjugate() / det).applyfunc(lambda e: sp.factor(sp.simplify(e)))
        product = self.A * M - sp.eye(size)
        return M if all(is_zero(e) is True for e in product) else None

    def inertia_is_finite(self) -> bool:
        """A⁻¹ has no pole, so that s = A⁻¹w_s holds wherever the solution is."""
        if self.M is None:
            return False
        entries = [sp.Matrix([[e]]) for e in self.M]
        return all(self._over(e, lambda A: bool(A[0, 0].is_finite())) for e in entries)

    def follow(self, step: Step) -> bool:
        """Whether the premises of a step are proved; then its conclusions are known."""
        rules: dict[Rule, tuple[Callable[..., bool], int]] = {
            "rate": (self._rate, 1), "steady": (self._steady, 1), "level": (self._level, 2),
            "convex": (self._convex, 0), "momentum": (self._momentum, 1),
            "inertia": (self._inertia, 2), "swing": (self._swing, 3), "placed": (self._placed, 0),
            "linear": (self._linear, 0),
        }  # fmt: skip
        premises, count = rules[step.rule]
        states = step.states
        if not states or (count and len(states) != count) or not premises(*states):
            return False
        if step.rule in ("steady", "inertia"):
            self.steady.add(states[-1])
        elif step.rule == "placed":
            self.placed.update(states)
        elif step.rule == "linear":
            for form in self.forms.within(set(states)):
                self.forms.add(self._rate_of(form))
        else:
            stopped = states if step.rule == "convex" else states[-1:]
            self.constant.update(stopped)
            for i in stopped:
                self.forms.add(self.rates[i])
        return True

    # --- premises ---------------------------------------------------------------------------------

    def _unit(self, i: int) -> Form:
        return [Fraction(int(i == k)) for k in range(self.count)]

    def _vanishes(self, i: int) -> bool:
        return self.forms.holds(self._unit(i))

    def _stays(self, form: Form) -> bool:
        """Whether a form is constant."""
        return self.forms.holds(form, [self._unit(i) for i in sorted(self.steady)])

    def _used(self, expr: sp.Expr | sp.Matrix) -> set[int]:
        return {i for i, v in enumerate(self.z) if expr.has(v)}

    def _moved(self) -> list[int]:
        """Momenta, by position, whose velocities w_s need not vanish."""
        return [k for k, i in enumerate(self.s) if not self._vanishes(i)]

    def _without_kinetics(self, i: int) -> bool:
        """∂(½ sᵀAs)/∂zᵢ = ½ w_sᵀA⁻¹(∂A/∂zᵢ)A⁻¹w_s vanishes, in the velocities that are left."""
        if i in self.s or self.M is None:
            return False
        if not self.s or i >= self.model.n:
            return True
        bent = self.M * self.A.diff(self.z[i]) * self.M
        moved = self._moved()
        return all(is_zero(bent[a, b]) is True for a in moved for b in moved)

    def _rate(self, i: int) -> bool:
        return self._stays(self.rates[i])

    def _steady(self, i: int) -> bool:
        if i in self.xi:
            return self.constant >= set(self.xi)
        return self._without_kinetics(i) and self._used(self.pull[i]) <= self.constant

    def _level(self, i: int, other: int) -> bool:
        if i in self.xi or not self._without_kinetics(i) or not self._stays(self._unit(i)):
            return False
        pull = self.pull[i]
        slope, used = sp.diff(pull, self.z[other]), self._used(pull)
        if other in self.constant or used - {other} - self.constant or other not in used:
            return False
        if used == {other} and _single_valued(pull):
            return is_zero(slope) is False
        return self._not_zero(slope, set())

    def _convex(self, *states: int) -> bool:
        free = sorted(set(self.xi) - self.constant)
        if list(states) != free or not all(self._stays(self._unit(i)) for i in free):
            return False
        floor = hessian_floor(self.energy.hc, self.model.form["hc"]["activation"])
        at = [i - self.model.n for i in free]
        return positive(arb_mat([[floor[a, b] for b in at] for a in at]), 0)

    def _parts(self, j: int) -> dict[int, sp.Expr] | None:
        """s_j = Σ factor · w_l over the momenta l that may move; None for no momentum."""
        if j not in self.s or self.M is None:
            return None
        row = self.M.row(self.s.index(j))
        return {self.s[k]: row[k] for k in self._moved() if is_zero(row[k]) is not True}

    def _momentum(self, j: int) -> bool:
        parts = self._parts(j)
        return parts is not None and all(
            self._stays(self._unit(i)) and self._used(factor) <= self.constant
            for i, factor in parts.items()
        )

    def _alone(self, j: int, other: int) -> sp.Expr | None:
        """The factor in s_j = factor · w_other, where that is constant."""
        parts = self._parts(j)
        if parts is None or j not in self.constant or set(parts) != {other}:
            return None
        return parts[other]

    def _inertia(self, j: int, other: int) -> bool:
        factor = self._alone(j, other)
        if factor is None or not self._used(factor) <= self.constant:
            return False
        return self._not_zero(factor, self.placed)

    def _swing(self, j: int, other: int, k: int) -> bool:
        factor = self._alone(j, other)
        if factor is None or self._used(factor) != {k} or not _single_valued(factor):
            return False
        left = self.forms.rest(self.rates[k])
        along = self.forms.holds(self.rates[k], [self._unit(other)])
        return any(left) and along and is_zero(factor) is False

    def _placed(self, *states: int) -> bool:
        mine = set(states)
        if list(states) != sorted(mine) or not mine <= self.constant:
            return False
        xi, casimirs = mine & set(self.xi), self.model.casimirs
        plant = sorted(mine - xi)
        if (xi and xi != set(self.xi)) or not all(self._vanishes(i) for i in states):
            return False
        if not all(self._without_kinetics(i) and self._used(self.pull[i]) <= mine for i in plant):
            return False
        return all(self._used(c) <= mine for c in casimirs) and self._one_place(states)

    def _linear(self, *states: int) -> bool:
        """Whether ∂H/∂zᵢ are linear, with fractions as factors."""
        rows = [self._bend(i) for i in states]
        return all(i < self.model.n for i in states) and all(e.is_Rational for r in rows for e in r)

    def _bend(self, i: int) -> list[sp.Expr]:
        return [sp.diff(self.model.H, self.z[i], v) for v in self.z]

    def _rate_of(self, form: Form) -> Form:
        """Of Σ formᵢwᵢ, where Casimirs stay and so does what they add to w: ∇²H and ż = Jcl w."""
        total = [Fraction(0)] * self.count
        for i, share in enumerate(form):
            if not share:
                continue
            for k, slope in enumerate(_fractions(sp.Matrix([self._bend(i)]))):
                factor = share * slope
                total = [t + factor * e for t, e in zip(total, self.rates[k], strict=True)]
        return total

    def _one_place(self, states: Sequence[int]) -> bool:
        """Whether w in some states, a function of them, has a positive Jacobian."""
        form, at = self.model.form, range(len(states))
        N = arb_mat(
            [[evaluate(sp.diff(c, self.z[i]), {}) for i in states] for c in self.model.casimirs]
        )
        added = N.transpose() * hessian_floor(self.energy.k, form["k"]["activation"]) * N
        controller = hessian_floor(self.energy.hc, form["hc"]["activation"])
        for a in at:
            for b in at:
                i, k = states[a] - self.model.n, states[b] - self.model.n
                if i >= 0 and k >= 0:
                    added[a, b] = added[a, b] + controller[i, k]
        stiffness = sp.Matrix([[sp.diff(self.pull[i], self.z[k]) for k in states] for i in states])
        return self._over(stiffness, lambda A: positive(A + added, 0))

    # --- values -----------------------------------------------------------------------------------

    def _not_zero(self, expr: sp.Expr, placed: set[int]) -> bool:
        """Whether an expression keeps off 0, some states being as at z̄."""
        matrix = sp.Matrix([[expr]])
        return any(
            self._over(matrix, lambda A, sign=sign: bool(sign * A[0, 0] > 0), placed)  # type: ignore[misc]
            for sign in (1, -1)
        )

    def _over(
        self, matrix: sp.Matrix, test: Callable[[arb_mat], bool], placed: Iterable[int] = ()
    ) -> bool:
        """Whether a test holds for all values in the box, or for all there are."""
        used, fixed = sorted(self._used(matrix)), set(placed)
        sides = [self._side(i, matrix, i in fixed) for i in used]
        box: Box = tuple(side for side in sides if side is not None)
        if len(box) < len(sides):
            return False

        def on(piece: Box) -> bool:
            values = {self.z[i]: ball(*side) for i, side in zip(used, piece, strict=True)}
            return test(arb_mat([[evaluate(e, values) for e in r] for r in matrix.tolist()]))

        return by_bisection(box, on, _DEPTH, [i not in fixed for i in used])

    def _side(self, i: int, matrix: sp.Matrix, placed: bool) -> tuple[float, float] | None:
        if placed:
            return self.z_bar[i]
        if self.box is not None:
            return self.box[i]
        shifted = matrix.subs(self.z[i], self.z[i] + 2 * sp.pi)
        repeats = all(is_zero(a - b) is True for a, b in zip(shifted, matrix, strict=True))
        return (-_HALF_PERIOD, _HALF_PERIOD) if repeats else None


def _fractions(row: sp.Matrix) -> Form:
    return [Fraction(int(e.p), int(e.q)) for e in row if isinstance(e, sp.Rational)]


#: Of one value, and analytic but for isolated points and their limits.
_SINGLE_VALUED = {"sin", "cos", "tan", "sinh", "cosh", "tanh", "exp"}


def _single_valued(expr: sp.Expr) -> bool:
    """Whether an expression that is 0 on an interval is 0: the identity theorem applies."""
    if expr.is_Symbol or expr.is_number:
        return True
    if expr.is_Add or expr.is_Mul:
        return all(_single_valued(a) for a in expr.args)
    if isinstance(expr, sp.Pow):
        return bool(expr.exp.is_Integer) and _single_valued(expr.base)
    return expr.func.__name__ in _SINGLE_VALUED and _single_valued(expr.args[0])
