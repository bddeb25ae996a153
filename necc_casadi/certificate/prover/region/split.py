"""Which states are minimised out: the fewest are kept for which V is strongly convex in the rest.

With Φ = H + Hc + C and Casimirs that are affine in e, V_ee = H_ee + N_eᵀ∇²K N_e + diag(0, ∇²Hc),
and matrices below ∇²K and ∇²Hc for all arguments give a floor F ≻ 0 for every e. H_ee and N_e may
depend on angles, over a whole period, and on s, over the box in question; never on e otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import MOST_KEPT, Bends
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.hessian_floor import sharpest_floor
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import holds_everywhere, written
from necc_casadi.certificate.prover.region.critical_box import is_periodic
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.model.samples import quasi_random
from necc_casadi.symbolic.smoothness import conditions

__all__ = ["Splits"]

#: Shares of the least of the matrices below V_ee that are tried for F, the largest first.
_SHARES = (1 - 1e-9, 0.999, 0.98, 0.9, 0.7, 0.4, 0.1)
#: Cells of the states on which V_ee depends, in all; half a period, a little more than π.
_CELLS, _HALF_PERIOD = 4096, 3.15
#: Points at which a split is looked at before cells are, and how far below 0 rounding may lead.
_POINTS, _ROUNDING = 64, 1e-9


@dataclass(frozen=True, eq=False)
class Splits:
    """Ways to split the active states into s and e."""

    potential: Potential

    @cached_property
    def symbols(self) -> list[sp.Symbol]:
        """The active states."""
        return [self.potential.design.loop.z[i] for i in self.potential.active]

    @cached_property
    def _hessian(self) -> sp.Matrix:
        return sp.hessian(self.potential.energy, self.symbols)

    @cached_property
    def _slopes(self) -> sp.Matrix:
        functions = self.potential.design.casimirs.functions
        return sp.Matrix([[sp.diff(c, s) for s in self.symbols] for c in functions])

    def bends_with(self, symbol: sp.Symbol) -> bool:
        """Whether ∇²H or ∇c depends on a state."""
        return bool(self._hessian.has(symbol) or self._slopes.has(symbol))

    @cached_property
    def _network_floors(
        self,
    ) -> tuple[tuple[Interval, float | None], tuple[Interval, float | None]]:
        """Matrices below ∇²Hc and ∇²K, and the bends on which they rest."""
        form = self.potential.design.form
        of_hc, of_k = form.split(self.potential.design.weights)[:2]
        return sharpest_floor(form.hc, of_hc), sharpest_floor(form.k, of_k)

    @property
    def bends(self) -> Bends:
        """Numbers below f″ of Hc and K on which the floors rest, where they do."""
        if self._is_mixed:
            return None, None
        (_, of_hc), (_, of_k) = self._network_floors
        return of_hc, of_k

    @property
    def _is_mixed(self) -> bool:
        """Whether V is other than a sum H + Hc + K(c), of which no floor is known."""
        form = self.potential.design.form
        return form.phi is not None or bool(form.betas)

    @cached_property
    def _periodic(self) -> set[sp.Symbol]:
        """States in which all of ∇²H and ∇c is periodic."""
        entries = [e for e in {*self._hessian, *self._slopes} if e.free_symbols]
        return {s for s in self.symbols if is_periodic([e for e in entries if e.has(s)], s)}

    def candidates(self, around: Interval) -> Iterator[Reduced]:
        """Splits with V_ee ≻ 0 for s in the box `around` (d,), the fewest kept states first.

        Those come first that keep all states in which the plant has a pole or a kink, where the
        search can see it, and all on which the inertia of a momentum with a bound depends: the
        bound is then met in a function of s alone. Among equals the widest margin is first, in the
        units of the box.
        """
        guarded, seen = self._guarded, self._guarded | self._carrying
        yield from self._splits(around, lambda kept: seen <= set(kept))
        yield from self._splits(around, lambda kept: guarded <= set(kept) and not seen <= set(kept))
        yield from self._splits(around, lambda kept: not guarded <= set(kept))

    @cached_property
    def _carrying(self) -> set[int]:
        """Active states on which the inertia depends, where the model bounds a momentum."""
        plant, resting = self.potential.design.loop.plant, self.potential.resting
        momenta = [self.potential.design.loop.z[i] for i in resting]
        if not any(str(p) in plant.domain for p in momenta):
            return set()
        inertia = sp.hessian(plant.H, momenta)
        return {i for i, s in enumerate(self.symbols) if inertia.has(s)}

    @cached_property
    def _guarded(self) -> set[int]:
        """Active states in which not everything is smooth for all values."""
        design = self.potential.design
        demands = conditions(written(design)) or ()
        met = {d: holds_everywhere(d, design.loop.z) for d in demands}
        return {
            i for i, s in enumerate(self.symbols) if any(d.part.has(s) for d in met if not met[d])
        }

    def _splits(
        self, around: Interval, may: Callable[[tuple[int, ...]], bool]
    ) -> Iterator[Reduced]:
        d, below = len(self.symbols), self._below_at_points(around)
        for size in range(d if self._is_mixed else 0, min(d, MOST_KEPT) + 1):
            found = []
            for kept in filter(may, combinations(range(d), size)):
                gone = [i for i in range(d) if i not in kept]
                plausible = _may_be_positive(below[:, gone][:, :, gone])
                reduced = self.split(kept, around) if plausible else None
                if reduced is not None:
                    sizes = (around.hi - around.lo)[list(reduced.gone)]
                    scaled = reduced.floor * np.outer(sizes, sizes)
                    margin = np.linalg.eigvalsh(scaled).min(initial=np.inf)
                    found.append((-float(margin), kept, reduced))
            for _, _, reduced in sorted(found, key=lambda entry: entry[:2]):
                yield reduced

    def _below_at_points(self, around: Interval) -> Vector:
        """What `below` encloses at points of the box, in floats, (P, d, d): most splits fail there.

        V_ee is their block of e, whatever is kept; a whole period is looked at where `below` does.
        """
        d = len(self.symbols)
        if self._is_mixed:
            return np.zeros((0, d, d))
        turns = np.array([s in self._periodic for s in self.symbols])
        lo = np.where(turns, -_HALF_PERIOD, around.lo)
        hi = np.where(turns, _HALF_PERIOD, around.hi)
        (Hc, _), (K, _) = self._network_floors
        with np.errstate(all="ignore"):
            at = point(lo + quasi_random(_POINTS, d, 0) * (hi - lo))
            slopes = matrix_enclosure(self._slopes, self.symbols, at).mid
            total = matrix_enclosure(self._hessian, self.symbols, at).mid
            total = total + np.swapaxes(slopes, 1, 2) @ K.mid @ slopes
        total[:, -Hc.shape[0] :, -Hc.shape[0] :] += Hc.mid
        return np.asarray(total[np.isfinite(total).all((1, 2))])

    def split(self, kept: Sequence[int], around: Interval) -> Reduced | None:
        """The split that keeps s; None where V_ee ⪰ F ≻ 0 is not proved."""
        gone = tuple(i for i in range(len(self.symbols)) if i not in kept)
        floor = self._floor(gone, tuple(kept), around)
        if floor is None:
            return None
        return Reduced(self.potential, tuple(kept), gone, floor)

    def _floor(
        self, gone: tuple[int, ...], kept: tuple[int, ...], around: Interval
    ) -> Vector | None:
        if not gone:
            return np.zeros((0, 0))
        below = self.below(gone, kept, around)
        if below is None:
            return None
        middle = (below.mid + np.swapaxes(below.mid, -1, -2)) / 2
        least = middle[int(np.argmin(np.linalg.eigvalsh(middle)[:, 0]))]
        values = np.linalg.eigvalsh(least)
        if not values[0] > 0:
            return None
        # that matrix itself where V_ee is constant or nearly so, else a multiple of the identity
        for guess in (least, values[0] * np.eye(len(gone))):
            for share in _SHARES:
                if positive_definite(below - share * guess).all():
                    return np.asarray(share * guess)
        return None

    def below(
        self, gone: tuple[int, ...], kept: tuple[int, ...], around: Interval
    ) -> Interval | None:
        """Matrices (B, de, de) below V_ee for every e and every s of the box, cell by cell."""
        e = [self.symbols[i] for i in gone]
        N, H = self._slopes[:, list(gone)], self._hessian.extract(list(gone), list(gone))
        if N.has(*e):
            return None
        used = sorted(H.free_symbols | N.free_symbols, key=str)
        cells = self._cells(used, kept, around)
        if cells is None:
            return None
        slopes = matrix_enclosure(N, used, cells)
        (Hc, _), (K, _) = self._network_floors
        turned = Interval(np.swapaxes(slopes.lo, -1, -2), np.swapaxes(slopes.hi, -1, -2))
        total = matrix_enclosure(H, used, cells) + matmul(turned, matmul(K, slopes))
        rows = [k for k, i in enumerate(gone) if i >= len(self.symbols) - Hc.shape[0]]
        of_xi = [gone[k] - len(self.symbols) + Hc.shape[0] for k in rows]
        lo, hi = (np.zeros((len(gone), len(gone))) for _ in range(2))
        lo[np.ix_(rows, rows)] = Hc.lo[np.ix_(of_xi, of_xi)]
        hi[np.ix_(rows, rows)] = Hc.hi[np.ix_(of_xi, of_xi)]
        return total + Interval(lo, hi)

    def _cells(
        self, used: Sequence[sp.Symbol], kept: tuple[int, ...], around: Interval
    ) -> Interval | None:
        """Cells of the states on which V_ee depends; None where one may be anything."""
        lo, hi = [], []
        for symbol in used:
            i = self.symbols.index(symbol)
            if symbol in self._periodic:
                ends = (-_HALF_PERIOD, _HALF_PERIOD)
            elif i in kept:
                ends = (float(around.lo[i]), float(around.hi[i]))
            else:
                return None
            lo.append(ends[0])
            hi.append(ends[1])
        parts = max(4, int(_CELLS ** (1 / max(1, len(used)))))
        return subdivide(Interval(np.array(lo), np.array(hi)), parts)


def _may_be_positive(matrices: Vector) -> bool:
    """Whether no matrix (B, de, de) certainly has a direction in which it is not positive."""
    if not matrices.size:
        return True
    values = np.linalg.eigvalsh((matrices + np.swapaxes(matrices, 1, 2)) / 2)
    return bool((values[:, 0] > -_ROUNDING * np.abs(values).max(1)).all())
