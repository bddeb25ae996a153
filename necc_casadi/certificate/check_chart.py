"""A region in the coordinates (c, ξ), where V is a sum and which the states map to one-to-one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.ball_energy import Energy
from necc_casadi.certificate.ball_matrices import norm, positive
from necc_casadi.certificate.ball_networks import Net
from necc_casadi.certificate.balls import Box, ball, ends, everywhere
from necc_casadi.certificate.check_evidence import Evidence

__all__ = ["ChartProof"]

#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


class ChartProof:
    """V = K(c) + Hc(ξ) in coordinates g = (c, ξ): the map y → g is one-to-one on an ellipsoid.

    y = ȳ + Bw with |w| ≤ ρ, θ = A(g − ḡ), A = diag(A_K, A_H), M = Dθ at ȳ, βₖ ≥ ‖A Dᵏc(B·, …)‖ at ȳ
    and, for the last k, on the ellipsoid. By Taylor's formula ‖Dθ − M‖ ≤ Σ βₖ ρᵏ⁻¹/(k−1)! and
    ||θ| − |Mw|| ≤ |θ(0)| + Σ βₖ |w|ᵏ/k!. V is convex in g on |θ| ≤ size, and above c on its border.
    """

    def __init__(
        self, checker: Evidence, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level, self.radius, self.size, self.nu, self.above, self.inner = (
            float(region[key]) for key in ("level", "radius", "size", "nu", "above", "inner")
        )
        self.center, self.middle, self.bends = (
            [float(v) for v in region[key]] for key in ("center", "middle", "bends")
        )
        self.B, self.A_K, self.A_H = (
            arb_mat([[float(v) for v in row] for row in region[key]])
            for key in ("basis", "scale_k", "scale_h")
        )
        self.d, self.r = len(self.center), len(self.middle)
        self.half = [arb(self.radius) * norm(row) for row in self.B.tolist()]

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        """Whether the region and the size that is claimed of it are proved again."""
        if not (self._separate() and self._in_domain()):
            return False
        self.eta, self.offset = self._linear()
        shift = [[ball(*z) - c] for z, c in zip(self.z_bar, self.center, strict=True)]
        near = self.B.inv() * arb_mat(shift)
        return (
            min(self.radius, self.size, self.nu, self.above, self.inner, *self.bends) > 0
            and bool(norm([row[0] for row in near.tolist()]) < self.inner)
            and self._one_to_one()
            and self._rises()
            and self._covers(data, share)
            and all(self._bend(k, beta) for k, beta in enumerate(self.bends, 2))
            and self._curved(self.energy.k, self.middle, self.A_K)
            and self._curved(self.energy.hc, self.center[self.r :], self.A_H)
        )

    def _separate(self) -> bool:
        """V = K(c) + Hc(ξ) up to a constant, in as many coordinates as there are states."""
        model, energy = self.checker.model, self.energy
        resting = {v: 0 for i, v in enumerate(model.z) if i not in energy.active}
        constant = not sp.sympify(model.H).subs(resting).free_symbols
        counted = self.d == energy.d == self.r + model.nc and self.r == len(model.casimirs)
        last = list(energy.active[self.r :]) == list(range(model.n, model.n + model.nc))
        shapes = [(m.nrows(), m.ncols()) for m in (self.B, self.A_K, self.A_H)]
        square = shapes == [(self.d, self.d), (self.r, self.r), (model.nc, model.nc)]
        plain = energy.phi is None and not energy.betas and len(self.bends) >= 2
        return constant and counted and last and square and plain

    def _in_domain(self) -> bool:
        bounds = self.checker.model.bounds()
        return all(
            bool(bounds[i][0] <= c - h) and bool(c + h <= bounds[i][1])
            for i, c, h in zip(self.energy.active, self.center, self.half, strict=True)
        )

    def _linear(self) -> tuple[arb, arb]:
        """(η, |θ(0)|): the singular values of M are within η of 1."""
        at: Box = tuple((c, c) for c in self.center)
        values, slopes = self.energy.casimirs(at)
        rows = (self.A_K * arb_mat(slopes)).tolist()
        rows += [[arb(0)] * self.r + row for row in self.A_H.tolist()]
        M = arb_mat(rows) * self.B
        gram = (M.transpose() * M).tolist()
        eta = norm([v - int(i == j) for i, row in enumerate(gram) for j, v in enumerate(row)])
        shift = self.A_K * arb_mat([[v - m] for v, m in zip(values, self.middle, strict=True)])
        return eta, norm([row[0] for row in shift.tolist()])

    def _one_to_one(self) -> bool:
        """On the ellipsoid, whose image covers |θ| ≤ size."""
        rho = arb(self.radius)
        turn = sum((b * rho ** (k - 1) / math.factorial(k - 1) for k, b in self._orders()), arb(0))
        least = (1 - self.eta) * rho - self.offset - self._curl(rho)
        return bool(turn < 1 - self.eta) and bool(least > self.size)

    def _orders(self) -> list[tuple[int, arb]]:
        return [(k, arb(b)) for k, b in enumerate(self.bends, 2)]

    def _curl(self, r: arb) -> arb:
        return sum((b * r**k / math.factorial(k) for k, b in self._orders()), arb(0))

    def _rises(self) -> bool:
        """V > c on |θ| = size, and V ≤ c on |w| ≤ inner."""
        k, dk, _ = self.energy.k(tuple((v, v) for v in self.middle))
        hc, dhc, _ = self.energy.hc(tuple((v, v) for v in self.center[self.r :]))
        parts = [
            A.inv().transpose() * arb_mat([[v] for v in g])
            for A, g in ((self.A_K, dk), (self.A_H, dhc))
        ]
        slope = norm([row[0] for part in parts for row in part.tolist()])
        size, r = arb(self.size), arb(self.inner)
        most = (1 + self.eta) * r + self.offset + self._curl(r)  # of |θ| on |w| ≤ inner
        border = k + hc - slope * size + arb(self.nu) * size * size / 2
        highest = k + hc + slope * most + arb(self.above) * most * most / 2
        within = self.inner <= self.radius and bool(most <= size)
        return within and bool(border > self.level) and bool(highest <= self.level)

    def _bend(self, order: int, beta: float) -> bool:
        """βₖ bounds the tensor, flattened to a matrix, in the spectral norm."""
        last = order == len(self.bends) + 1
        pairs = zip(self.center, self.half, strict=True)
        box = tuple(ends(c + h * ball(-1, 1)) if last else (c, c) for c, h in pairs)
        rows = self.energy.casimir_derivatives(order, box)
        A, B = self.A_K, self.B
        if last:  # only magnitudes count where entries vary independently
            rows = [[abs(v).upper() for v in row] for row in rows]
            A, B = (arb_mat([[abs(v) for v in row] for row in X.tolist()]) for X in (A, B))
        flat = [v for row in (A * arb_mat(rows)).tolist() for v in row]
        for _ in range(order):
            n = len(flat) // self.d
            turned = (arb_mat(n, self.d, flat) * B).tolist()
            per = n // self.r  # the axis that was turned moves behind the rows of A
            flat = [
                turned[a * per + i][j]
                for a in range(self.r)
                for j in range(self.d)
                for i in range(per)
            ]
        X = arb_mat(self.r * self.d ** (order // 2), self.d ** (order - order // 2), flat)
        gram = X * X.transpose() if X.nrows() <= X.ncols() else X.transpose() * X
        room = -gram
        for i in range(room.nrows()):
            room[i, i] = room[i, i] + arb(beta) * arb(beta)
        return positive(room, 0)

    def _curved(self, net: Net, middle: list[float], A: arb_mat) -> bool:
        """ν AᵀA ⪯ ∇² ⪯ above AᵀA on |A(v − middle)| ≤ size."""
        P, inverse = A.transpose() * A, A.inv()
        half = [arb(self.size) * norm(row) for row in inverse.tolist()]
        box = tuple(ends(m + h * ball(-1, 1)) for m, h in zip(middle, half, strict=True))

        def test(piece: Box) -> bool:
            e = arb_mat([[ball(*b) - m] for b, m in zip(piece, middle, strict=True)])
            if norm([row[0] for row in (A * e).tolist()]) > self.size:
                return True
            pairs, n = net(piece)[2], len(middle)
            hess = arb_mat([[pairs[min(i, j), max(i, j)] for j in range(n)] for i in range(n)])
            return positive(hess - P * arb(self.nu), 0) and positive(P * arb(self.above) - hess, 0)

        return everywhere(box, test, _DEPTH)

    def _covers(self, data: Mapping[str, Any], share: float) -> bool:
        """The ellipsoid |w| ≤ inner is in the region; its size is as claimed."""
        r, d = arb(self.inner), arb(self.d)
        volume = arb.pi() ** (d / 2) / (d / 2 + 1).gamma() * r**self.d * abs(self.B.det())
        for i in self.energy.active:
            lo, hi = self.checker.model.bounds()[i]
            volume = volume / (hi - lo)
        states = [self.checker.model.states[i] for i in self.energy.active]
        half = [r * norm(row) for row in self.B.tolist()]
        reach = dict(zip(states, half, strict=True))
        sizes = all(
            bool(reach[key.removeprefix("reach_")] >= float(value))
            for key, value in data.items()
            if key.startswith("reach_")
        )
        return share == data["domain_share"] and bool(volume >= float(share)) and sizes
