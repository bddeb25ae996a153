"""V = Φ(H + Hc, C) (eq. casimir_parameterization), ∇V and ∇²V over boxes in Arb balls.

Closed forms are differentiated symbolically, networks by their own derivatives.

Results are kept per box, since neighbouring cells ask for the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends, evaluate, meet
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.model import StoredDesign

__all__ = ["Energy", "hessian_hull"]


#: The entries of a matrix, by rows.
Table = list[list[arb]]
#: The entries of a symmetric matrix, i ≤ j.
_Packed = Mapping[tuple[int, int], arb]


class _Term:
    """An expression in the coordinates of a box, kept by the coordinates that it contains."""

    def __init__(self, expr: sp.Expr, variables: Sequence[sp.Symbol]) -> None:
        self.expr = expr
        self.used = [(k, v) for k, v in enumerate(variables) if expr.has(v)]
        self.constant = None if self.used else evaluate(expr, {})
        self._known: dict[Box, arb] = {}

    def __call__(self, box: Box) -> arb:
        if self.constant is not None:
            return self.constant
        key = tuple(box[k] for k, _ in self.used)
        if key not in self._known:
            self._known[key] = evaluate(self.expr, {v: ball(*box[k]) for k, v in self.used})
        return self._known[key]


class _Jet(NamedTuple):
    """A function over a box."""

    value: arb
    grad: list[arb]
    hess: Table


class Energy:
    """V in some of the states over boxes, the other states being 0."""

    def __init__(
        self, model: StoredDesign, active: Sequence[int], added: sp.Expr | None = None
    ) -> None:
        self.model, self.active, self.d = model, tuple(active), len(active)
        self.variables = [model.z[i] for i in active]
        at_rest = {s: 0 for i, s in enumerate(model.z) if i not in active}
        energy = model.H if added is None else model.H + added
        self._tables = [
            self._derivatives(sp.sympify(f).subs(at_rest)) for f in (energy, *model.casimirs)
        ]
        (self.hc, self.k, *self.betas), left = _nets(model)
        phi = model.form["phi"]
        self.phi = None if phi is None else Net.outer(phi, left)

    def _derivatives(self, f: sp.Expr) -> tuple[_Term, list[_Term], list[list[_Term]]]:
        v = self.variables
        grad = [sp.diff(f, s) for s in v]
        hess = [[_Term(sp.diff(g, s), v) for s in v] for g in grad]
        return _Term(f, v), [_Term(g, v) for g in grad], hess

    def value(self, box: Box) -> arb:
        """V over a box, by the mean-value form."""
        middle: Box = tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in box))
        naive, grad = self._first(box)
        if middle == box:
            return naive
        steps = [ball(lo, hi) - arb(m) for (lo, hi), (m, _) in zip(box, middle, strict=True)]
        centred = sum((g * s for g, s in zip(grad, steps, strict=True)), self._first(middle)[0])
        return meet(naive, centred)

    def value_and_gradient(self, box: Box) -> tuple[arb, list[arb]]:
        """V and ∇V over a box, without mean-value forms: for points."""
        return self._first(box)

    def gradient(self, box: Box) -> list[arb]:
        """∇V over a box."""
        return self._first(box)[1]

    def gradient_at(self, point: Sequence[arb]) -> list[arb]:
        """∇V at a point of balls, to the precision that is set; none is rounded to doubles."""
        values = dict(zip(self.variables, point, strict=True))
        tables = [
            (evaluate(f.expr, values), [evaluate(g.expr, values) for g in grad])
            for f, grad, _ in self._tables
        ]
        (energy, slope), inner = tables[0], tables[1:]
        hc, dhc = self.hc.at(list(point[-self.model.nc :]))
        for i, g in enumerate(dhc):
            slope[self.d - self.model.nc + i] += g
        if self.betas:
            parts = [beta.at([c]) for beta, (c, _) in zip(self.betas, inner, strict=True)]
            pairs = [(b, dc) for (_, (b,)), (_, dc) in zip(parts, inner, strict=True)]
            inner = [(sum((v for v, _ in parts), arb(0)), self._combined(pairs))]
        C, outer = self.k.at([c for c, _ in inner])
        casimir = self._combined([(w, dc) for w, (_, dc) in zip(outer, inner, strict=True)])
        if self.phi is None:
            return self._combined([(arb(1), slope), (arb(1), casimir)])
        _, (phi_e, phi_c) = self.phi.at([energy + hc, C])
        return self._combined([(phi_e, slope), (phi_c, casimir)])

    def _combined(self, parts: Sequence[tuple[arb, list[arb]]]) -> list[arb]:
        return [sum((w * v[i] for w, v in parts), arb(0)) for i in range(self.d)]

    def _first(self, box: Box) -> tuple[arb, list[arb]]:
        e, de, C, dC = self._energy_and_casimir(box)
        if self.phi is None:
            return e + C, [a + b for a, b in zip(de, dC, strict=True)]
        value, (slope_e, slope_c), _ = self.phi((ends(e), ends(C)))
        return value, [slope_e * a + slope_c * b for a, b in zip(de, dC, strict=True)]

    def _energy_and_casimir(self, box: Box) -> tuple[arb, list[arb], arb, list[arb]]:
        H, dH, _ = self._tables[0]
        hc, dhc, _ = self.hc(box[-self.model.nc :])
        grad = [g(box) for g in dH]
        for i, g in enumerate(dhc):
            grad[self.d - self.model.nc + i] += g
        C, inner, outer, _ = self._casimir(box)
        slope = [
            sum((slope * c.grad[i] for slope, c in zip(outer, inner, strict=True)), arb(0))
            for i in range(self.d)
        ]
        return H(box) + hc, grad, C, slope

    def _casimir(self, box: Box) -> tuple[arb, list[_Jet], list[arb], dict[tuple[int, int], arb]]:
        """K, its inner functions, ∇K and ∇²K."""
        inner = []
        for f, grad, hess in self._tables[1:]:
            rows = [[h(box) for h in row] for row in hess]
            inner.append(_Jet(f(box), [g(box) for g in grad], rows))
        if self.betas:
            inner = [self._summed(inner)]
        value, outer, curved = self.k(tuple(ends(c.value) for c in inner))
        return value, inner, outer, curved

    def _summed(self, inner: list[_Jet]) -> _Jet:
        """Σ βᵢ(cᵢ)."""
        total, grad = arb(0), [arb(0)] * self.d
        hess = [[arb(0)] * self.d for _ in range(self.d)]
        for beta, (c, dc, ddc) in zip(self.betas, inner, strict=True):
            b, (b1,), curved = beta((ends(c),))
            total = total + b
            grad = [g + b1 * s for g, s in zip(grad, dc, strict=True)]
            for i in range(self.d):
                for j in range(self.d):
                    hess[i][j] = hess[i][j] + b1 * ddc[i][j] + curved[0, 0] * dc[i] * dc[j]
        return _Jet(total, grad, hess)

    def casimirs(self, box: Box) -> tuple[list[arb], list[list[arb]]]:
        """The Casimirs and their gradients over a box."""
        tables = self._tables[1:]
        return [f(box) for f, _, _ in tables], [[g(box) for g in grad] for _, grad, _ in tables]

    def hessian(self, box: Box, sign: int = 1) -> arb_mat:
        """A matrix L with ∇²V ⪰ L (sign 1) or ∇²V ⪯ L (sign −1) over a box.

        Where Φ is the sum, ∇²K and ∇²Hc enter through one matrix below (above) all of theirs.
        """
        sharp = self.phi is None
        return self._curvature(box, lambda h, k: _loewner(h, k, sign) if sharp else h)

    def entries(self, box: Box) -> arb_mat:
        """∇²V over a box, entry by entry."""
        return self._curvature(box, lambda h, _: h)

    def curvatures(self, box: Box) -> list[tuple[arb_mat, arb_mat]]:
        """∇²(Hc + C) = Σ LᵀAL over a box where Φ is the sum, in (A, L), L constant.

        Where the Casimirs are affine, ∇²K is one A.
        """
        grads = [grad for _, grad, _ in self._tables[1:]]
        if self.betas or any(g.constant is None for grad in grads for g in grad):
            whole = self._curvature(box, lambda h, _: h, energy=False)
            return [(whole, arb_mat([[int(i == j) for j in range(self.d)] for i in range(self.d)]))]
        first, nc = self.d - self.model.nc, self.model.nc
        frame = arb_mat([[int(first + i == j) for j in range(self.d)] for i in range(nc)])
        slopes = arb_mat([[g(box) for g in grad] for grad in grads])
        curved = self.k.curvature_on_grid(tuple(ends(c) for c in self.casimirs(box)[0]))
        controller = _unpacked(self.hc.curvature_on_grid(box[first:]), nc)
        return [
            (controller, frame),
            (_unpacked(curved, len(grads)), slopes),
        ]

    def _curvature(
        self, box: Box, made: Callable[[_Packed, int], _Packed], energy: bool = True
    ) -> arb_mat:
        """∇²V with the Hessians of Hc and of K, of as many inputs, as they are made.

        Without that of H where Φ is the sum and it is not asked for.
        """
        H, first = self._tables[0][2], self.d - self.model.nc
        _, _, curved = self.hc(box[first:])
        _, inner, outer, curved_k = self._casimir(box)
        total = [[h(box) if energy else arb(0) for h in row] for row in H]
        self._add(total, made(curved, self.model.nc), first)
        part = [[arb(0)] * self.d for _ in range(self.d)] if self.phi is not None else total
        weights = made(curved_k, len(inner))
        for a, (_, _, ddc) in enumerate(inner):
            for i in range(self.d):
                for j in range(self.d):
                    part[i][j] = part[i][j] + outer[a] * ddc[i][j]
        for (a, b), w in weights.items():
            self._add_outer(part, w, inner[a].grad, inner[b].grad, a != b)
        return arb_mat(total) if self.phi is None else self._through_phi(box, total, part)

    def hull(self, box: Box) -> list[list[arb]]:
        """∇²V over a small box, entry by entry."""
        if self.phi is not None or self.betas:
            return hessian_hull(self, box).tolist()
        first = self.d - self.model.nc
        total = [[h(box) for h in row] for row in self._tables[0][2]]
        self._add(total, self.hc.curvature(box[first:]), first)
        values, grads = self.casimirs(box)
        inner = tuple(ends(c) for c in values)
        middle = self.k(tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in inner)))[1]
        curved = self.k.curvature(inner)
        steps = [ball(lo, hi) - arb(lo / 2 + hi / 2) for lo, hi in inner]
        for a, (_, _, ddc) in enumerate(self._tables[1:]):
            slope = middle[a]
            for b, step in enumerate(steps):
                slope = slope + curved[min(a, b), max(a, b)] * step
            for i in range(self.d):
                for j in range(self.d):
                    total[i][j] = total[i][j] + slope * ddc[i][j](box)
        for (a, b), w in curved.items():
            self._add_outer(total, w, grads[a], grads[b], a != b)
        return total

    @staticmethod
    def _add(total: list[list[arb]], block: Mapping[tuple[int, int], arb], first: int) -> None:
        for (i, j), h in block.items():
            total[first + i][first + j] = total[first + i][first + j] + h
            if i != j:
                total[first + j][first + i] = total[first + j][first + i] + h

    def _add_outer(self, total: Table, w: arb, u: list[arb], v: list[arb], both: bool) -> None:
        for i in range(self.d):
            for j in range(self.d):
                term = u[i] * v[j] + v[i] * u[j] if both else u[i] * v[j]
                total[i][j] = total[i][j] + w * term

    def _through_phi(self, box: Box, energy: Table, casimir: Table) -> arb_mat:
        e, de, C, dC = self._energy_and_casimir(box)
        if self.phi is None:
            return arb_mat(energy)
        _, (pe, pc), curved = self.phi((ends(e), ends(C)))
        result = [
            [pe * energy[i][j] + pc * casimir[i][j] for j in range(self.d)] for i in range(self.d)
        ]
        for (a, b), w in curved.items():
            self._add_outer(result, w, (de, dC)[a], (de, dC)[b], a != b)
        return arb_mat(result)

    def slope(self, box: Box) -> arb:
        """Φ₁ over a box."""
        if self.phi is None:
            return arb(1)
        e, _, C, _ = self._energy_and_casimir(box)
        return self.phi((ends(e), ends(C)))[1][0]


def _unpacked(curved: _Packed, size: int) -> arb_mat:
    pairs = [[(min(i, j), max(i, j)) for j in range(size)] for i in range(size)]
    return arb_mat([[curved[pair] for pair in row] for row in pairs])


def _nets(model: StoredDesign) -> tuple[list[Net], list[float]]:
    """Hc, K and the βᵢ, and the weights that are left, those of Φ."""
    nets, left = [], model.weights
    for shape in (model.form["hc"], model.form["k"], *model.form["betas"]):
        net, used = Net.from_weights(shape, left)
        nets.append(net)
        left = left[used:]
    return nets, left


def hessian_hull(energy: Energy, box: Box) -> arb_mat:
    """∇²V over a box: between its bounds from below and from above, entry by entry.

    From L ⪯ A ⪯ U follows |A − (L+U)/2| ≤ ½ tr(U − L) in every entry.
    """
    low, high = energy.hessian(box), energy.hessian(box, -1)
    slack = arb(0)
    for i in range(low.nrows()):
        slack = slack + (high[i, i] - low[i, i]).abs_upper()
    middle = (low + high) / 2
    width = ball(-1.0, 1.0) * slack
    return arb_mat([[v + width for v in row] for row in middle.tolist()])


def _loewner(
    hess: Mapping[tuple[int, int], arb], size: int, sign: int
) -> dict[tuple[int, int], arb]:
    """Thin matrix ⪯ (sign 1) or ⪰ (sign −1) every symmetric matrix enclosed."""
    spread = [arb(0)] * size
    for (i, j), h in hess.items():
        spread[i] = spread[i] + h.rad()
        if i != j:
            spread[j] = spread[j] + h.rad()
    worst = spread[0]
    for s in spread[1:]:
        worst = worst.max(s)
    return {(i, j): h.mid() - sign * worst if i == j else h.mid() for (i, j), h in hess.items()}
