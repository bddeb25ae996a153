"""A controller that is fed momenta, while the plant has other masses than the model.

The law computes y from p with the inertia M₀ of the model: Bᵀq̇ where p = M₀q̇ is made of a measured
velocity, and (I + E)Bᵀq̇ with E = BᵀM₀⁻¹M_θB⁻ᵀ − I where p is the plant's own. Then exactly

    V̇ = −∇HᵀR∇H − (y, w)ᵀ Q (y, w),   Q = 𝒟 diag(I + E, I) − [0, 0; E, 0].

So V falls for every θ with sym Q ≻ 0 (docs/theory.md#measured-velocities).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import sympy as sp

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, point
from necc_casadi.certificate.prover.arithmetic.jets import constant
from necc_casadi.designs.design import Design
from necc_casadi.errors import ModelError
from necc_casadi.model.lagrangian import Plants, integral_obstacle, lagrangian
from necc_casadi.model.measurement import canonical_inertia
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.zero import is_zero

__all__ = ["prove_momenta"]


#: Cells at most, and rounds of halving.
_MOST_CELLS, _ROUNDS = 20_000, 16


def prove_momenta(design: Design, plants: Plants) -> Claim | None:
    """That V falls with every plant when momenta are fed; None where nothing can be said so.

    Of fully actuated mechanical plants of which the states are measured.
    """
    if design.measurement.of_velocities:
        return None
    plant = design.loop.plant
    try:
        known = replace(plant, inertia=canonical_inertia(plant))
    except ModelError:
        return None
    loop = replace(design.loop, plant=known)
    if integral_obstacle(loop, design.casimirs.functions, design.form.phi is None) is not None:
        return None
    own, varied = (lagrangian(loop, design.units, v) for v in (None, plants))
    if own is None or varied is None or own.R != varied.R:  # R ⪰ 0 is proved of the model's alone
        return None
    B = sp.Matrix(own.B)
    M = sp.Matrix(own.M)
    E = (B.T * M.inv() * sp.Matrix(varied.M) * B.T.inv() - sp.eye(B.rows)).applyfunc(tidy)
    ranges = {str(s): tuple(map(to_text, side)) for s, side in varied.ranges.items()}
    data = {"uncertain": {name: list(side) for name, side in ranges.items()}}
    moving = [s for s in own.q if E.has(s)]
    if not all(_repeats(entry, s) for entry in E for s in moving):
        return Claim("momenta", False, statements.NO_MOMENTA)
    sides = [(point(-np.pi).lo * (1 + 1e-15), point(np.pi).hi * (1 + 1e-15)) for _ in moving]
    ends = [tuple(map(constant, side)) for side in varied.ranges.values()]
    sides += [(a.lo, b.hi) for a, b in ends]
    box = Interval(*(np.array([[float(side[i]) for side in sides]]) for i in (0, 1)))
    symbols = (*moving, *varied.ranges)
    if not _holds(design.natural.damping, E, symbols, box):
        return Claim("momenta", False, statements.NO_MOMENTA)
    return Claim("momenta", True, statements.momenta(ranges), data)


def _repeats(entry: sp.Expr, angle: sp.Symbol) -> bool:
    return is_zero(entry.subs(angle, angle + 2 * sp.pi) - entry) is True


def _holds(damping: np.ndarray, E: sp.Matrix, symbols: tuple[sp.Symbol, ...], Z: Interval) -> bool:
    """Whether sym Q ≻ 0 on a box, which is cut where it is not proved."""
    for _ in range(_ROUNDS):
        Q = _form(damping, matrix_enclosure(E, symbols, Z))
        left = Z[~positive_definite(Q)]
        if left.shape[0] == 0:
            return True
        middle = matrix_enclosure(E, symbols, point(left.mid))
        if left.shape[0] > _MOST_CELLS or not positive_definite(_form(damping, middle)).all():
            return False
        Z = _halved(left)
    return False


def _form(damping: np.ndarray, E: Interval) -> Interval:
    """Sym Q over boxes, (B, 2m, 2m)."""
    m, boxes = E.shape[-1], E.shape[0]
    lo, hi = (np.zeros((boxes, 2 * m, 2 * m)) for _ in range(2))
    known = E + np.eye(m)
    for i in range(2 * m):
        for j in range(m):
            entry = (known[:, :, j] * damping[i, :m]).sum()
            if i >= m:
                entry = entry - E[:, i - m, j]
            lo[:, i, j], hi[:, i, j] = entry.lo, entry.hi
        lo[:, i, m:] = hi[:, i, m:] = damping[i, m:]
    Q = Interval(lo, hi)
    turned = Interval(np.swapaxes(lo, -1, -2), np.swapaxes(hi, -1, -2))
    return (Q + turned) * 0.5


def _halved(Z: Interval) -> Interval:
    axis = (Z.hi - Z.lo).argmax(axis=1)
    rows, cut = np.arange(Z.shape[0]), Z.mid
    upper, lower = Z.lo.copy(), Z.hi.copy()
    lower[rows, axis] = upper[rows, axis] = cut[rows, axis]
    return concatenate(Interval(Z.lo, lower), Interval(upper, Z.hi))
