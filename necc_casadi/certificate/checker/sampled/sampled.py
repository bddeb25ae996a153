"""The claim about the sampled loop, box by box (docs/theory.md#sampled-loop)."""

from __future__ import annotations

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, meet
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.loops import StoredInterconnection
from necc_casadi.certificate.checker.sampled.linear import falls
from necc_casadi.certificate.checker.sampled.step import StepProof
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.sampled import BEYOND, SampledRegion

__all__ = ["check_sampled"]


#: How often a box of the certificate may be halved again, and the core.
_AGAIN, _CORE = 16, 12


def check_sampled(evidence: Evidence, sound: bool) -> Checked:
    """Every solution of the sampled loop from {W < w₀} converges to z̄, whatever the periods."""
    if not evidence.claimed("sampled"):
        return Checked("sampled", False, "nothing is claimed of the sampled loop")
    region, model = SampledRegion.read(evidence.claims["sampled"].data), evidence.model
    size = len(model.z)
    square = len(region.metric) == size and all(len(row) == size for row in region.metric)
    if not (square and len(region.box) == len(region.core) == size):
        raise ValueError("the sampled region does not fit the states")
    if not region.leaves:  # read before anything else is proved
        raise ValueError("the sampled region has no boxes")
    text = statements.sampled(region, model.states, model.units, model.stated_limits or ())
    stable = ("V decreases around a minimum", lambda: sound)
    return Checked.by("sampled", text, [stable, *_Sampled(evidence, region).obligations()])


class _Sampled:
    """What has to be proved of {W < w₀}."""

    def __init__(self, evidence: Evidence, region: SampledRegion) -> None:
        self.evidence, self.model, self.region = evidence, evidence.model, region
        self.energy = evidence.full
        self.step = StepProof(self.model, self.energy, region.integrator)
        self.Q = arb_mat([list(row) for row in region.metric])

    def obligations(self) -> list[Obligation]:
        """Each in words, with its proof."""
        model, form = self.model, self.model.form
        return [
            ("Φ is the sum H + Hc + C", lambda: form["phi"] is None),
            (
                "the loop is the published one",
                lambda: isinstance(model.loop, StoredInterconnection) and model.ahead is None,
            ),
            ("no integral action is added to it", lambda: model.integral is None),
            ("the controller's structure is constant", lambda: self.step.covered),
            ("a period and a symmetric Q", self._is_meant),
            ("the box is within the bounds that the model names", self._is_within_bounds),
            ("everything is smooth on the box", self._is_smooth),
            ("V has one minimum in the core", self._has_core),
            ("the height above V(z̄)", self._is_above),
            ("W falls at every step, on every box", self.on_every_box),
        ]

    def _is_meant(self) -> bool:
        Q, size = self.region.metric, range(len(self.region.metric))
        symmetric = all(Q[i][j] == Q[j][i] for i in size for j in size)
        return symmetric and self.region.period > 0 and self.region.height > 0

    def _is_within_bounds(self) -> bool:
        pairs = zip(self.region.box, self.model.named_bounds, strict=True)
        return all(a <= lo < hi <= b for (lo, hi), (a, b) in pairs)

    def _is_smooth(self) -> bool:
        """A derivative may hide a jump of V, which W would not see."""
        return is_smooth_on(self.model.written, self.model.z, self.region.box)

    def _has_core(self) -> bool:
        """∇²V ≻ 0 on the core, which holds z̄ and is in the box."""
        core, home = self.region.core, self.evidence.z_bar(range(len(self.region.box)))
        inside = all(a <= lo and hi <= b for (a, b), (lo, hi) in zip(core, home, strict=True))
        within = all(
            a < lo and hi < b for (a, b), (lo, hi) in zip(self.region.box, core, strict=True)
        )
        return (
            inside
            and within
            and by_bisection(core, lambda box: positive(self.energy.hessian(box), 0), _CORE)
        )

    def _is_above(self) -> bool:
        """W(z̄) = V(z̄)."""
        bottom = self.energy.value(self.evidence.z_bar(range(len(self.region.box))))
        return bool(bottom + self.region.height <= self.region.level)

    def on_every_box(self) -> bool:
        """Whether W > w₀ or Π ≺ 0, ∇V ≠ 0 or ∇²V ≻ 0, u is kept, on boxes that are the whole."""
        return all(self._proved(cell, node, _AGAIN) for cell, node in self.region.leaves)

    def _proved(self, cell: Box, node: int, left: int) -> bool:
        box, period = cell[:-1], cell[-1]
        if node == BEYOND and self._beyond(box):
            return True
        if node != BEYOND and self._kept(box, period):
            return True
        if node != BEYOND and self._beyond(box):
            return True
        if left == 0:
            return False
        shares = [
            (hi - lo) / (b - a) for (lo, hi), (a, b) in zip(cell, self.region.root, strict=True)
        ]
        k = max(range(len(cell) - (node == BEYOND)), key=shares.__getitem__)
        lo, hi = cell[k]
        middle = lo / 2 + hi / 2
        return all(
            self._proved((*cell[:k], half, *cell[k + 1 :]), node, left - 1)
            for half in ((lo, middle), (middle, hi))
        )

    def _beyond(self, box: Box) -> bool:
        """W > w₀ by its mean-value form."""
        middle = _middle(box)
        value, at = self.energy.value_and_gradient(middle)
        gradient, S = self._gradient_and_hessian(box)
        column = arb_mat([[v] for v in gradient])
        slope = column + S * (self.Q * column)
        W = value + self._square(at) / 2
        for step, (g,) in zip(_steps(box, middle), slope.tolist(), strict=True):
            W = W + g * step
        return bool(self.region.level < W)

    def _gradient_and_hessian(self, box: Box) -> tuple[list[arb], arb_mat]:
        """∇V by its mean-value form, and ∇²V."""
        middle, S = _middle(box), self.energy.entries(box)
        moved = S * arb_mat([[step] for step in _steps(box, middle)])
        at = self.energy.gradient(middle)
        centred = [v + m for v, (m,) in zip(at, moved.tolist(), strict=True)]
        return [meet(a, b) for a, b in zip(self.energy.gradient(box), centred, strict=True)], S

    def _square(self, g: list[arb]) -> arb:
        column = arb_mat([[v] for v in g])
        return (column.transpose() * self.Q * column)[0, 0]

    def _kept(self, box: Box, period: tuple[float, float]) -> bool:
        root = self.region.box
        if any(lo <= a or b <= hi for (lo, hi), (a, b) in zip(box, root, strict=True)):
            return False
        gradient, _ = self._gradient_and_hessian(box)
        core = self.region.core
        home = all(a <= lo and hi <= b for (a, b), (lo, hi) in zip(core, box, strict=True))
        if not (home or any(bool(g > 0) or bool(g < 0) for g in gradient)):
            return False
        u = self.step.inputs(box, gradient)
        limits = self.model.u_limits or ()
        if not all(bool(v >= lo) and bool(v <= hi) for v, (lo, hi) in zip(u, limits, strict=False)):
            return False
        form = self.step.form(box, gradient, u, period, self.Q)
        return form is not None and falls(form)


def _middle(box: Box) -> Box:
    return tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in box))


def _steps(box: Box, middle: Box) -> list[arb]:
    return [ball(lo, hi) - arb(m) for (lo, hi), (m, _) in zip(box, middle, strict=True)]
