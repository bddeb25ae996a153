"""What is asked of V over the domain, beside the conditions at z*: the shape of a training run.

With ΔV(z) = V(z) − V(z*) and samples zᵢ of the domain, momenta at rest (there V is ΔV plus their
kinetic energy, whatever the networks do), all in natural units:

*regulariser*: the published one (Remark on the region of attraction) with V's free offset removed
and ReLU smoothed,

    ReLU((1/N) Σ ‖zᵢ − z*‖² − γ ΔV(zᵢ)),    ReLU(v) ≈ (v + √(v² + δ²))/2.

As published, with V(zᵢ) in place of ΔV(zᵢ), an offset of V would minimise it.

*level*: the part of the domain below a level c that no boundary point lies below,

    min  (1/N) Σ σ((ΔV(zᵢ) − c)/τ) + (w/N) Σ ReLU(η − ∇V(yᵢ)ᵀ(yᵢ − z*)/‖yᵢ − z*‖²)
    subject to  ΔV(bⱼ) ≥ c at samples bⱼ of the boundary,  c ≤ the momenta's ceiling,

σ(v) = (1 + v/√(1 + v²))/2. The second sum, over samples yᵢ that crowd around z*, makes V grow
along rays from z*, so that no other critical point lies below c. A certificate, not these samples, says what was reached.

Shaped networks keep their hidden layers at their random initialisation: V is then affine in what
moves, and the Hessian of both objectives is exact at the price of one product AᵀDA.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.lyapunov import Form, Terms, value
from necc_casadi.networks import Network, Vector

__all__ = ["SHAPES", "Box", "Shaping", "make_shaping", "moving_weights", "quasi_random"]

#: What can be asked for; "none" leaves V to the conditions at z*.
SHAPES = ("none", "regulariser", "level")

#: δ of the smooth ReLU of the regulariser; its argument is of order one.
_SMOOTHING = 0.1
#: τ, as a share of the largest level.
_SHARPNESS = 0.05
#: η, δ and w: least growth along rays in natural units, and what falling short of it costs.
_GROWTH, _GROWTH_SMOOTHING, _GROWTH_COST = 0.1, 0.02, 10.0
#: Growth is sampled from this share of the way to the boundary on.
_NEAREST = 0.05
#: Weight beside the other terms of the objective, which then only select among equal shapes.
_WEIGHT = {"regulariser": 100.0, "level": 1000.0}
#: Samples inside, and of the boundary for every dimension beyond the first.
_INNER, _BOUNDARY, _MOST_BOUNDARY = 256, 128, 384
_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)


@dataclass(frozen=True, eq=False)
class Box:
    """The part of the domain that is sampled, seen from z*."""

    lo: Vector  # (n + nc,) domain − z*
    hi: Vector  # (n + nc,)
    active: tuple[int, ...]  # the states that are sampled; the others rest
    ceiling: float  # V − V(z*) below which the resting states stay in the domain; may be ∞


@dataclass(frozen=True, eq=False)
class Shaping:
    """Samples and objective, as elementwise functions of rows u = A m + b in moving weights m.

    The rows are, for the regulariser, the mean of ‖zᵢ − z*‖² − γ ΔV(zᵢ); for the level ΔV(zᵢ),
    then the growth ∇V(yᵢ)ᵀ(yᵢ − z*)/‖yᵢ − z*‖², then ΔV(bⱼ). Energies and lengths are in natural units.
    """

    kind: str  # "regulariser" or "level"
    inner: Vector  # (N, n + nc) zᵢ − z*
    rays: Vector  # (N, n + nc) yᵢ − z*
    boundary: Vector  # (B, n + nc) bⱼ − z*
    size: Vector  # (n + nc,) natural size of each state
    energy: float  # natural size of V
    ceiling: float  # largest level, in natural units
    gamma: float = 1.0

    @property
    def has_level(self) -> bool:
        """Whether the level c is a decision variable."""
        return self.kind == "level"

    @property
    def count(self) -> int:
        """Number of rows u."""
        return 2 * len(self.inner) + len(self.boundary) if self.has_level else 1

    def _squares(self, offsets: Vector) -> Vector:
        """‖z − z*‖² in natural units, one per row of `offsets`."""
        return np.asarray(((offsets / self.size) ** 2).sum(1))

    def rows(
        self, terms: Terms, form: Form, weights: Vector, z_star: Vector
    ) -> tuple[Vector, Vector]:
        """(A, b) with u = A m + b for every m, the other weights fixed: (count, moving), (count,)."""
        moving = moving_weights(form)

        def at(offsets: Vector) -> tuple[Vector, Vector]:
            """ΔV and ∇Vᵀ(z − z*) at samples in natural units, (2, S); by the weights, (2, S, m)."""
            row = _row(terms, form, moving).map(len(offsets))
            both = [np.repeat(v[:, None], len(offsets), axis=1) for v in (weights, z_star)]
            u, slopes = (np.asarray(v, float) / self.energy for v in row(*both, offsets.T))
            return u, slopes.reshape(2, len(offsets), moving.size)

        u, A = at(self.inner)
        if not self.has_level:
            A = -self.gamma * A[0].mean(0, keepdims=True)
            u = np.array([np.mean(self._squares(self.inner) - self.gamma * u[0])])
            return A, u - A @ weights[moving]
        grow, grow_A = at(self.rays)
        edge, edge_A = at(self.boundary)
        square = self._squares(self.rays)
        A = np.concatenate([A[0], grow_A[1] / square[:, None], edge_A[0]])
        u = np.concatenate([u[0], grow[1] / square, edge[0]])
        return A, u - A @ weights[moving]

    def objective(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """The weighted objective, a sum of functions of (uᵢ, c)."""
        if not self.has_level:
            return _WEIGHT[self.kind] * _relu(u, _SMOOTHING)
        N = len(self.inner)
        outside = (u[:N] - c) / (_SHARPNESS * self.ceiling)
        share = ca.sum1(1 + outside / ca.sqrt(1 + outside**2)) / (2 * N)
        short = _relu(_GROWTH - u[N : 2 * N], _GROWTH_SMOOTHING)
        return _WEIGHT[self.kind] * (share + _GROWTH_COST / N * ca.sum1(short))

    def margins(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """What must not be negative."""
        if not self.has_level:
            return ca.SX(0, 1)
        return ca.vertcat(self.ceiling - c, u[2 * len(self.inner) :] - c)

    def first_level(self, u: Vector) -> Vector:
        """Where c starts: (1,), or nothing."""
        if not self.has_level:
            return np.zeros(0)
        return np.array([0.9 * min(self.ceiling, float(u[2 * len(self.inner) :].min()))])


def make_shaping(
    kind: str, box: Box, size: Vector, energy: float, gamma: float, seed: int
) -> Shaping:
    """Samples of the box and of its boundary, the same for the same seed."""
    d = len(box.active)
    N = _INNER * max(1, d - 1)
    inner = quasi_random(N, d + 1, seed)
    inner, depth = inner[:, :d], inner[:, d:]
    faces = [(axis, side) for axis in range(d) for side in (0.0, 1.0)]
    total = min(_BOUNDARY * max(1, d - 1), _MOST_BOUNDARY)
    each = max(1, total // len(faces)) if d > 1 else 1
    boundary = [
        np.insert(quasi_random(each, d - 1, seed + 1 + k), axis, side, axis=1)
        for k, (axis, side) in enumerate(faces)
    ]
    ceiling = box.ceiling / energy
    return Shaping(
        kind=kind,
        inner=_offsets(box, inner),
        rays=_offsets(box, inner) * (_NEAREST + (1 - _NEAREST) * depth),
        boundary=_offsets(box, np.concatenate(boundary)),
        size=size,
        energy=energy,
        ceiling=ceiling if np.isfinite(ceiling) else 2.0,
        gamma=gamma,
    )


def _offsets(box: Box, shares: Vector) -> Vector:
    """Points of the box given by shares of its sides, (points, n + nc)."""
    active = list(box.active)
    result = np.zeros((len(shares), len(box.lo)))
    result[:, active] = box.lo[active] + shares * (box.hi - box.lo)[active]
    return result


def quasi_random(count: int, d: int, seed: int) -> Vector:
    """Halton points of the unit cube, shifted modulo one by a random vector, (count, d).

    Beyond the twelfth axis, where Halton points line up, the points are random.
    """
    rng = np.random.default_rng(seed)
    shift = rng.uniform(size=d)
    indices = np.arange(1, count + 1)
    points = rng.uniform(size=(count, d))
    for axis, prime in zip(range(d), _PRIMES, strict=False):
        points[:, axis] = (_radical_inverse(indices, prime) + shift[axis]) % 1.0
    return points


def _radical_inverse(indices: npt.NDArray[np.int_], base: int) -> Vector:
    """The digits of the indices mirrored at the point."""
    result, place, rest = np.zeros(len(indices)), 1.0 / base, indices.copy()
    while rest.any():
        result += place * (rest % base)
        rest //= base
        place /= base
    return result


def moving_weights(form: Form) -> npt.NDArray[np.int_]:
    """Indices of the weights in which V is affine: output layers and κ."""
    result, at = [], 0
    for network in (form.hc, form.k):
        result.append(at + _affine_weights(network))
        at += network.size
    return np.concatenate(result)


def _affine_weights(network: Network) -> npt.NDArray[np.int_]:
    rows, columns = network.shapes[-1]
    d = network.inputs if network.quadratic else 0
    end = network.size - 2 * d
    return np.r_[end - rows * columns - rows : end, end : end + d]


def _row(terms: Terms, form: Form, moving: Sequence[int]) -> ca.Function:
    """(weights, z*, offset) -> (ΔV, ∇Vᵀ offset) as (2, 1), and its Jacobian in the moving weights."""
    w, z_star, o = (
        ca.MX.sym("w", form.size),
        ca.MX.sym("z_star", terms.n + terms.nc),
        ca.MX.sym("o", terms.n + terms.nc),
    )
    z = ca.MX.sym("z", terms.n + terms.nc)
    V = value(terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))
    level = ca.Function("V", [w, z], [V, ca.gradient(V, z)])
    here, slope = level(w, z_star + o)
    both = ca.vertcat(here - level(w, z_star)[0], ca.dot(slope, o))
    plain = ca.Function("both", [w, z_star, o], [both]).expand()
    ws, zs, os = (ca.SX.sym(s.name(), s.numel()) for s in (w, z_star, o))
    u = plain(ws, zs, os)
    return ca.Function("row", [ws, zs, os], [u, ca.densify(ca.jacobian(u, ws)[:, list(moving)])])


def _relu(v: ca.SX, scale: float) -> ca.SX:
    """max(v, 0), smooth over about `scale`: at most scale/2 above it."""
    return (v + ca.sqrt(v * v + scale**2)) / 2
