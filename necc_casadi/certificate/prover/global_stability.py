"""The global certificate: ∇²V ⪰ μI on the whole space, hence one minimum and bounded solutions.

V is then radially unbounded, and LaSalle's principle takes every solution to z̄.

For Φ = H + Hc + C, linear Casimirs and a plant of constant structure, whose energy has a Hessian
that is periodic or constant in every state. Networks enter by a matrix below their Hessian for
all arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.statements import Missing
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.hessian_floor import (
    hessian_floor,
    scalar_hessian_floor,
)
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_everywhere, written
from necc_casadi.certificate.prover.invariant_sets import largest_invariant_set_is_critical
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.networks import Network
from necc_casadi.symbolic.zero import is_zero

__all__ = ["GlobalStability", "prove_global_stability"]


#: Cells of one period of the symbols, in all.
_CELLS = 4096


#: ∇²V and ∂²H/∂s² exceed this multiple of the identity, so V grows at least quadratically.
_MARGIN = 1e-6


#: Of κ: how far below inf f″ of a deep scalar network its bound may lie, and half of what is kept
#: so that other arithmetic can confirm it.
_SLACK = 0.03


Bends = tuple[float | None, float | None]


@dataclass(frozen=True)
class GlobalStability:
    """Whether z̄ is proved to attract every state of the whole space."""

    missing: Missing | None  # None: nothing is
    resting: tuple[int, ...] = ()  # momenta that were minimised out
    #: of Hc and K without their quadratic parts: below f″, where cells of the line gave it
    bends: Bends = (None, None)


def prove_global_stability(design: Design, resting: Sequence[int]) -> GlobalStability:
    """∇²V ⪰ μI in the states that are not momenta, ∂²H/∂s² ⪰ μI in the momenta."""
    slopes = sp.Matrix(
        [[sp.diff(c, s) for s in _others(design, resting)] for c in design.casimirs.functions]
    )
    missing = _beyond_scope(design, resting, slopes)
    if missing is not None:
        return GlobalStability(missing)
    momenta = [design.loop.z[i] for i in resting]
    stiffness = sp.hessian(design.loop.plant.H, momenta) if momenta else sp.eye(1)
    bends = _convex(design, resting, slopes) if _positive_everywhere(stiffness, None) else None
    if bends is None:
        return GlobalStability("∇²V ≻ 0 is not proved for every state")
    return GlobalStability(None, tuple(resting), bends)


def _others(design: Design, resting: Sequence[int]) -> list[sp.Symbol]:
    return [s for i, s in enumerate(design.loop.z) if i not in resting]


def _beyond_scope(design: Design, resting: Sequence[int], slopes: sp.Matrix) -> Missing | None:
    """What the structure of the loop lacks for a global claim."""
    loop, form = design.loop, design.form
    if form.phi is not None or form.betas:
        return "only Φ = H + Hc + C with C = K(c) is covered"
    if not is_smooth_everywhere(written(design), loop.z):
        return "energy, structure and Casimirs are not proved to be smooth for all states"
    varying = loop.M.free_symbols | loop.ports.free_symbols
    if varying or not largest_invariant_set_is_critical(design, resting):
        return "the invariant sets are not proved to be the critical points of V"
    return "the Casimirs are not linear" if slopes.free_symbols else None


def _convex(design: Design, resting: Sequence[int], slopes: sp.Matrix) -> Bends | None:
    """Whether ∇²V ≻ 0 with the momenta at rest, and the bends of the networks that it took."""
    momenta = {design.loop.z[i]: 0 for i in resting}
    rest = sp.hessian(design.loop.plant.H.subs(momenta), _others(design, resting))
    (hc, k), nc = (design.form.hc, design.form.k), design.loop.controller.nc
    of_hc, of_k = design.form.split(design.weights)[:2]

    def positive(below_hc: Interval, below_k: Interval) -> bool:
        return _positive_everywhere(rest, _added(below_hc, below_k, slopes, nc))

    if positive(hessian_floor(hc, of_hc), hessian_floor(k, of_k)):
        return None, None
    worth_it = _sharper(hc) or _sharper(k)
    if not (worth_it and positive(_quadratic(hc, of_hc), _quadratic(k, of_k))):
        return None
    bends = _bend(hc, of_hc), _bend(k, of_k)
    floors = _floor(hc, of_hc, bends[0]), _floor(k, of_k, bends[1])
    return bends if positive(*floors) else None


def _sharper(network: Network) -> bool:
    """Whether cells of the line bound a network's curvature better than its layers do."""
    scalar = network.inputs == 1 and network.activation == "tanh"
    return scalar and network.quadratic and len(network.hidden) > 1


def _bend(network: Network, weights: Vector) -> float | None:
    if not _sharper(network):
        return None
    slack = _SLACK * float(network.quadratic_part(weights)[0][0])
    bend = scalar_hessian_floor(network, weights, slack)
    return None if bend is None else bend - slack


def _quadratic(network: Network, weights: Vector) -> Interval:
    """The curvature of the quadratic part alone, which a tanh network cannot raise everywhere."""
    if not _sharper(network):
        return hessian_floor(network, weights)
    return point(np.diag(network.quadratic_part(weights)[0]))


def _floor(network: Network, weights: Vector, bend: float | None) -> Interval:
    if bend is None:
        return hessian_floor(network, weights)
    return _quadratic(network, weights) + bend


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
    if not all(is_zero(entry) for difference in turned for entry in difference):
        return False
    reach = np.full(len(symbols), 3.15)  # a little more than π
    parts = max(4, int(_CELLS ** (1 / max(1, len(symbols)))))
    cells = subdivide(Interval(-reach, reach), parts)
    enclosure = matrix_enclosure(matrix, symbols, cells)
    with np.errstate(all="ignore"):
        total = enclosure if added is None else enclosure + added
        return bool(positive_definite(total, _MARGIN).all())
