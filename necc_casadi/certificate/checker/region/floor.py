"""V_ee ⪰ F ≻ 0 for every e, by matrices below ∇²K and ∇²Hc for all arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.hessian_floor import curvature_above, hessian_floor
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.claims.regions import Bends
from necc_casadi.symbolic.zero import is_zero

__all__ = ["FloorProof", "evaluated", "is_periodic", "network_floor"]

#: Half a period, a little more than π; how often a box of angles, and one of s and e, may be
#: halved.
_HALF_PERIOD, _ANGLES, _TUBE = 3.15, 14, 24


class FloorProof:
    """V_ee ⪰ F for every e, and for every s of a box: by matrices below ∇²K and ∇²Hc."""

    def __init__(
        self, energy: Energy, kept: Sequence[int], floor: Sequence[Sequence[float]], bends: Bends
    ) -> None:
        self.energy, self.kept, self.bends = energy, list(kept), bends
        self.gone = [i for i in range(energy.d) if i not in self.kept]
        self.F = arb_mat([list(row) for row in floor]) if self.gone else None

    def holds(self, box: Box) -> bool:
        """Whether F is below V_ee for s in the box (ds,), every e."""
        model, e = self.energy.model, [self.energy.variables[i] for i in self.gone]
        F = self.F
        if F is None:
            return True
        if model.form["phi"] is not None or model.form["betas"]:
            return False
        at_rest = {s: 0 for i, s in enumerate(model.z) if i not in self.energy.active}
        H = sp.hessian(model.H.subs(at_rest), e)
        N = sp.Matrix([[sp.diff(c, v) for v in e] for c in model.casimirs])
        if N.has(*e):
            return False
        below_hc = network_floor(self.energy.hc, model.form["hc"], self.bends[0])
        K = network_floor(self.energy.k, model.form["k"], self.bends[1])
        if below_hc is None or K is None:
            return False
        below = self._of_controller(below_hc)
        used = sorted(H.free_symbols | N.free_symbols, key=str)
        cells = self._ranges(used, [*H, *N], box)
        if cells is None:
            return False

        def above(cell: Box) -> bool:
            values = {v: ball(*side) for v, side in zip(used, cell, strict=True)}
            slopes, rest = (evaluated(M, values) for M in (N, H))
            return positive(slopes.transpose() * K * slopes + rest + below - F, 0)

        return by_bisection(cells, above, _ANGLES)

    def holds_on(self, box: Box, tube: Box) -> bool:
        """Whether F is below V_ee for s in the box (ds,) and e in the tube (de,)."""
        F = self.F
        if F is None:
            return False
        both: list[tuple[float, float]] = [(0.0, 0.0)] * self.energy.d
        for places, sides in ((self.kept, box), (self.gone, tube)):
            for i, side in zip(places, sides, strict=True):
                both[i] = side

        def above(piece: Box) -> bool:
            H = self.energy.hessian(piece)
            below = arb_mat([[H[i, j] for j in self.gone] for i in self.gone])
            return positive(below - F, 0)

        return by_bisection(tuple(both), above, _TUBE)

    def _of_controller(self, Hc: arb_mat) -> arb_mat:
        """What ∇²Hc adds to V_ee at least."""
        first, size = self.energy.d - self.energy.model.nc, len(self.gone)
        total = arb_mat(size, size)
        for a, i in enumerate(self.gone):
            for b, j in enumerate(self.gone):
                if i >= first and j >= first:
                    total[a, b] = Hc[i - first, j - first]
        return total

    def _ranges(self, used: Sequence[sp.Symbol], entries: list[sp.Expr], box: Box) -> Box | None:
        """A period of each angle, the box of the other kept states; None for anything else."""
        sides = []
        for symbol in used:
            i = self.energy.variables.index(symbol)
            if all(is_periodic(entry, symbol) for entry in entries if entry.has(symbol)):
                sides.append((-_HALF_PERIOD, _HALF_PERIOD))
            elif i in self.kept:
                sides.append(box[self.kept.index(i)])
            else:
                return None
        return tuple(sides)


def is_periodic(entry: sp.Expr, symbol: sp.Symbol) -> bool:
    """Whether an expression is proved to repeat after 2π in a symbol that stands in sin and cos."""
    inside = [f for f in entry.atoms(sp.Function) if f.has(symbol)]
    plain = all(isinstance(f, (sp.sin, sp.cos)) for f in inside)
    return plain and is_zero(entry.subs(symbol, symbol + 2 * sp.pi) - entry) is True


def network_floor(net: Net, shape: Mapping[str, Any], bend: float | None) -> arb_mat | None:
    """A matrix ⪯ ∇²f of a network for all arguments; None where a claimed bend is not proved."""
    if bend is None:
        return hessian_floor(net, shape["activation"])
    scalar = shape["activation"] == "tanh" and net.d == 1 and len(shape["hidden"]) > 0
    if not (scalar and curvature_above(net, bend)):
        return None
    floor = net.quadratic_curvature()
    floor[0, 0] = floor[0, 0] + bend
    return floor


def evaluated(matrix: sp.Matrix, values: dict[sp.Symbol, arb]) -> arb_mat:
    """A matrix of expressions with balls for its symbols."""
    return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])
