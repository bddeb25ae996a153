"""A box E of e over which V is convex, where it is not for every e: plain, deep and mixed networks.

V_ee ⪰ F over the cells of s and E, V > c on the sides of E and w > c around the cells, w the least
of V(s, ·) over E: {V ≤ c} over the cells and E is then open and closed in {V ≤ c}. Its critical
points have V_e = 0, so e = ε(s); where w has one, z̄, it is the component with z̄
(docs/theory.md#convex-near-the-minimum-only).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import MOST_KEPT
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate
from necc_casadi.certificate.prover.region.obstacle import Search
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.model.samples import quasi_random

__all__ = ["bent_split", "convex_over", "tube_around"]

#: How much wider than a parabola's the fibres are taken to be.
_WIDER = 1.15
#: Shares of the least V_ee at samples, relative to that at z̄, that are tried for F.
_SHARES = (0.6, 0.25)
#: Samples of the box; cells at most, and how many are looked at once.
_SAMPLES, _MOST, _ROWS = 1024, 4_000, 512


def bent_split(splits: Splits, around: Interval) -> Reduced | None:
    """The split that keeps the states on which ∇²H and ∇c depend, of which no floor is known.

    Where they are more than a region may keep: the fewest of them that leave V convex in the rest
    at samples of the box `around` (d,), as it is where H is, though not for all values.
    """
    symbols = splits.symbols
    bent = tuple(i for i, s in enumerate(symbols) if splits.bends_with(s))
    kept = bent if len(bent) <= MOST_KEPT else _fewest_kept(splits, bent, around)
    if kept is None or len(kept) == len(symbols):
        return None
    gone = tuple(i for i in range(len(symbols)) if i not in kept)
    return Reduced(splits.potential, kept, gone, np.eye(len(gone)))


def _fewest_kept(splits: Splits, bent: tuple[int, ...], around: Interval) -> tuple[int, ...] | None:
    """States that leave V convex in the others at samples of a box; None: no few do."""
    whole = Reduced(splits.potential, (), tuple(range(len(around.lo))), np.eye(len(around.lo)))
    Y = around.lo + quasi_random(_SAMPLES, len(around.lo), 0) * (around.hi - around.lo)
    hess = whole.landscape.jets(Y)[2]
    for size in range(MOST_KEPT + 1):
        for kept in combinations(bent, size):
            gone = [i for i in range(len(around.lo)) if i not in kept]
            V_ee = hess[:, gone][:, :, gone]
            if np.isfinite(V_ee).all() and np.linalg.eigvalsh(V_ee)[:, 0].min() > 0:
                return kept
    return None


def tube_around(reduced: Reduced, found: Search, level: float) -> Interval | None:
    """A box (de,) that is to hold the fibres of {V ≤ c} over the nodes below a level."""
    inside = found.levels <= level
    minima, gone = found.minima, list(reduced.gone)
    e = minima.e[inside]
    if not (inside.any() and np.isfinite(e).all()):
        return None
    hess = reduced.landscape.jets(reduced.landscape.joined(found.nodes[inside], e))[2]
    V_ee = hess[:, gone][:, :, gone]
    if not np.linalg.eigvalsh(V_ee)[:, 0].min(initial=np.inf) > 0:
        return None
    widths = np.diagonal(np.linalg.inv(V_ee), axis1=1, axis2=2)
    half = np.sqrt(2 * np.maximum(level - minima.w[inside], 0.0)[:, None] * widths)
    step = np.abs(minima.tangent[inside]) @ found.step if len(found.lo) else np.zeros_like(e)
    half = _WIDER * half + step
    return Interval((e - half).min(0), (e + half).max(0))


def convex_over(reduced: Reduced, s: Interval, tube: Interval, y_bar: Vector) -> Vector | None:
    """F (de, de) ≻ 0 with V_ee ⪰ F for s (ds,) and e (de,) in these boxes; None: none was found."""
    d, kept, gone = len(y_bar), list(reduced.kept), list(reduced.gone)
    lo, hi = np.empty(d), np.empty(d)
    lo[kept], hi[kept], lo[gone], hi[gone] = s.lo, s.hi, tube.lo, tube.hi
    Y = np.concatenate([y_bar[None], lo + quasi_random(_SAMPLES, d, 0) * (hi - lo)])
    V_ee = reduced.landscape.jets(Y)[2][:, gone][:, :, gone]
    if not np.isfinite(V_ee).all() or np.linalg.eigvalsh(V_ee[0])[0] <= 0:
        return None
    factor = np.linalg.inv(np.linalg.cholesky(V_ee[0]))
    least = float(np.linalg.eigvalsh(factor @ V_ee @ factor.T).min())
    if not least > 0:
        return None
    for share in _SHARES:
        F = share * least * V_ee[0]
        F = (F + F.T) / 2
        if _is_below(reduced, F, Interval(lo, hi)):
            return np.asarray(F, float)
    return None


def _is_below(reduced: Reduced, F: Vector, box: Interval) -> bool:
    """Whether V_ee ⪰ F on a box (d,), by halves of its pieces."""
    gone, potential = list(reduced.gone), reduced.potential
    size, cells, tried = box.hi - box.lo, box[None], 0
    while cells.shape[0]:
        now, later = cells[:_ROWS], cells[_ROWS:]
        tried += now.shape[0]
        below = potential.lower_hessian(now)[:, gone][:, :, gone]
        left = now[np.flatnonzero(~positive_definite(below - F))]
        if tried + 2 * left.shape[0] + later.shape[0] > _MOST:
            return False
        axis = np.argmax((left.hi - left.lo) / size, axis=1)
        rows = np.arange(left.shape[0])
        lo, hi, middle = left.lo.copy(), left.hi.copy(), left.mid[rows, axis]
        lo[rows, axis] = hi[rows, axis] = middle
        cells = concatenate(concatenate(Interval(left.lo, hi), Interval(lo, left.hi)), later)
    return True
