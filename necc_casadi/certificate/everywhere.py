"""The global certificate: ∇²V ⪰ μI on the whole space, hence one minimum and bounded solutions.

For Φ = H + Hc + C, linear Casimirs and a plant of constant structure, whose energy has a Hessian
that is periodic or constant in every state. Networks enter by a matrix below their Hessian for
all arguments: diag κ less Σ |w| sup|σ″| W Wᵀ, one hidden layer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.artifact import Design
from necc_casadi.certificate.definite import positive_definite
from necc_casadi.certificate.enclosures import matrix_enclosure
from necc_casadi.certificate.intervals import Interval, matmul, point
from necc_casadi.certificate.motion import critical_points_are_invariant
from necc_casadi.certificate.structure import subdivide
from necc_casadi.networks import Network, Vector

__all__ = ["why_not_global"]

#: Bounds of −inf σ″ and sup σ″ over the real line: tanh ±4/(3√3), squareplus in (0, 1/4].
_BENDS = {"tanh": (0.7699, 0.7699), "sin": (1.0, 1.0), "squareplus": (0.0, 0.25)}
_CELLS = 4096
#: ∇²V and ∂²H/∂s² exceed this multiple of the identity, so V grows at least quadratically.
_MARGIN = 1e-6


def why_not_global(design: Design, resting: Sequence[int]) -> str | None:
    """None where z̄ is proved to attract every state of the whole space; else what is missing."""
    loop, form = design.loop, design.form
    if form.phi is not None or form.betas:
        return "only Φ = H + Hc + C with C = K(c) is covered"
    if (loop.M.free_symbols | loop.ports.free_symbols) or not critical_points_are_invariant(
        design, resting
    ):
        return "the invariant sets are not proved to be the critical points of V"
    weights = form.split(design.weights)
    floors = [curvature_floor(net, w) for net, w in zip((form.hc, form.k), weights, strict=False)]
    if floors[0] is None or floors[1] is None:
        return "networks with several hidden layers have no bound of their curvature here"
    others = [s for i, s in enumerate(loop.z) if i not in resting]
    slopes = sp.Matrix([[sp.diff(c, s) for s in others] for c in design.casimirs.functions])
    if slopes.free_symbols:
        return "the Casimirs are not linear"
    momenta = [loop.z[i] for i in resting]
    rest = loop.plant.H.subs(dict.fromkeys(momenta, 0))
    added = _added(floors[0], floors[1], slopes, loop.controller.nc)
    stiffness = sp.hessian(loop.plant.H, momenta) if momenta else sp.eye(1)
    convex = _positive_everywhere(sp.hessian(rest, others), added)
    if not (convex and _positive_everywhere(stiffness, None)):
        return "∇²V ≻ 0 is not proved for every state"
    return None


def curvature_floor(network: Network, weights: Vector) -> Interval | None:
    """A matrix ⪯ ∇²f(v) for every v, d × d; None for several hidden layers."""
    if len(network.hidden) > 1:
        return None
    d = network.inputs
    floor = point(
        np.diag(network.quadratic_part(weights)[0]) if network.quadratic else np.zeros((d, d))
    )
    if not network.hidden:
        return floor
    (W, _), (w, _) = network.layers(weights)
    down, up = _BENDS[network.activation]
    bend = point(np.maximum(w[0], 0)) * down + point(np.maximum(-w[0], 0)) * up
    return floor - matmul(point(W.T) * bend, point(W))


def _added(hc: Interval, k: Interval, slopes: sp.Matrix, nc: int) -> Interval:
    """What Hc and K add to ∇²V at least, in the states that are not momenta."""
    N = matrix_enclosure(slopes, [], point(np.zeros((1, 0))))[0]  # r × d
    d = slopes.cols
    block = Interval(np.zeros((d, d)), np.zeros((d, d)))
    block.lo[d - nc :, d - nc :], block.hi[d - nc :, d - nc :] = hc.lo, hc.hi
    return matmul(Interval(N.lo.T, N.hi.T), matmul(k, N)) + block


def _positive_everywhere(matrix: sp.Matrix, added: Interval | None) -> bool:
    """Whether a matrix, periodic or constant in each symbol, plus `added` is ≻ 0 for all values."""
    symbols = sorted(matrix.free_symbols, key=str)
    turned = [matrix.subs(s, s + 2 * sp.pi) - matrix for s in symbols]
    if not all(ex.is_zero(entry) for difference in turned for entry in difference):
        return False
    reach = np.full(len(symbols), 3.15)  # a little more than π
    parts = max(4, int(_CELLS ** (1 / max(1, len(symbols)))))
    cells = subdivide(Interval(-reach, reach), parts)
    enclosure = matrix_enclosure(matrix, symbols, cells)
    with np.errstate(all="ignore"):
        total = enclosure if added is None else enclosure + added
        return bool(positive_definite(total, _MARGIN).all())
