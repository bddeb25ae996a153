"""Boxes of states and periods on which a step of the sampled loop is proved, by halving.

On each box that meets {W ≤ w₀} is Π ≺ 0, for what limits leave of u too. By states alone: W > w₀ on
the sides of the whole, where W ≤ w₀ either ∇V ≠ 0 or ∇²V ≻ 0, in a core, and whether u is within
its limits. What is not proved lowers w₀.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.sampled import BEYOND, KEPT, SPLIT, packed_tree
from necc_casadi.certificate.prover.arithmetic.affine import negative_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.sampled.step import Step

__all__ = [
    "Cover",
    "Shown",
    "cover",
    "falls",
    "is_never_clipped",
    "level_by_states",
    "where_above",
    "within",
]


#: Boxes at once, and how often one is halved at most.
_BATCH, _DEEPEST = 512, 40
#: How close to its limit Π ≺ 0 may be, so that other arithmetic can confirm it.
_EASED = 0.8
#: Boxes after which one must have been proved: those near z̄ come first.
_HOPELESS = 4000


#: Whether what is to be shown of boxes (B, N), with ∇W on them, is, (B,).
Settled = Callable[[Interval, Interval], Truth]


@dataclass(frozen=True, eq=False)
class Shown:
    """What is shown of boxes, (B,) each."""

    proved: Truth
    rates: Vector | float = 0.0  # what changes faster there with states and period, (B, N + 1)
    ceiling: float = np.inf  # no level above it is ever proved


#: What is to be shown of boxes (B, N) and periods (B,).
Proof = Callable[[Interval, Interval], Shown]


@dataclass(frozen=True, eq=False)
class Cover:
    """What was proved."""

    level: float  # w₀, of W
    tree: str


@dataclass(eq=False)
class _Tree:
    """Boxes, the root first; `cut` is the side that was halved, `kind` of a leaf."""

    root: Interval
    lo: list[Vector] = field(default_factory=list)
    hi: list[Vector] = field(default_factory=list)
    node: list[int] = field(default_factory=list)
    below: list[tuple[int, int]] = field(default_factory=list)
    depth: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.add(self.root.lo, self.root.hi, 0)

    def add(self, lo: Vector, hi: Vector, depth: int) -> int:
        """A new box."""
        self.lo.append(lo)
        self.hi.append(hi)
        self.node.append(BEYOND)
        self.below.append((-1, -1))
        self.depth.append(depth)
        return len(self.node) - 1

    def split(self, i: int, side: int) -> tuple[int, int]:
        """Both halves of a box."""
        lo, hi = self.lo[i], self.hi[i]
        middle = lo[side] / 2 + hi[side] / 2
        left, right = hi.copy(), lo.copy()
        left[side], right[side] = middle, middle
        self.node[i] = SPLIT + side
        depth = self.depth[i] + 1
        self.below[i] = (self.add(lo, left, depth), self.add(right, hi, depth))
        return self.below[i]

    def packed(self) -> str:
        """The nodes, a box before its halves."""
        nodes, todo = bytearray(), [0]
        while todo:
            i = todo.pop()
            nodes.append(self.node[i])
            if self.node[i] >= SPLIT:
                todo += self.below[i][::-1]
        return packed_tree(bytes(nodes))


def cover(
    step: Step,
    Q: Vector,
    root: Interval,
    level: float,
    weights: Vector,
    most: int,
    least: float,
    proof: Proof | None = None,
) -> Cover:
    """Boxes that prove {W < w₀} for the largest w₀ ≤ `level` that was found, −∞ where none was.

    Parameters
    ----------
    root
        The box of states and periods, (N + 1,).
    weights
        How fast Π changes with states and period, (N + 1,).
    most
        Boxes that may be looked at.
    least
        Levels below this one are of no use.
    proof
        What is to be shown of boxes; by default that W falls.
    """
    tree, done, kept = _Tree(root), 0, False
    heap: list[tuple[float, int]] = [(-np.inf, 0)]
    proof = proof or falls(step, Q)
    while heap and heap[0][0] <= level and level > least:
        taken: list[int] = []
        bounds: list[float] = []
        while heap and len(taken) < _BATCH and heap[0][0] <= level:
            bound, i = heapq.heappop(heap)
            taken.append(i)
            bounds.append(bound)
        done += len(taken)
        if done > (most if kept else _HOPELESS):
            level = min(level, *bounds)
            break
        cells = Interval(
            np.array([tree.lo[i] for i in taken]), np.array([tree.hi[i] for i in taken])
        )
        Z, s = cells[:, :-1], cells[:, -1]
        lowest, _ = _lower_bounds(step.potential, Q, Z)
        lowest = np.maximum(lowest, bounds)
        rates = np.tile(weights, (len(taken), 1))
        proved = np.zeros(len(taken), dtype=bool)
        reached = np.flatnonzero(lowest <= level)
        if len(reached):
            shown = proof(Z[reached], s[reached])
            proved[reached] = shown.proved
            rates[reached] += shown.rates
            level = min(level, shown.ceiling)
        for k, i in enumerate(taken):
            if lowest[k] > level or proved[k]:
                tree.node[i] = BEYOND if lowest[k] > level else KEPT
                kept = kept or bool(proved[k])
                continue
            side = int(np.argmax((tree.hi[i] - tree.lo[i]) * rates[k]))
            if tree.depth[i] >= _DEEPEST:
                level = min(level, float(lowest[k]))
                continue
            for j in tree.split(i, side):
                heapq.heappush(heap, (float(lowest[k]), j))
    return Cover(level, tree.packed())


def falls(step: Step, Q: Vector, clipping: Vector | None = None) -> Proof:
    """Whether W falls.

    `clipping` is how fast Π changes with states and period where u is limited, (channels, N + 1).
    """

    def proof(Z: Interval, s: Interval) -> Shown:
        sample = step.over(Z, s)
        open_ = ~(sample.shares.lo == 1)
        lost = Z[np.isnan(sample.shares.lo).any(-1)]
        return Shown(
            negative_definite(sample.form(Q), _EASED),
            0.0 if clipping is None else open_[:, : len(clipping)] @ clipping,
            _beyond_limits(step, Q, lost) if len(lost.lo) else np.inf,
        )

    return proof


def _beyond_limits(step: Step, Q: Vector, Z: Interval) -> float:
    """An upper bound of the least W in the middle of boxes (B, N) where −y_c is beyond limits."""
    middle = point(Z.mid)
    jet = step.potential.jet(middle)
    W = jet.value + _square(point(Q[None]), jet.grad) * 0.5
    lost = ~step.is_covered(middle, jet.grad)
    return float(W.hi[lost].min(initial=np.inf))


def level_by_states(
    potential: Potential,
    Q: Vector,
    box: Interval,
    core: Interval,
    level: float,
    most: int,
    least: float,
) -> float:
    """The largest w₀ ≤ `level` found for what states alone say; `least` or less where none was.

    W > w₀ on the sides of a box (N,), and z̄ the only zero of ∇V in {W ≤ w₀} there: ∇²V ≻ 0 on the
    core.
    """
    for side in _sides(box):
        level = where_above(potential, Q, side, level, most, least, _steep_within(side))

    def settled(Z: Interval, slope: Interval) -> Truth:
        return _inside(Z, core) | _apart(potential.jet(Z).grad)

    return where_above(potential, Q, box, level, most, least, settled)


def is_never_clipped(step: Step, Q: Vector, box: Interval, level: float, most: int) -> bool:
    """Whether u is found to be within its limits, or has none, where W ≤ w₀ in a box (N,)."""
    limits = step.potential.design.loop.plant.u_limits

    def settled(Z: Interval, slope: Interval) -> Truth:
        return within(step.inputs(Z, step.potential.jet(Z).grad), limits)

    if limits is None:
        return True
    return where_above(step.potential, Q, box, level, most, -np.inf, settled) >= level


def _steep_within(side: Interval) -> Settled:
    """Where W is not least on a side, as it falls along the side in some direction."""

    def settled(Z: Interval, slope: Interval) -> Truth:
        within = side.hi > side.lo
        falls = ((slope.lo > 0) & (Z.lo > side.lo)) | ((slope.hi < 0) & (Z.hi < side.hi))
        return np.asarray((falls & within).any(-1))

    return settled


def where_above(
    potential: Potential,
    Q: Vector,
    box: Interval,
    level: float,
    most: int,
    least: float,
    settled: Settled,
) -> float:
    """The largest level up to the one given below which nothing on a box (N,) is left open."""
    cells = [(box.lo, box.hi)]
    heap = [(-np.inf, 0)]
    while heap and heap[0][0] <= level and level > least:
        if len(cells) > most:
            return heap[0][0]
        taken = [heapq.heappop(heap) for _ in range(min(_BATCH, len(heap)))]
        Z = Interval(*(np.array(v) for v in zip(*(cells[k] for _, k in taken), strict=True)))
        lowest, slope = _lower_bounds(potential, Q, Z)
        loose = np.where(np.isfinite(slope.rad), slope.rad, 1.0) * (Z.hi - Z.lo)
        left_open = (lowest <= level) & ~settled(Z, slope)
        for (bound, k), low, share, left in zip(taken, lowest, loose, left_open, strict=True):
            if not left:
                continue
            lo, hi = cells[k]
            side = int(np.argmax(share))
            middle = lo[side] / 2 + hi[side] / 2
            first, last = hi.copy(), lo.copy()
            first[side], last[side] = middle, middle
            for half in ((lo, first), (last, hi)):
                cells.append(half)
                heapq.heappush(heap, (max(bound, float(low)), len(cells) - 1))
    return level


def _sides(box: Interval) -> list[Interval]:
    """The sides of a box (N,)."""
    result = []
    for k in range(len(box.lo)):
        for end in (box.lo[k], box.hi[k]):
            lo, hi = box.lo.copy(), box.hi.copy()
            lo[k] = hi[k] = end
            result.append(Interval(lo, hi))
    return result


def _lower_bounds(potential: Potential, Q: Vector, Z: Interval) -> tuple[Vector, Interval]:
    """Lower bounds of W over boxes (B, N), by its mean-value form, (B,), and ∇W; −∞: unknown."""
    with np.errstate(all="ignore"):
        jet, middle = potential.jet(Z), potential.jet(point(Z.mid))
        metric = point(Q[None])
        value = middle.value + _square(metric, middle.grad) * 0.5
        turned = matmul(metric, jet.grad[..., None])
        slope = jet.grad + matmul(jet.hess, turned)[..., 0]
        form = value + (slope * (Z - Z.mid)).sum()
        plain = jet.value + _square(metric, jet.grad) * 0.5
        best = np.fmax(form.lo, plain.lo)
    return np.where(np.isnan(best), -np.inf, best), slope


def _square(metric: Interval, g: Interval) -> Interval:
    return (matmul(metric, g[..., None])[..., 0] * g).sum()


def within(u: Interval, limits: Sequence[Sequence[float]] | None) -> Truth:
    """Whether u is within the limits, where there are any."""
    if limits is None:
        return np.ones(u.shape[0], dtype=bool)
    lo, hi = np.array(limits, float).T
    return np.asarray(((u.lo >= lo) & (u.hi <= hi)).all(-1))


def _apart(gradient: Interval) -> Truth:
    """Whether ∇V ≠ 0."""
    return np.asarray(((gradient.lo > 0) | (gradient.hi < 0)).any(-1))


def _inside(Z: Interval, core: Interval) -> Truth:
    return np.asarray(((core.lo <= Z.lo) & (Z.hi <= core.hi)).all(-1))
