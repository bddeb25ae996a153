"""A region in the coordinates (c, ξ), where V is a sum and which the states map to one-to-one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, norm
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.evidence import Evidence
from necc_casadi.certificate.checker.region.shells import Shells
from necc_casadi.certificate.checker.region.sizes import ball_volume, sides_of, sizes_hold
from necc_casadi.certificate.checker.region.transport import Transport

__all__ = ["ChartProof"]


#: Cells of the fibre per axis, by dimension, and shells of |η| on the way from it.
_CELLS, _FEWEST, _STEPS = {1: 512, 2: 64, 3: 16}, 5, 16


#: Parts per axis on which ∂c/∂q is bounded for the volume, and of ways along which V is.
_COARSE, _PIECES = 3, 32


class ChartProof:
    """V = e₀ + K(c) + Hc(ξ): growth of K and Hc, a fibre without folds, motion within the domain.

    Where V ≤ c, k(|α|) + k_H(|η|) is at most c − V(ȳ), with α = A_K(c − c̄), η = A_H(ξ − ξ̄). On the
    fibre ξ = ξ̄ the cells with |α| ≤ a lie inside its box, and ∂α/∂q is regular on them; from there
    q stays in the domain while ξ moves to |η| ≤ b along the Casimirs.
    """

    def __init__(
        self, checker: Evidence, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level, self.a, self.b, self.above = (
            float(region[key]) for key in ("level", "a", "b", "above")
        )
        self.center, self.middle = ([float(v) for v in region[key]] for key in ("center", "middle"))
        self.A_K, self.A_H = (
            arb_mat([[float(v) for v in row] for row in region[key]])
            for key in ("scale_k", "scale_h")
        )
        self.box: Box = tuple((float(lo), float(hi)) for lo, hi in region["fibre"])
        self.d, self.r = len(self.center), len(self.middle)
        self._shells = {
            key: [float(v) for v in region[key]] for key in ("radii_k", "nu_k", "radii_h", "nu_h")
        }

    def hull(self) -> Box:
        """A box of the active states that holds the region: q in the domain, |η| ≤ b."""
        bounds = self.checker.model.bounds()
        q = [(ends(bounds[i][0])[0], ends(bounds[i][1])[1]) for i in self.energy.active[: self.r]]
        return (*q, *self._xi(self.b))

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        """Whether the region and the sizes that are claimed of it are proved again."""
        if not self._separate():
            return False
        near = tuple(
            (min(c, lo), max(c, hi)) for c, (lo, hi) in zip(self.center, self.z_bar, strict=True)
        )
        return (
            min(self.a, self.b, self.above) > 0
            and bool(self.energy.value(near) <= self.level)
            and self.k.holds()
            and self.hc.holds()
            and self._bounded()
            and self._no_fold()
            and self._stays()
            and sizes_hold(self._sizes(data), data, share)
        )

    @cached_property
    def k(self) -> Shells:
        """Growth of K."""
        shells = self._shells
        return Shells(
            self.energy.k, self.middle, self.A_K, shells["radii_k"], shells["nu_k"], self.above
        )

    @cached_property
    def hc(self) -> Shells:
        """Growth of Hc."""
        shells, xi_bar = self._shells, self.center[self.r :]
        return Shells(
            self.energy.hc, xi_bar, self.A_H, shells["radii_h"], shells["nu_h"], self.above
        )

    def _separate(self) -> bool:
        """V = K(c) + Hc(ξ) up to a constant, and motions along Casimirs from the momenta."""
        model, energy = self.checker.model, self.energy
        resting = [i for i in range(len(model.z)) if i not in energy.active]
        rest = sp.sympify(model.H).subs(dict.fromkeys((model.z[i] for i in resting), 0))
        counted = self.d == energy.d == self.r + model.nc and self.r == len(model.casimirs)
        last = list(energy.active[self.r :]) == list(range(model.n, model.n + model.nc))
        last = last and self.center[self.r :] == model.xi_star
        if not (counted and last and len(resting) == model.nc and len(self.box) == self.r):
            return False
        shapes = [(m.nrows(), m.ncols()) for m in (self.A_K, self.A_H)]
        square = shapes == [(self.r, self.r), (model.nc, model.nc)]
        proper = square and all(bool(abs(A.det()) > 0) for A in (self.A_K, self.A_H))
        columns = (model.Jcl - model.Rcl).extract(list(energy.active), resting)
        self.along, self.across = columns[: self.r, :], columns[self.r :, :]
        self.q, self.xi = energy.variables[: self.r], energy.variables[self.r :]
        apart = not (
            self.along.free_symbols - set(self.q) or self.across.free_symbols - set(self.xi)
        )
        plain = energy.phi is None and not energy.betas and not rest.free_symbols
        return proper and apart and plain

    def _bounded(self) -> bool:
        """|α| ≤ a and |η| ≤ b wherever V ≤ c, on the shells, which end in the domain."""
        self.height = arb(self.level) - self._bottom() + self.k.dip() + self.hc.dip()
        reached = self.a <= self._shells["radii_k"][-1] and self.b <= self._shells["radii_h"][-1]
        outside = self.k.at(arb(self.a)) > self.height and self.hc.at(arb(self.b)) > self.height
        bounds = self.checker.model.bounds()[self.checker.model.n :]
        inside = all(
            bool(bound[0] <= lo) and bool(hi <= bound[1])
            for bound, (lo, hi) in zip(bounds, self._xi(self.b), strict=True)
        )
        return reached and bool(outside) and inside

    def _bottom(self) -> arb:
        """e₀ + K(c̄) + Hc(ξ̄), above which K and Hc grow."""
        model = self.checker.model
        resting = [v for i, v in enumerate(model.z) if i not in self.energy.active]
        rest = evaluate(sp.sympify(model.H).subs(dict.fromkeys(resting, 0)), {})
        return arb(rest + self.k.bottom + self.hc.bottom)

    def _xi(self, b: float) -> Box:
        half = [arb(b) * norm(row) for row in self.A_H.inv().tolist()]
        pairs = zip(self.center[self.r :], half, strict=True)
        return tuple(ends(c + h * ball(-1.0, 1.0)) for c, h in pairs)

    # --- the fibre --------------------------------------------------------------------------------

    def _no_fold(self) -> bool:
        """Cells of the fibre with |α| ≤ a, one with q̄, are regular and inside; they are kept."""
        parts, q_bar = _CELLS.get(self.r, _FEWEST), self.center[: self.r]
        if not all(lo < q < hi for q, (lo, hi) in zip(q_bar, self.box, strict=True)):
            return False
        if not self._alpha(tuple((q, q) for q in q_bar))[1] <= self.a:
            return False
        edges = [[lo + (hi - lo) * k / parts for k in range(parts)] + [hi] for lo, hi in self.box]
        self.cells: dict[tuple[int, ...], tuple[Box, arb, arb]] = {}
        for index in itertools.product(range(parts), repeat=self.r):
            cell = tuple((e[k], e[k + 1]) for e, k in zip(edges, index, strict=True))
            least, most, slopes = self._alpha(cell)
            if least > self.a:
                continue
            if any(k in (0, parts - 1) for k in index) or not _regular(slopes):
                return False
            self.cells[index] = (cell, least, most)
        return bool(self.cells)

    def _alpha(self, cell: Box) -> tuple[arb, arb, arb_mat]:
        """Bounds of |α| on a cell of the fibre, and ∂α/∂q."""
        xi, at = [arb(v) for v in self.center[self.r :]], [arb(lo / 2 + hi / 2) for lo, hi in cell]
        c, slopes = self._tapes
        shift = arb_mat([[v - m] for v, m in zip(c((*at, *xi)), self.middle, strict=True)])
        alpha = [row[0] for row in (self.A_K * shift).tolist()]
        balls = [ball(*b) for b in cell]
        G = self.A_K * arb_mat(self.r, self.r, slopes((*balls, *xi)))
        steps = [b - m for b, m in zip(balls, at, strict=True)]
        change = (G * arb_mat([[s] for s in steps])).tolist()
        wide = norm([v + row[0] for v, row in zip(alpha, change, strict=True)])
        u = [float(v.mid()) for v in alpha]
        size = float(np.linalg.norm(u)) or 1.0
        weights = arb_mat([[v / size for v in u]])
        along = (weights * G).tolist()[0]
        side = (weights * arb_mat([[v] for v in alpha])).tolist()[0][0]
        side = side + sum((g * s for g, s in zip(along, steps, strict=True)), arb(0))
        length = norm([arb(v / size) for v in u]).upper().max(arb(1))
        return wide.lower().max((side / length).lower()), wide.upper(), G

    @cached_property
    def _tapes(self) -> tuple[Tape, Tape]:
        """C and ∂c/∂q."""
        casimirs, y = self.checker.model.casimirs, self.energy.variables
        return Tape(casimirs, y), Tape([sp.diff(c, s) for c in casimirs for s in self.q], y)

    def _fibre_within(self, a: arb) -> list[arb]:
        """A box around |α| ≤ a on the fibre."""
        near = [cell for cell, least, _ in self.cells.values() if not least > a]
        return [
            ball(min(cell[i][0] for cell in near), max(cell[i][1] for cell in near))
            for i in range(self.r)
        ]

    def _stays(self) -> bool:
        """On the way to |η| ≤ b, q stays in the domain."""
        radii = [arb(self.b) * k / _STEPS for k in range(_STEPS + 1)]

        starts = [
            self._fibre_within(self._radius(self.height - self.hc.at(rho))) for rho in radii[:-1]
        ]
        bounds = [self.checker.model.bounds()[i] for i in self.energy.active[: self.r]]

        def inside(box: list[arb]) -> bool:
            return all(
                bool(lo <= v.lower()) and bool(v.upper() <= hi)
                for v, (lo, hi) in zip(box, bounds, strict=True)
            )

        cut = [k for k, s in enumerate(self.q) if self.along.has(s)]
        motion = Transport(
            Tape(list(self.along), self.q), Tape(list(self.across), self.xi), cut,
            self.center[self.r :], self.A_H.inv(), radii, starts,
        )  # fmt: skip
        self.reached = motion.hull(inside)
        return self.reached is not None

    def _radius(self, height: arb) -> arb:
        """A radius beyond which K rises by more than `height`, at most a; by bisection."""
        low, high = arb(0), arb(self.a)
        for _ in range(30):
            middle = arb(((low + high) / 2).mid())
            low, high = (low, middle) if self.k.at(middle) > height else (middle, high)
        return high

    # --- sizes ------------------------------------------------------------------------------------

    def _sizes(self, data: Mapping[str, Any]) -> dict[str, arb]:
        model, active = self.checker.model, self.energy.active
        rho = self._inner()
        scale = abs(self.A_K.det() * self.A_H.det())
        volume = ball_volume(self.d) * rho**self.d / (scale * self._steepest())
        covered = sum((_volume(cell) for cell in self._around(rho)), arb(0))
        reach = {f"reach_{model.states[i]}": k for k, i in enumerate(active[: self.r])}
        far = {name: float(data[name]) for name in reach if name in data}
        # every ξ with |η| ≤ rho is reached from q̄ along the Casimirs
        rows = zip(active[self.r :], self.A_H.inv().tolist(), strict=True)
        return {
            "volume": volume,
            "domain_share": volume / sides_of(model, active),
            "slice_share": covered / sides_of(model, active[: self.r]),
            **{
                name: arb(s)
                for name, s in far.items()
                if self._reaches(reach[name], (arb(s) + self._offset(reach[name])).upper())
            },
            **{
                f"reach_{model.states[i]}": rho * norm(row) - self._offset(self.r + k)
                for k, (i, row) in enumerate(rows)
            },
        }

    def _around(self, rho: arb) -> list[Box]:
        """Cells with |α| ≤ rho that are joined to one that holds q̄ by cells of this kind."""
        inside = {index for index, (_, _, most) in self.cells.items() if most <= rho}
        q_bar = self.center[: self.r]
        todo = [
            index
            for index in inside
            if all(lo <= q <= hi for q, (lo, hi) in zip(q_bar, self.cells[index][0], strict=True))
        ]
        found = set(todo)
        while todo:
            index = todo.pop()
            for move in itertools.product((-1, 0, 1), repeat=self.r):
                other = tuple(k + m for k, m in zip(index, move, strict=True))
                if other in inside and other not in found:
                    found.add(other)
                    todo.append(other)
        return [self.cells[index][0] for index in found]

    def _inner(self) -> arb:
        """A radius of (α, η) up to which V ≤ c."""
        height = (arb(self.level) - self._bottom()).max(arb(0))
        slope = norm([self.k.slope, self.hc.slope])
        root = (slope * slope + 2 * self.above * height).sqrt()
        return arb(((root - slope) / self.above).lower().min(arb(self.a)).min(arb(self.b)))

    def _steepest(self) -> arb:
        """An upper bound of Π ‖∂cᵢ/∂q‖ on the region."""
        sides = [*(ends(v) for v in self.reached or []), *self._xi(self.b)]
        cuts = [
            list(pairwise([*(lo + (hi - lo) * k / _COARSE for k in range(_COARSE)), hi]))
            for lo, hi in sides
        ]
        most = arb(0)
        for box in itertools.product(*cuts):
            slopes, product = self._tapes[1]([ball(*b) for b in box]), arb(1)
            for i in range(self.r):
                product = product * norm(slopes[i * self.r : (i + 1) * self.r]).upper()
            most = most.max(product)
        return most

    def _offset(self, k: int) -> arb:
        """How far z̄ may be from ȳ in a state."""
        return arb(abs(ball(*self.z_bar[k]) - self.center[k]).upper())

    @cached_property
    def _ways(self) -> np.ndarray[Any, Any]:
        """Directions in which Ω reaches far in each state, a guess."""
        at: Box = tuple((v, v) for v in self.center)
        return np.asarray(np.linalg.inv(middle_of(self.energy.hessian(at))))

    def _reaches(self, k: int, s: arb) -> bool:
        """Whether straight ways to points s away in the k-th state, on both sides, stay in Ω."""
        way, far = self._ways[k] / self._ways[k, k], math.nextafter(float(s), math.inf)
        return all(self._below(sign * far, way.tolist()) for sign in (-1.0, 1.0))

    def _below(self, s: float, way: Sequence[float]) -> bool:
        bounds = [self.checker.model.bounds()[i] for i in self.energy.active]
        for k in range(_PIECES):
            low, high = s * k / _PIECES, s * (k + 1) / _PIECES
            pairs = [(c + low * w, c + high * w) for c, w in zip(self.center, way, strict=True)]
            piece: Box = tuple((min(p), max(p)) for p in pairs)
            inside = all(
                bool(b[0] <= lo) and bool(hi <= b[1])
                for b, (lo, hi) in zip(bounds, piece, strict=True)
            )
            if not (inside and bool(self.energy.value(piece) <= self.level)):
                return False
        return True


def _regular(G: arb_mat) -> bool:
    """Whether every matrix in the ball is regular."""
    near = middle_of(G)
    if not np.isfinite(near).all() or np.linalg.matrix_rank(near) < len(near):
        return False
    product = (arb_mat(np.linalg.inv(near).tolist()) * G).tolist()
    return all(
        bool(sum((abs(v - int(i == j)) for j, v in enumerate(row)), arb(0)) < 1)
        for i, row in enumerate(product)
    )


def _volume(cell: Box) -> arb:
    result = arb(1)
    for lo, hi in cell:
        result = result * (arb(hi) - arb(lo))
    return result
