"""Power shaping: Casimirs of another passive output of the same plant.

With F = J − R, a loop u = −α(x, ξ)∇Hc + v of any passive output has a Casimir C(x, ξ) only where
M∇C = 0, whose first rows say F∂C/∂x = Gα∂C/∂ξ, hence

    G⊥ F ∇γ = 0   for γ = C(·, ξ):

the solutions γ(x) are all that any output offers for this F, and the loop of
:mod:`necc_casadi.model.shaped_loop` uses every one of them. They are sought as Casimirs are, of the
distribution that the columns of FᵀG⊥ᵀ span.

References
----------
Ortega, van der Schaft, Castaños, Astolfi (2008); docs/theory.md#power-shaping.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.casimirs.integrability import potential
from necc_casadi.methods.flow import Flow
from necc_casadi.methods.method import Method, Refusal
from necc_casadi.model.plant import Plant
from necc_casadi.model.shaped_loop import ShapedLoop, shaped_loop
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.linear_algebra import kernel, tidy
from necc_casadi.symbolic.zero import is_zero
from necc_casadi.verdict.judge import judge

__all__ = ["power_shaping", "shaping_functions"]


#: F with more operations than this, or F⁻¹G, is not looked at as a first try.
_MOST_OPERATIONS = 300


def power_shaping(plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr]) -> Method | Refusal:
    """The loop of power shaping at a target, or why there is none.

    Parameters
    ----------
    plant
        With F = J − R as it stands.
    x_star
        Exact value of every plant state.
    """
    found = shaping_functions(plant, x_star)
    gammas = [(g, _alpha(plant, g)) for g in found.functions]
    if any(alpha is None for _, alpha in gammas):
        return Refusal("shaping", "α of F∇γ = −Gα was not found in closed form", False)
    known = [(g, alpha) for g, alpha in gammas if alpha is not None]
    acting = [(g, alpha) for g, alpha in known if not alpha.is_zero_matrix]
    own = [g for g, alpha in known if alpha.is_zero_matrix]
    if not acting:
        reason = "no function γ of the states solves G⊥(J − R)∇γ = 0 beside the plant's Casimirs"
        proved = found.complete and found.count_proved
        return Refusal("shaping", f"{reason}: for this J − R no passive output helps", proved)
    loop = shaped_loop(plant, *_normalised(acting))
    casimirs = _loop_casimirs(loop, own, found)
    verdict = judge(loop, casimirs, x_star)
    if verdict.assignable:
        return Method("shaping", loop, casimirs, verdict)
    return Refusal("shaping", _refused(verdict.reason), verdict.assignable is False)


def _refused(reason: str) -> str:
    words = {
        "not_an_equilibrium": "no constant input holds the target",
        "invisible_gradient": "H slopes along a direction that no shaping function sees",
        "invisible_negative_curvature": "H curves down along a direction that no γ sees",
        "invisible_flat_curvature": "H is flat along a direction that no γ sees",
        "needs_decreasing_phi": "only a decreasing Φ would make V least there",
    }
    found = words.get(reason, "whether the shaping functions suffice is not decided")
    return f"{found}: for this J − R no passive output helps" if reason in words else found


def shaping_functions(plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr]) -> Casimirs:
    """Functions γ(x) with G⊥(J − R)∇γ = 0, and how many there are.

    ∇γ = −F⁻¹G, which has α = I, is tried first.
    """
    F = sp.Matrix(plant.J - plant.R)
    fields = (F.T * kernel(sp.Matrix(plant.G.T))).applyfunc(tidy)
    return find_casimirs(Flow.of(plant.x, fields, plant.H), _by_inversion(plant), x_star)


def _by_inversion(plant: Plant) -> list[sp.Expr]:
    """Potentials of the columns of −F⁻¹G, where there are."""
    F = sp.Matrix(plant.J - plant.R)
    if not F.free_symbols or sum(e.count_ops() for e in F) > _MOST_OPERATIONS:
        return []  # for a constant F linear functions are all there is
    try:
        slopes = -F.LUsolve(sp.Matrix(plant.G))
    except (ValueError, ZeroDivisionError):  # F is singular
        return []
    if sum(e.count_ops() for e in slopes) > _MOST_OPERATIONS:
        return []
    slopes = slopes.applyfunc(tidy)
    columns = (list(slopes[:, j]) for j in range(slopes.cols))
    found = [potential(column, plant.x) for column in columns]
    return [g for g in found if g is not None and _alpha(plant, g) is not None]


def _alpha(plant: Plant, gamma: sp.Expr) -> sp.Matrix | None:
    """α with F∇γ = −Gα, m × 1; None where that is not proved."""
    G, drive = sp.Matrix(plant.G), (plant.J - plant.R) * gradient(gamma, plant.x)
    alpha = sp.Matrix(-((G.T * G).inv() * G.T * drive).applyfunc(tidy))
    if all(is_zero(entry) is True for entry in drive + G * alpha):
        return alpha
    return None


def _normalised(acting: Sequence[tuple[sp.Expr, sp.Matrix]]) -> tuple[list[sp.Expr], sp.Matrix]:
    """γ and α (m × r), with α = I where it is constant and invertible."""
    gamma = sp.Matrix([[g for g, _ in acting]])
    alpha = sp.Matrix.hstack(*(column for _, column in acting))
    if not alpha.free_symbols and alpha.rows == alpha.cols:
        try:
            inverse = alpha.inv()
        except ValueError:  # singular
            return [_without_constant(g) for g in gamma], alpha
        gamma, alpha = (gamma * inverse).applyfunc(sp.expand), sp.eye(alpha.rows)
    return [_without_constant(g) for g in gamma], alpha


def _without_constant(g: sp.Expr) -> sp.Expr:
    return g.as_independent(*g.free_symbols, as_Add=True)[1]


def _loop_casimirs(loop: ShapedLoop, own: Sequence[sp.Expr], found: Casimirs) -> Casimirs:
    """γ − ξ for every shaping function, and the plant's own Casimirs."""
    pairs = zip(loop.shaping, loop.controller.xi, strict=True)
    functions = (*(g - s for g, s in pairs), *own)
    return replace(
        found,
        functions=functions,
        origins=("power shaping",) * loop.controller.nc + ("plant",) * len(own),
    )
