"""Bounds of a network's Hessian from below for all arguments, in Arb balls.

∇aⱼ∇aⱼᵀ ⪯ Σ|αᵢ| Σ|αᵢ| uᵢuᵢᵀ for ∇aⱼ = Σ αᵢuᵢ (Cauchy–Schwarz), as in the prover's file of this name.
"""

from __future__ import annotations

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, by_bisection
from necc_casadi.certificate.checker.arithmetic.networks import Net

__all__ = ["curvature_above", "hessian_floor"]


#: How often an interval of the line may be halved, and how far out the search for tails goes.
_DEPTH, _FARTHEST = 20, 60


def hessian_floor(net: Net, activation: str) -> arb_mat:
    """A matrix ⪯ ∇²f for all arguments: κ less what the bends of all layers add up to.

    Along a path the slopes of neurons are at most 1, so absolute weights bound how far each first
    neuron's argument moves a later one, and squares of sums go by Cauchy and Schwarz.
    """
    total = net.quadratic_curvature()
    if len(net.layers) == 1:
        return total
    W, rows = net.layers[0][0], _path_weights(net, activation)
    for j in range(W.nrows()):
        for i in range(net.d):
            for k in range(net.d):
                total[i, k] = total[i, k] - rows[j] * W[j, i] * W[j, k]
    return total


def _path_weights(net: Net, activation: str) -> list[arb]:
    """For each first neuron the most that uuᵀ of its row u can be subtracted."""
    out = net.layers[-1][0].tolist()[0]
    bend = {"tanh": 4 / (3 * arb(3).sqrt()), "sin": arb(1), "squareplus": arb(1) / 4}[activation]
    convex = activation == "squareplus"
    worst = [arb(0) if convex and not w < 0 else abs(w) * bend for w in out]
    reach, sums = [abs(w) for w in out], [arb(0)] * net.layers[0][0].nrows()
    absolute = [arb_mat([[abs(v) for v in row] for row in W.tolist()]) for W, _ in net.layers]
    for depth in reversed(range(len(net.layers) - 1)):
        paths = _identity(len(sums))  # from first neurons to the arguments in this layer
        for W in absolute[1 : depth + 1]:
            paths = W * paths
        for weight, row in zip(worst, paths.tolist(), strict=True):
            length = sum(row, arb(0))
            sums = [s + weight * length * v for s, v in zip(sums, row, strict=True)]
        if depth:
            back = arb_mat([reach]) * absolute[depth]
            reach = back.tolist()[0]
            worst = [v * bend for v in reach]
    return sums


def _identity(size: int) -> arb_mat:
    return arb_mat([[int(i == j) for j in range(size)] for i in range(size)])


def curvature_above(net: Net, bend: float) -> bool:
    """Whether f″ ≥ κ + bend for every real argument of a tanh network ℝ → ℝ.

    Beyond some ±2ᵏ its first layer is as good as constant; in between by halving intervals.
    """
    if not bend < 0:
        return False
    for k in range(_FARTHEST):
        if _far_out(net, arb(2) ** k) <= -arb(bend):
            break
    else:
        return False
    least = net.quadratic_curvature()[0, 0] + bend

    def test(box: Box) -> bool:
        return bool(net.enclose(box)[2][0, 0] >= least)

    reach = 2.0**k
    return by_bisection(((-reach, 0.0),), test, _DEPTH + k) and by_bisection(
        ((0.0, reach),), test, _DEPTH + k
    )


def _far_out(net: Net, reach: arb) -> arb:
    """More than |f″ − κ| for all |v| ≥ reach."""
    (W, b), *later = net.layers
    slopes, bends = [], []
    for (w,), (shift,) in zip(W.tolist(), b.tolist(), strict=True):
        argument = (abs(w) * reach - abs(shift)).lower().max(arb(0))
        decay = 1 - argument.tanh() ** 2  # σ′ falls with |argument|, and |σ″| ≤ 2σ′
        slopes.append(abs(w) * decay)
        bends.append(2 * w * w * decay)
    first, second = (arb_mat([[v] for v in values]) for values in (slopes, bends))
    for V, _ in later[:-1]:
        positive = arb_mat([[abs(v) for v in row] for row in V.tolist()])
        first, second = positive * first, positive * second
        squares = [[s + v * v] for (s,), (v,) in zip(second.tolist(), first.tolist(), strict=True)]
        second = arb_mat(squares)
    positive = arb_mat([[abs(v) for v in later[-1][0].tolist()[0]]])
    return (positive * second)[0, 0].upper()
