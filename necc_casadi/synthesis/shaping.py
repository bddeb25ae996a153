"""What is asked of V over the domain, beside the conditions at z*: the shape of a training run.

With ΔV(z) = V(z) − V(z*) and samples of the domain, all in natural units and with momenta at rest,
which add their kinetic energy to V whatever the networks do:

*regulariser*: the published one (Remark on the region of attraction) with V's free offset removed
and ReLU smoothed,

    ReLU((1/N) Σ ‖zᵢ − z*‖² − γ ΔV(zᵢ)),    ReLU(v) ≈ (v + √(v² + δ²))/2.

As published, with V(zᵢ) in place of ΔV(zᵢ), an offset of V would minimise it
(docs/theory.md#regulariser-without-offset).

*level*: the height of what ends the region, in the few states s that are not minimised out. With
w(s) = min V(s, ·) = V(s, ε(s)),

    max  c − (ω/M) Σ ReLU(η − gᵢ)    subject to  w(sⱼ) − V(z*) ≥ c on the boundary,  c ≤ ceiling,

where gᵢ = ∇w(sᵢ)ᵀ(sᵢ − s*)/‖sᵢ − s*‖² keeps other critical points out, ∇w = V_s(s, ε(s)). V is
affine in what moves, so w is concave in it, a minimum of affine functions: ε(sᵢ) of one V gives the
cuts for the next (Kelley's method). What the networks may take from the quadratic parts is bounded:
V stays convex in what is minimised out. Of a family each row is that of the worst of its members:
their energies do not depend on what moves. A certificate, not these samples, says what was reached.

Shaped networks keep their hidden layers: V is then affine in what moves, and the Hessian of both
objectives is exact at the price of one product AᵀDA.

References
----------
Kelley (1960), The cutting-plane method for solving convex programs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.prover.region.landscape import Landscape
from necc_casadi.lyapunov.lyapunov import LyapunovFunction, Terms, value
from necc_casadi.lyapunov.networks import KAPPA_MIN, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.samples import quasi_random
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.members import Members
from necc_casadi.synthesis.sample_box import SampleBox

__all__ = [
    "AffineRows",
    "Average",
    "Height",
    "Shaping",
    "average_over",
    "height_over",
    "moving_weights",
]


_Symbols = TypeVar("_Symbols", ca.MX, ca.SX)


#: δ of the smooth ReLU of the regulariser; its argument is of order one.
_SMOOTHING = 0.1


#: η, δ and ω: least growth along rays in natural units, and what falling short of it costs.
_GROWTH, _GROWTH_SMOOTHING, _GROWTH_COST = 0.2, 0.1, 100.0


#: η is no more than this share of the curvature asked for at z*.
_BELOW_A = 0.4


#: Growth is sampled from this share of the way to the boundary on.
_NEAREST = 0.05


#: V where the model is not defined, in natural units: far above every level.
_AT_A_POLE = 1e3


#: Up to this many weights samples are evaluated in scalar operations, which are faster.
_SCALAR_WEIGHTS = 10_000


#: Entries of a sample's row: ΔV, ∇Vᵀd.
_VALUE, _SLOPE = range(2)


#: Weight beside the other terms of the objective, which then only select among equal shapes.
_REGULARISER_WEIGHT, _LEVEL_WEIGHT = 100.0, 500.0


#: The largest level in units of energy, as for a momentum at twice its natural size.
_HIGHEST = 2.0


#: Samples of the regulariser; of s for the growth, by the number of kept states, and of s on the
#: boundary.
_INNER, _RAYS, _BOUNDARY = 256, {1: 96, 2: 192, 3: 256}, 128


@dataclass(frozen=True, eq=False)
class Shaping(ABC):
    """Samples and objective, as elementwise functions of rows u = A m + b in moving weights m."""

    size: Vector  # (n + nc,) natural size of each state
    energy: float  # what V is measured in
    has_level = False  # whether the level c is a decision variable

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of rows u."""

    @abstractmethod
    def rows(
        self, terms: Terms, form: Form, weights: Vector, z_star: Vector
    ) -> tuple[Vector, Vector]:
        """(A, b) with u = A m + b, other weights fixed: (count, moving) and (count,)."""

    @abstractmethod
    def objective(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """The weighted objective, a sum of functions of uᵢ and one of c."""

    @abstractmethod
    def margins(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """What must not be negative."""

    def _sampled(
        self, terms: Terms, form: Form, weights: Vector, z_star: Vector
    ) -> Callable[[int, Vector, Vector], tuple[Vector, Vector]]:
        """(entry of a row, offsets, directions) -> u (S,) in natural units, A (S, moving)."""
        moving = moving_weights(form)
        row = _row(terms, form, moving)

        def at(kind: int, offsets: Vector, directions: Vector) -> tuple[Vector, Vector]:
            S = len(offsets)
            both = [np.repeat(v[:, None], S, axis=1) for v in (weights, z_star)]
            values, slopes = row.map(S).call([*both, offsets.T, directions.T])
            u = np.asarray(values, float)[kind] / self.energy
            A = np.asarray(slopes, float).reshape(2, S, moving.size)[kind] / self.energy
            poles = ~(np.isfinite(u) & np.isfinite(A).all(axis=1))
            u[poles], A[poles] = _AT_A_POLE, 0.0
            return u, A

        return at


@dataclass(frozen=True, eq=False)
class Average(Shaping):
    """The regulariser; its row is the mean of ‖zᵢ − z*‖² − γ ΔV(zᵢ)."""

    gamma: float
    inner: Vector  # (N, n + nc) zᵢ − z*

    @property
    def count(self) -> int:
        """One."""
        return 1

    def rows(
        self, terms: Terms, form: Form, weights: Vector, z_star: Vector
    ) -> tuple[Vector, Vector]:
        """The mean over samples at which the model is defined."""
        u, A = self._sampled(terms, form, weights, z_star)(_VALUE, self.inner, self.inner)
        defined = u != _AT_A_POLE
        squares = ((self.inner / self.size) ** 2).sum(1)
        mean = np.array([np.mean((squares - self.gamma * u)[defined])])
        slope = -self.gamma * A[defined].mean(0, keepdims=True)
        return slope, mean - slope @ weights[moving_weights(form)]

    def objective(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """The smooth ReLU of the mean."""
        return _REGULARISER_WEIGHT * _relu(u, _SMOOTHING)

    def margins(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """Nothing."""
        return ca.SX(0, 1)


@dataclass(frozen=True, eq=False)
class Height(Shaping):
    """The level; its rows are the growth of w along rays, then w(sⱼ) − V(z*) on the boundary."""

    rays: Vector  # (M, n + nc) (sᵢ, εᵢ) − z*
    boundary: Vector  # (B, n + nc) (sⱼ, εⱼ) − z*
    active: tuple[int, ...]  # the states that do not rest
    kept: tuple[int, ...]  # s, those of them that are not minimised out
    growth: float  # η
    members: Members | None = None  # of a family: each row is that of the worst of them
    has_level = True

    @property
    def count(self) -> int:
        """Number of samples of s."""
        return len(self.rays) + len(self.boundary)

    def at(self, V: LyapunovFunction, z_star: Vector) -> Height:
        """The same samples of s, with the minimisers ε(s) of this V."""
        kept = tuple(k for k, i in enumerate(self.active) if i in self.kept)
        gone = tuple(k for k, i in enumerate(self.active) if i not in self.kept)
        landscape = Landscape(V, z_star, self.active, kept, gone)

        def lowered(offsets: Vector) -> Vector:
            s = (offsets + z_star)[:, list(self.kept)]
            found = landscape.states(s, landscape.minima(s).e) - z_star
            return np.where(np.isfinite(found).all(1, keepdims=True), found, offsets)

        return replace(self, rays=lowered(self.rays), boundary=lowered(self.boundary))

    def rows(
        self, terms: Terms, form: Form, weights: Vector, z_star: Vector
    ) -> tuple[Vector, Vector]:
        """Growth and height at the minimisers as they stand."""
        at = self._sampled(terms, form, weights, z_star)
        radial = np.zeros_like(self.rays)
        radial[:, list(self.kept)] = self.rays[:, list(self.kept)]
        square = ((radial / self.size) ** 2).sum(1, keepdims=True)
        parts = [
            at(_SLOPE, self.rays, radial / square),
            at(_VALUE, self.boundary, self.boundary),
        ]
        u, A = (np.concatenate(both) for both in zip(*parts, strict=True))
        if self.members is not None:  # their energies do not depend on what moves
            x_star = z_star[: terms.n]
            less = [
                self.members.least_slope(x_star, self.rays, radial / square),
                self.members.least_rise(x_star, self.boundary),
            ]
            u = u + np.concatenate(less) / self.energy
        return A, u - A @ weights[moving_weights(form)]

    def objective(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """The level, and how far growth falls short."""
        M = len(self.rays)
        short = _GROWTH_COST / M * ca.sum1(_relu(self.growth - u[:M], _GROWTH_SMOOTHING))
        return _LEVEL_WEIGHT * (short - c)

    def margins(self, u: ca.SX, c: ca.SX) -> ca.SX:
        """The level below the ceiling and below w on the boundary."""
        return ca.vertcat(_HIGHEST - c, u[len(self.rays) :] - c)

    def first_level(self, u: Vector) -> float:
        """Where c starts."""
        return 0.9 * min(_HIGHEST, float(u[len(self.rays) :].min()))

    def held(self, form: Form, w_hat: Vector) -> tuple[Vector, Vector]:
        """Bounds (size,) of ŵ within which V stays convex in what is minimised out.

        No κ becomes less, and output weights share what their network leaves of it now: a
        matrix below the network's Hessian, on which a certificate rests, stays diagonally dominant.
        """
        lower, upper = np.full(form.size, -np.inf), np.full(form.size, np.inf)
        start = 0
        for network in (form.hc, form.k):
            part = slice(start, start + network.size)
            start += network.size
            if not network.quadratic:
                continue
            out, kappa = _outputs(network), _kappa(network)
            own = w_hat[part]
            taken, v = _softening(network, own), np.abs(own[out])
            left = np.maximum(own[kappa] - KAPPA_MIN - taken.T @ v, 0.0)
            share = left / (len(v) * np.where(taken > 0, taken, np.inf))
            room = np.where(taken > 0, share, np.inf).min(1, initial=np.inf)
            upper[part][out], lower[part][out] = v + room, -v - room
            lower[part][kappa] = own[kappa]
        return lower, upper


def average_over(gamma: float, box: SampleBox, size: Vector, energy: float, seed: int) -> Average:
    """Samples of the box, the same for the same seed."""
    shares = quasi_random(_INNER, len(box.active), seed)
    return Average(size, energy, gamma, _offsets(box, box.active, shares))


def height_over(
    kept: Sequence[int],
    box: SampleBox,
    size: Vector,
    energy: float,
    a: float,
    seed: int,
    members: Members | None = None,
) -> Height:
    """Samples of s in the box and on its boundary, the same for the same seed.

    No more growth is asked for than the curvature `a` at z* allows, in energy over squared size.
    """
    ceiling = min(box.ceiling, _least_excess(box, seed))
    if 0 < ceiling < np.inf:  # what matters is how far V lies below the largest level
        energy = ceiling / _HIGHEST
    cube = quasi_random(_RAYS[len(kept)], len(kept) + 1, seed)
    depth = _NEAREST + (1 - _NEAREST) * cube[:, :1]
    return Height(
        size,
        energy,
        rays=_offsets(box, kept, cube[:, 1:]) * depth,
        boundary=np.concatenate(list(_faces(box, kept, _BOUNDARY, seed))),
        active=box.active,
        kept=tuple(kept),
        growth=min(_GROWTH, _BELOW_A * a / energy),
        members=members,
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


def _softening(network: Network, weights: Vector) -> Vector:
    """What each |v| of the output layer takes from each κ at most, (h, d).

    Sums of rows of the matrix below the network's Hessian on which a certificate rests.
    """
    out = _outputs(network)
    result = np.zeros((out.stop - out.start, network.inputs))
    for j in range(len(result)):
        alone = weights.copy()
        alone[out.start : _kappa(network).stop] = 0.0
        for sign in (-1.0, 1.0):
            alone[out.start + j] = sign
            taken = np.abs(hessian_floor(network, alone).lo).sum(1)
            result[j] = np.maximum(result[j], taken)
    return result


def _outputs(network: Network) -> slice:
    """Weights of the output layer, without its bias."""
    rows, columns = network.shapes[-1]
    end = network.size - (2 * network.inputs if network.quadratic else 0) - rows
    return slice(end - rows * columns, end)


def _kappa(network: Network) -> slice:
    """κ of the quadratic part."""
    return slice(network.size - 2 * network.inputs, network.size - network.inputs)


def _affine_weights(network: Network) -> npt.NDArray[np.int_]:
    rows, columns = network.shapes[-1]
    d = network.inputs if network.quadratic else 0
    end = network.size - 2 * d
    return np.arange(end - rows * columns - rows, end + d)


def _row(terms: Terms, form: Form, moving: npt.NDArray[np.int_]) -> ca.Function:
    """(weights, z*, o, d) -> (ΔV, ∇Vᵀd) at z* + o, and its Jacobian in what moves."""
    N = terms.n + terms.nc
    w, z_star, o, d = (ca.MX.sym(s, k) for s, k in zip("wzod", (form.size, N, N, N), strict=True))
    z = ca.MX.sym("z", N)
    V = value(terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))
    jet = ca.Function("jet", [w, z, d], [V, ca.jtimes(V, z, d)])
    here, slope = jet.call([w, z_star + o, d])
    both = ca.vertcat(here - jet.call([w, z_star, d])[0], slope)
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
