"""What is asked of V over the domain, beside the conditions at z*: the shape of a training run.

With ΔV(z) = V(z) − V(z*) and samples zᵢ of the domain, all in natural units and with momenta at
rest, which add their kinetic energy to V whatever the networks do:

*regulariser*: the published one (Remark on the region of attraction) with V's free offset removed
and ReLU smoothed,

    ReLU((1/N) Σ ‖zᵢ − z*‖² − γ ΔV(zᵢ)),    ReLU(v) ≈ (v + √(v² + δ²))/2.

As published, with V(zᵢ) in place of ΔV(zᵢ), an offset of V would minimise it
(docs/theory.md#regulariser-without-offset).

*level*: the part of the domain below a level c that no boundary point lies below,

    min  (1/N) Σ σ((ΔV(zᵢ) − c)/τ) + (w/N) Σ [ReLU(η − gᵢ) + ReLU(η − kᵢ)]
    subject to  ΔV(bⱼ) ≥ c at samples bⱼ of the boundary,  c ≤ the momenta's ceiling,

σ(v) = (1 + v/√(1 + v²))/2. The growth gᵢ = ∇V(yᵢ)ᵀ(yᵢ − z*)/‖yᵢ − z*‖² keeps other critical points
out, at samples yᵢ that crowd around z*; the curvature kᵢ = dᵢᵀ∇²V(yᵢ)dᵢ in unit directions dᵢ, at
samples yet closer, keeps V convex around z*, where a certificate must tell z̄ from other points.
A certificate, not these samples, says what was reached.

Shaped networks keep their hidden layers at their random initialisation: V is then affine in what
moves, and the Hessian of both objectives is exact at the price of one product AᵀDA.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import Terms, value
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.samples import quasi_random
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.options import Level, Regulariser
from necc_casadi.synthesis.sample_box import SampleBox

__all__ = [
    "AffineRows",
    "Shaping",
    "make_shaping",
    "moving_weights",
    "sharper",
]


_Symbols = TypeVar("_Symbols", ca.MX, ca.SX)


#: δ of the smooth ReLU of the regulariser; its argument is of order one.
_SMOOTHING = 0.1


#: τ, as a share of the largest level.
_SHARPNESS = 0.05


#: η, δ and w: least growth along rays in natural units, and what falling short of it costs.
_GROWTH, _GROWTH_SMOOTHING, _GROWTH_COST = 0.2, 0.1, 10.0


_CURVATURE_COST = 3.0


#: η is no more than this share of the curvature asked for at z*.
_BELOW_A = 0.4


#: Growth is sampled from this share of the way to the boundary on.
_NEAREST = 0.05


#: Curvature is sampled up to this share of the way: in two states, and in more, where the cells
#: on which a certificate tells z̄ from its surroundings are larger.
_CONVEX, _CONVEX_IN_MORE = 0.2, 0.35


#: V where the model is not defined, in natural units: far above every level.
_AT_A_POLE = 1e3


#: Up to this many weights samples are evaluated in scalar operations, which are faster.
_SCALAR_WEIGHTS = 10_000


#: Entries of a sample's row: ΔV, ∇Vᵀd, dᵀ∇²V d.
_VALUE, _SLOPE, _CURVATURE = range(3)


#: Weight beside the other terms of the objective, which then only select among equal shapes.
_REGULARISER_WEIGHT, _LEVEL_WEIGHT = 100.0, 5000.0


#: The largest level in units of energy, as for a momentum at twice its natural size.
_HIGHEST = 2.0


#: Hidden weights start this much larger than those of unshaped networks.
_DETAIL = 1.5


#: Samples inside, and of the boundary.
_INNER, _BOUNDARY = 256, 128


#: Samples are chosen among this many times as many, where V can be below the largest level at all.
_CANDIDATES = 8


@dataclass(frozen=True, eq=False)
class Shaping:
    """Samples and objective, as elementwise functions of rows u = A m + b in moving weights m.

    The rows are, for the regulariser, the mean of ‖zᵢ − z*‖² − γ ΔV(zᵢ); for the level ΔV(zᵢ), then
    growth, then curvature, then ΔV(bⱼ). Energies and lengths are in natural units.
    """

    asked: Regulariser | Level
    inner: Vector  # (N, n + nc) zᵢ − z*
    rays: Vector  # (N, n + nc) yᵢ − z* for the growth
    near: Vector  # (N, n + nc) yᵢ − z* for the curvature
    directions: Vector  # (N, n + nc) dᵢ, unit vectors in natural units
    boundary: Vector  # (B, n + nc) bⱼ − z*
    size: Vector  # (n + nc,) natural size of each state
    energy: float  # natural size of V
    growth: float = _GROWTH  # η

    @property
    def has_level(self) -> bool:
        """Whether the level c is a decision variable."""
        return isinstance(self.asked, Level)

    @property
    def count(self) -> int:
        """Number of rows u."""
        return self._inside + len(self.boundary) if self.has_level else 1

    @property
    def _inside(self) -> int:
        return len(self.inner) + len(self.rays) + len(self.near)

    def rows(
        self, terms: Terms, form: Form, weights: Vector, z_star: Vector
    ) -> tuple[Vector, Vector]:
        """(A, b) with u = A m + b, other weights fixed: (count, moving) and (count,)."""
        moving = moving_weights(form)
        row = _row(terms, form, moving)

        def at(kind: int, offsets: Vector, directions: Vector) -> tuple[Vector, Vector]:
            """One entry of `row` in natural units, (S,), and its slopes, (S, moving)."""
            S = len(offsets)
            both = [np.repeat(v[:, None], S, axis=1) for v in (weights, z_star)]
            values, slopes = row.map(S).call([*both, offsets.T, directions.T])
            u = np.asarray(values, float)[kind] / self.energy
            A = np.asarray(slopes, float).reshape(3, S, moving.size)[kind] / self.energy
            poles = ~(np.isfinite(u) & np.isfinite(A).all(axis=1))
            u[poles], A[poles] = _AT_A_POLE, 0.0
            return u, A

        squares = [((o / self.size) ** 2).sum(1) for o in (self.inner, self.rays)]
        parts = [at(_VALUE, self.inner, self.inner)]
        if isinstance(self.asked, Regulariser):
            (u, A), gamma = parts[0], self.asked.gamma
            defined = u != _AT_A_POLE
            mean = np.array([np.mean((squares[0] - gamma * u)[defined])])
            slope = -gamma * A[defined].mean(0, keepdims=True)
            return slope, mean - slope @ weights[moving]
        parts.append(at(_SLOPE, self.rays, self.rays / squares[1][:, None]))
        parts.append(at(_CURVATURE, self.near, self.directions))
        parts.append(at(_VALUE, self.boundary, self.boundary))
        A = np.concatenate([slopes for _, slopes in parts])
        return A, np.concatenate([u for u, _ in parts]) - A @ weights[moving]

    def objective(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """The weighted objective, a sum of functions of (uᵢ, c)."""
        if not self.has_level:
            return _REGULARISER_WEIGHT * _relu(u, _SMOOTHING)
        N, M = len(self.inner), len(self.rays)
        outside = (u[:N] - c) / (_SHARPNESS * _HIGHEST)
        share = ca.sum1(1 + outside / ca.sqrt(1 + outside**2)) / (2 * N)
        growth, curvature = u[N : N + M], u[N + M : N + 2 * M]
        short = _GROWTH_COST * _relu(self.growth - growth, _GROWTH_SMOOTHING)
        short += _CURVATURE_COST * _relu(self.growth - curvature, _GROWTH_SMOOTHING)
        return _LEVEL_WEIGHT * (share + ca.sum1(short) / M)

    def margins(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """What must not be negative."""
        if not self.has_level:
            return ca.SX(0, 1)
        return ca.vertcat(_HIGHEST - c, u[self._inside :] - c)

    def first_level(self, u: Vector) -> Vector:
        """Where c starts: (1,), or nothing."""
        if not self.has_level:
            return np.zeros(0)
        return np.array([0.9 * min(_HIGHEST, float(u[self._inside :].min()))])


def make_shaping(
    asked: Regulariser | Level, box: SampleBox, size: Vector, energy: float, a: float, seed: int
) -> Shaping:
    """Samples of the box and of its boundary, the same for the same seed.

    No more growth is asked for than the curvature `a` at z* allows, in energy over squared size.
    """
    shaped = list(box.shaped)
    ceiling = min(box.ceiling, _least_excess(box, seed))
    ceiling = ceiling if ceiling > 0 else np.inf  # nothing keeps them in: no region, whatever V is
    inner = _offsets(box, box.active, quasi_random(_CANDIDATES * _INNER, len(box.active), seed))
    within = inner[box.excess(inner) <= ceiling]
    inner = (within if isinstance(asked, Level) and len(within) else inner)[:_INNER]
    cube = quasi_random(_INNER, len(shaped) + 1, seed)
    around, depth = _offsets(box, box.shaped, cube[:, 1:]), cube[:, :1]
    directions = np.zeros_like(around)
    directions[:, shaped] = np.random.default_rng(seed).normal(size=(_INNER, len(shaped)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if isinstance(asked, Level):  # what matters is how far V lies below the largest level
        energy = ceiling / _HIGHEST if np.isfinite(ceiling) else energy
    return Shaping(
        asked=asked,
        inner=inner,
        rays=around * (_NEAREST + (1 - _NEAREST) * depth),
        near=around * (_CONVEX if len(box.active) <= 2 else _CONVEX_IN_MORE),
        directions=directions * size,
        boundary=np.concatenate(list(_faces(box, box.shaped, _BOUNDARY, seed))),
        size=size,
        energy=energy,
        growth=min(_GROWTH, _BELOW_A * a / energy),
    )


def _least_excess(box: SampleBox, seed: int) -> float:
    """Level that keeps the states that are not shaped in the box, the others at z*, by samples."""
    others = [i for i in box.active if i not in box.shaped]
    faces = list(_faces(box, others, _BOUNDARY, seed))
    return float(np.min([box.excess(face).min() for face in faces], initial=np.inf))


def _faces(box: SampleBox, states: Sequence[int], count: int, seed: int) -> Iterator[Vector]:
    """Samples of each face of the box in some of its states, the others at z*."""
    d = len(states)
    each = max(1, count // (2 * d)) if d > 1 else 1
    for axis in range(d):
        for side in (0.0, 1.0):
            shares = quasi_random(each, d - 1, seed + 2 * axis + int(side) + 1)
            yield _offsets(box, states, np.insert(shares, axis, side, axis=1))


def _offsets(box: SampleBox, states: Sequence[int], shares: Vector) -> Vector:
    """Points of the box given by shares of its sides in some states, (points, n + nc)."""
    chosen = list(states)
    result = np.zeros((len(shares), len(box.lo)))
    result[:, chosen] = box.lo[chosen] + shares * (box.hi - box.lo)[chosen]
    return result


def moving_weights(form: Form) -> npt.NDArray[np.int_]:
    """Indices of the weights in which V is affine: output layers and κ."""
    result, at = [], 0
    for network in (form.hc, form.k):
        result.append(at + _affine_weights(network))
        at += network.size
    return np.concatenate(result).astype(int)


def sharper(form: Form) -> Vector:
    """Factors for random weights: features of more detail in the hidden layers, (size,)."""
    parts = [np.ones(network.size) for network in (form.hc, form.k)]
    for network, factor in zip((form.hc, form.k), parts, strict=True):
        factor[: sum(rows * columns + rows for rows, columns in network.shapes[:-1])] = _DETAIL
    return np.concatenate(parts)


def _affine_weights(network: Network) -> npt.NDArray[np.int_]:
    rows, columns = network.shapes[-1]
    d = network.inputs if network.quadratic else 0
    end = network.size - 2 * d
    return np.arange(end - rows * columns - rows, end + d)


def _row(terms: Terms, form: Form, moving: npt.NDArray[np.int_]) -> ca.Function:
    """(weights, z*, o, d) -> (ΔV, ∇Vᵀd, dᵀ∇²V d) at z* + o, and its Jacobian in what moves."""
    N = terms.n + terms.nc
    w, z_star, o, d = (ca.MX.sym(s, k) for s, k in zip("wzod", (form.size, N, N, N), strict=True))
    z = ca.MX.sym("z", N)
    V = value(terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))
    slope = ca.jtimes(V, z, d)
    jet = ca.Function("jet", [w, z, d], [V, slope, ca.jtimes(slope, z, d)])
    here, first, second = jet.call([w, z_star + o, d])
    both = ca.vertcat(here - jet.call([w, z_star, d])[0], first, second)
    symbols = [w, z_star, o, d]
    plain = ca.Function("plain", symbols, [both])
    if form.size > _SCALAR_WEIGHTS:
        return _with_slopes(plain, symbols, moving)
    return _with_slopes(plain.expand(), [ca.SX.sym(s.name(), s.numel()) for s in symbols], moving)


def _with_slopes(
    plain: ca.Function, symbols: list[_Symbols], moving: npt.NDArray[np.int_]
) -> ca.Function:
    u = plain(*symbols)
    slopes = ca.densify(ca.jacobian(u, symbols[0])[:, moving.tolist()])
    return ca.Function("row", symbols, [u, slopes])


def _relu(v: ca.SX, scale: float) -> ca.SX:
    """max(v, 0), smooth over about `scale`: at most scale/2 above it."""
    return (v + ca.sqrt(v * v + scale**2)) / 2


class AffineRows:
    """The rows u = A ŵ[moving] + b of a shaping in the program; A and b are parameters."""

    def __init__(self, shaping: Shaping, lifting: Lifting, w: ca.MX, c: ca.MX) -> None:
        moving = moving_weights(lifting.form)
        A, b = ca.MX.sym("A", shaping.count, moving.size), ca.MX.sym("b", shaping.count)
        u, level = ca.SX.sym("u", shaping.count), ca.SX.sym("c")
        objective = shaping.objective(u, level)
        second = ca.diag(ca.hessian(objective, u)[0])
        terms = ca.Function("shape", [u, level], [objective, shaping.margins(u, level), second])
        selection = ca.DM.eye(w.numel())[moving.tolist(), :]
        self.parameters = ca.vertcat(ca.vec(A), b)
        rows = A @ (selection @ w) + b
        self.objective, self.margins, bends = terms.call([rows, c])
        weighted = ca.repmat(bends, 1, moving.size) * A
        self.curvature = selection.T @ (A.T @ weighted) @ selection
        slopes = ca.jacobian(shaping.margins(u, level), ca.vertcat(level, u))
        at_level, at_rows = ca.DM(slopes)[:, 0], ca.sparsify(ca.DM(slopes)[:, 1:])
        self.slope = ca.horzcat(at_level, (at_rows @ A) @ selection)

    def first_derivative(self, s: ca.MX, w: ca.MX, p: ca.MX, g: ca.MX) -> dict[str, object]:
        """The Jacobian of the constraints, of these rows without differentiation.

        `g` holds the other constraints; the level is the last entry of `s`.
        """
        x = ca.vertcat(s, w)
        own = ca.horzcat(ca.MX(self.slope.size1(), s.numel() - 1), self.slope)
        jacobian = ca.vertcat(ca.jacobian(g, x), own)
        both = [ca.vertcat(g, self.margins), jacobian]
        return {"jac_g": ca.Function("jac_g", [x, p], both)}
