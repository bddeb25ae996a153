"""Matrices below a network's Hessian for all arguments, however large.

The Hessian is Σ cⱼ σ″(aⱼ) ∇aⱼ∇aⱼᵀ over the neurons of all layers, cⱼ the slope of the output in
neuron j and aⱼ its argument. For |σ′| ≤ 1 absolute weights bound cⱼ and the shares α of
∇aⱼ = Σ αᵢuᵢ in the rows u of the first layer, and ∇aⱼ∇aⱼᵀ ⪯ Σ|αᵢ| Σ|αᵢ| uᵢuᵢᵀ (Cauchy–Schwarz).
A scalar tanh network is bounded more sharply on cells of the line: far out its first layer is
saturated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, matmul, point
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.lyapunov.networks import Network

__all__ = ["hessian_ceiling", "hessian_floor", "scalar_hessian_floor", "sharpest_floor"]


#: Bounds of −inf σ″ and sup σ″ over the real line: tanh ±4/(3√3), squareplus in (0, 1/4].
_BENDS = {"tanh": (0.7699, 0.7699), "sin": (1.0, 1.0), "squareplus": (0.0, 0.25)}


#: Cells of the line at first, cells at most in one round of halving, and rounds.
_CELLS, _WORST, _ROUNDS = 512, 256, 12


#: Of κ: how far below inf f″ of a deep scalar network its bound may lie, and half of what is kept
#: so that other arithmetic can confirm it.
_SLACK = 0.03


#: Beyond 2 to this power the line counts as not bounded.
_FARTHEST = 60


def hessian_floor(network: Network, weights: Vector) -> Interval:
    """A matrix ⪯ ∇²f(v) for every v, the quadratic part included, d × d."""
    d = network.inputs
    floor = point(
        np.diag(network.quadratic_part(weights)[0]) if network.quadratic else np.zeros((d, d))
    )
    if not network.hidden:
        return floor
    *hidden, (w, _) = network.layers(weights)
    bends = _bends([V for V, _ in hidden], w[0], network.activation)
    W = point(hidden[0][0])
    return floor - matmul(Interval(W.lo.T, W.hi.T) * bends, W)


def hessian_ceiling(network: Network, weights: Vector) -> Interval:
    """A matrix ⪰ ∇²f(v) for every v, the quadratic part included, d × d."""
    d, kappa = network.inputs, network.quadratic_part(weights)[0]
    plain, turned = replace(network, quadratic=False), np.array(weights, float)
    turned = turned[: plain.size]
    rows, columns = plain.shapes[-1]
    turned[-(rows * columns + rows) :] *= -1  # −f without its quadratic part
    return point(np.diag(kappa) if network.quadratic else np.zeros((d, d))) - hessian_floor(
        plain, turned
    )


def _bends(matrices: list[Vector], out: Vector, activation: str) -> Vector:
    """Weights of uᵢuᵢᵀ that the bends of all layers add up to, upper bounds, (h₁,)."""
    down, up = _BENDS[activation]
    worst = point(np.maximum(out, 0)) * down + point(np.maximum(-out, 0)) * up
    slope = point(np.abs(out))  # |∂f/∂(neuron)|, from the last layer to the first
    total = point(np.zeros(matrices[0].shape[0]))
    for depth in range(len(matrices) - 1, -1, -1):
        shares = point(np.eye(matrices[0].shape[0]))
        for V in matrices[1 : depth + 1]:
            shares = matmul(np.abs(V), shares)
        rows = worst * shares.sum()
        total = total + matmul(Interval(shares.lo.T, shares.hi.T), rows[:, None])[:, 0]
        if depth:
            slope = matmul(np.abs(matrices[depth].T), slope[:, None])[:, 0]
            worst = slope * max(down, up)
    bound: Vector = total.hi
    return bound


def sharpest_floor(network: Network, weights: Vector) -> tuple[Interval, float | None]:
    """The better of the floors, d × d, and the number below f″ on which it rests, if on one.

    Where a network has one input and several layers, cells of the line bound it better than its
    layers do.
    """
    floor = hessian_floor(network, weights)
    deep_scalar = network.inputs == 1 and network.activation == "tanh" and len(network.hidden) > 1
    if not (deep_scalar and network.quadratic):
        return floor, None
    kappa = network.quadratic_part(weights)[0]
    slack = _SLACK * float(kappa[0])
    bend = scalar_hessian_floor(network, weights, slack)
    if bend is None:
        return floor, None
    sharp = point(np.diag(kappa)) + (bend - slack)
    return (sharp, bend - slack) if sharp.lo[0, 0] > floor.lo[0, 0] else (floor, None)


def scalar_hessian_floor(network: Network, weights: Vector, tolerance: float) -> float | None:
    """A number ≤ f″(v) for every real v, without the quadratic part, f a tanh network ℝ → ℝ.

    Cells are halved until the bound is within `tolerance` of the infimum; None where the first
    layer does not saturate.
    """
    plain = replace(network, quadratic=False)
    layers = network.layers(weights)
    reach = next((2.0**k for k in range(_FARTHEST) if _beyond(layers, 2.0**k) <= tolerance), None)
    if reach is None:
        return None
    steep = float(np.abs(layers[0][0]).max())
    edges = np.sinh(np.linspace(-1, 1, _CELLS + 1) * np.arcsinh(reach * steep)) / steep
    edges[0], edges[-1] = -reach, reach
    cells = Interval(edges[:-1, None], edges[1:, None])
    bend = network_jet(plain, weights, cells).hess[:, 0, 0]
    for _ in range(_ROUNDS):
        worst = np.argsort(bend.lo)[:_WORST]
        worst = worst[bend.lo[worst] < min(float(bend.hi.min()), 0.0) - tolerance]
        if worst.size == 0:
            break
        others = np.setdiff1d(np.arange(len(bend.lo)), worst)
        middle, parts = cells.mid[worst], cells[worst]
        halves = concatenate(Interval(parts.lo, middle), Interval(middle, parts.hi))
        cells = concatenate(cells[others], halves)
        bend = concatenate(bend[others], network_jet(plain, weights, halves).hess[:, 0, 0])
    return min(float(bend.lo.min()), -tolerance)


def _beyond(layers: list[tuple[Vector, Vector]], reach: float) -> float:
    """An upper bound of |f″(v)| for |v| ≥ reach: magnitudes through the layers."""
    (W, b), *inner = layers
    steep = point(np.abs(W[:, 0]))
    least = point(np.maximum((steep * reach - np.abs(b)).lo, 0.0)).tanh()
    slope = (1.0 - least.square()).hi  # of σ, beyond; |σ″| = 2|σ|σ′
    first, second = steep * slope, steep.square() * slope * 2.0
    for depth, (V, _) in enumerate(inner):
        first, second = (matmul(np.abs(V), v[:, None])[:, 0] for v in (first, second))
        if depth < len(inner) - 1:
            second = second + first.square() * _BENDS["tanh"][0]
    return float(second.hi[0])
