"""Momenta of a plant with other masses, fed to a law that has those of the model."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.loops import StoredInterconnection
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants, stated_ranges
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_momenta"]


#: How often a cell may be halved.
_DEPTH = 20


def check_momenta(
    evidence: Evidence, sound: bool, plant_file: Callable[[], str | None]
) -> Checked | None:
    """The claim about momenta that are fed; None where nothing is claimed.

    `sound`: what V̇ ≤ 0 rests on is proved. `plant_file` gives plant.json.
    """
    if not evidence.claimed("momenta"):
        return None
    model, ranges = evidence.model, stated_ranges(evidence, "momenta")
    text = statements.momenta(ranges)
    plants = StoredPlants(model, plant_file(), ranges)
    return Checked.by(
        "momenta",
        text,
        [
            ("Casimirs, structure and damping", lambda: sound),
            ("plant.json is of this design", partial(plants.fits, model)),
            ("as many inputs as coordinates of the published loop", partial(_is_covered, model)),
            ("the friction is that of the model", lambda: plants.R == model.R),
            ("V falls for every parameter", partial(_falls, model, plants)),
        ],
    )


def _is_covered(model: StoredDesign) -> bool:
    """Fully actuated, momenta measured, Φ the sum, no momentum in c, B constant and regular."""
    k, loop = model.n // 2, model.loop
    published = isinstance(loop, StoredInterconnection) and model.ahead is None
    if not published or model.n % 2 or model.m != k or model.inertia is not None:
        return False
    if model.form["phi"] is not None:
        return False
    rates, p = model.J[:k, k : model.n], model.z[k : model.n]
    zero = [*model.J[:k, :k], *model.R[:k, :], *model.G[:k, :]]
    zero += [sp.diff(c, s) for c in model.casimirs for s in p]
    constant = [*rates, *model.G[k:, :]]
    return (
        all(is_zero(v) is True for v in zero)
        and not any(v.free_symbols for v in map(sp.sympify, constant))
        and is_zero(rates.det()) is False
        and is_zero(model.G[k:, :].det()) is False
    )


def _falls(model: StoredDesign, plants: StoredPlants) -> bool:
    """Sym Q ≻ 0 for every q and θ, with y = B̂ᵀ∂H/∂p of the model and of the plant."""
    k = model.m
    B, q = model.G[k:, :], model.z[:k]
    own = sp.hessian(model.H, model.z[k : model.n])
    E = B.T * own * plants.inverse.inv() * B.T.inv() - sp.eye(k)
    moving = [s for s in q if E.has(s)]
    turn = 2 * sp.pi
    if any(is_zero(v.subs(s, s + turn) - v) is not True for v in E for s in moving):
        return False
    circle = ends(arb.pi())[1]
    sides = [
        (ends(evaluate(a, {}))[0], ends(evaluate(b, {}))[1]) for a, b in plants.ranges.values()
    ]
    box: Box = (*((-circle, circle) for _ in moving), *sides)
    symbols = (*moving, *plants.ranges)

    def test(cell: Box) -> bool:
        known = {s: arb(lo).union(arb(hi)) for s, (lo, hi) in zip(symbols, cell, strict=True)}
        error = arb_mat([[evaluate(v, known) for v in row] for row in E.tolist()])
        return positive(_form(model, error), 0.0)

    return by_bisection(box, test, _DEPTH)


def _form(model: StoredDesign, E: arb_mat) -> arb_mat:
    m = model.m
    D = [[arb(v) for v in row] for row in model.damping]
    Q = arb_mat(D)
    for i in range(2 * m):
        for j in range(m):
            extra = sum((D[i][a] * E[a, j] for a in range(m)), arb(0))
            Q[i, j] = Q[i, j] + extra - (E[i - m, j] if i >= m else arb(0))
    return (Q + Q.transpose()) / 2
