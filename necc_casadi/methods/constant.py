"""Constant target structures: F_d constant, for any ẋ = f(x) + G u with constant G.

With s = G⊥f and the unknown constant B = G⊥F_d                docs/theory.md#constant-structures

    (i)    S(x) = B (∂s/∂x)ᵀ symmetric for all x
    (ii)   BG⊥ᵀ + G⊥Bᵀ ⪯ 0
    (iii)  S(x*) ≻ 0

B∇H₀ = s is then solved by quadratures, and (iii) is the curvature condition at x*. Floating point
proposes B, by a B = G⊥AP with P well conditioned in natural units; (i), (ii) and (iii) are proved.

References
----------
Prajna, van der Schaft, Meinsma (2002).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import ModelError
from necc_casadi.methods.constant_candidates import Proposal, candidates
from necc_casadi.methods.constant_energy import energy_of, with_minimum, written
from necc_casadi.methods.constant_question import (
    DIGITS,
    Question,
    natural_sizes,
    power_of_two,
    rounded,
)
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.methods.refutation import (
    no_constant_structure,
    nothing_is_conserved,
    uncontrollable_growth,
)
from necc_casadi.methods.structure_family import dissipation
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.matching import Matching
from necc_casadi.model.plant import make_plant
from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.symbolic.derivatives import at, gradient, value_at
from necc_casadi.symbolic.expressions import complexity
from necc_casadi.symbolic.floats import float_matrix, to_float
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = ["constant_structure"]


_FAMILY = "constant F_d"


#: Sizes whose squares and their ratios are doubles.
_FARTHEST = sp.Integer(2) ** 200

#: States beyond which expressions take minutes.
_LARGEST = 16

#: Symbols, powers and functions in ∂s/∂x beyond which proofs of what is symmetric take minutes:
#: about those of four links.
_LONGEST = 10_000


def constant_structure(
    drift: sp.MatrixBase,
    ports: sp.MatrixBase,
    x: Sequence[sp.Symbol],
    x_star: Mapping[sp.Symbol, sp.Expr],
    *,
    sizes: Mapping[sp.Symbol, float] | None = None,
    cheap: Vector | None = None,
    name: str = "plant",
    units: Mapping[str, str] | None = None,
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] | None = None,
) -> Matching | NoStructure:
    """A constant target structure of ẋ = f(x) + G u with a minimum of H₀ at x*.

    Parameters
    ----------
    drift
        f, n × 1, exact.
    ports
        G, n × m, of full column rank.
    x, x_star
        States, and their exact values at an equilibrium.
    sizes
        What a large value of each state is; by default a quarter of its domain, and where there is
        none, sizes with which the linearised plant moves all states alike.
    cheap
        Gains K (m, n) of LQR at x*: where the family has a structure in which u₀ has the slopes
        −K, such a one is taken.
    name, units, domain
        Of the plant, for the structure.

    Returns
    -------
    Matching
        Proved, with A = I, ∇H₀(x*) = 0, ∇²H₀(x*) ≻ 0 and linear ``shaping`` functions.
    NoStructure
        ``proved`` only with an exact proof that there is none.
    """
    f, G = sp.Matrix(drift), sp.Matrix(ports)
    if G.free_symbols:
        return NoStructure(_FAMILY, "G depends on the state", False)
    if len(x) > _LARGEST:
        return NoStructure(_FAMILY, f"plants of more than {_LARGEST} states are not tried", False)
    A = sp.Matrix(at(f.jacobian(list(x)), x_star))
    if not np.all(np.isfinite(float_matrix(A))):
        return NoStructure(_FAMILY, "f has no finite slopes at the target", False)
    chosen = tuple(natural_sizes(x, A, sizes or {}, domain or {}))
    if not all(1 / _FARTHEST < size < _FARTHEST for size in chosen):
        reason = "the sizes of the states are too far from 1 for floating point"
        return NoStructure(_FAMILY, reason, False)
    question = Question(f, G, tuple(x), x_star, chosen, cheap)
    try:
        return _structure(question, A, name, units or {}, domain or {})
    except Undecided as unknown:
        reason = f"no proof was found whether {unknown} is zero"
    except ModelError as problem:
        reason = problem.fault
    return NoStructure(_FAMILY, reason, False)


def _structure(
    question: Question,
    A: sp.Matrix,
    name: str,
    units: Mapping[str, str],
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]],
) -> Matching | NoStructure:
    """The first proposal that is proved, or why there is none."""
    x_star = question.x_star
    if question.annihilator.rows == 0:
        return NoStructure(_FAMILY, "every state has an input of its own", False)
    still = [is_zero(value_at(entry, x_star)) for entry in question.s]
    if False in still:
        return NoStructure(_FAMILY, "the target is no equilibrium", True)
    if None in still:
        return NoStructure(_FAMILY, "the target is not proved to be an equilibrium", False)
    conserved = not nothing_is_conserved(question.slopes, x_star)
    if uncontrollable_growth(A, question.G, conserved):
        reason = "no structure: a mode that no input reaches does not decay at the target"
        return NoStructure(_FAMILY, reason, True)
    if conserved:
        reason = "it is not tried, because a combination of states may stay whatever the inputs do"
        return NoStructure(_FAMILY, reason, False)
    reason = (
        "no constant F_d was found for which f + G u₀ = F_d∇H₀ with a minimum of H₀ at the target"
    )
    if sum(map(complexity, question.slopes)) > _LONGEST:
        reason = (
            "it is not tried, because the equations of the states without an input are too long"
        )
        tried: Iterator[Iterator[Proposal]] = iter(())
    else:
        tried = candidates(question)
    for proposals in tried:
        proposal = next((p for p in proposals if question.proved(p.B)), None)
        if proposal is None:
            continue
        matching = _matching(question, proposal, name, units, domain)
        if isinstance(matching, Matching):
            return matching
        reason = matching
    if no_constant_structure(question.slopes, question.annihilator, x_star):
        return NoStructure(_FAMILY, "there is no constant F_d in these coordinates", True)
    return NoStructure(_FAMILY, reason, False)


def _matching(
    question: Question,
    proposal: Proposal,
    name: str,
    units: Mapping[str, str],
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]],
) -> Matching | str:
    """The structure of a proved B, or why it could not be written down."""
    B = proposal.B
    energy = energy_of(question, B)
    if energy is None:
        return "B∇H₀ = s has no closed form that was found"
    N = _of_one_size(kernel(B))
    H = with_minimum(question, B, N, energy, proposal.P)
    if H is None:
        return "∇²H₀ is not proved to be positive definite"
    F, G = _completed(question, B, proposal.F), question.G
    inverse = (G.T * G).inv() * G.T
    u0 = inverse * (F * sp.Matrix(gradient(H, question.x)) - question.f)
    alpha = -inverse * F * N
    away = sp.Matrix([v - question.x_star[v] for v in question.x])
    shaping = (N * alpha.inv()).T * away if alpha.rank() == alpha.rows else sp.zeros(0, 1)
    matching = Matching(
        ahead=Preliminary(
            sp.ImmutableMatrix(question.f),
            sp.ImmutableMatrix(G),
            sp.ImmutableMatrix(u0.applyfunc(written)),
            sp.ImmutableMatrix(sp.eye(G.cols)),
        ),
        plant=make_plant(
            question.x, (F - F.T) / 2, -(F + F.T) / 2, G, H, name=name, units=units, domain=domain
        ),
        shaping=tuple(sp.expand(entry) for entry in shaping),
    )
    return matching if matching.holds else "the matching equations could not be proved"


def _of_one_size(N: sp.Matrix) -> sp.Matrix:
    """Columns times powers of two, with entries of order 1: those of a kernel are long integers."""
    scale = []
    for k in range(N.cols):
        entries = [e for e in N[:, k] if isinstance(e, sp.Rational)]
        largest = max(entries, key=lambda e: abs(e), default=sp.Integer(1))
        bits = abs(int(largest.p)).bit_length() - int(largest.q).bit_length()
        scale.append(sp.Rational(1, 2**bits) if bits >= 0 else sp.Integer(2**-bits))
    return N * sp.diag(*scale)


def _completed(question: Question, B: sp.Matrix, like: Vector | None) -> sp.Matrix:
    """F_d with G⊥F_d = B: near the one of a proposal, where that is proved to be dissipative.

    Else with a skew coupling, and dissipation on the actuated directions.
    """
    T, Ti = question.T, question.T.inv()
    row, G, sized = question.annihilator * T, Ti * question.G, B * Ti
    frame = sp.Matrix.vstack(row, G.T).inv()
    upper = (sized * row.T).row_join(sized * G)

    def with_rows(lower: sp.Matrix) -> sp.Matrix:
        return T * frame * upper.col_join(lower) * frame.T * T

    if like is not None:
        inputs = float_matrix(G)
        wanted = inputs.T @ like @ np.hstack([float_matrix(row).T, inputs])
        unit = power_of_two(float(np.abs(wanted).max()))
        skew, losses = -(sized * G).T, dissipation(B, question.annihilator)
        for digits in DIGITS[1:]:
            lower = unit * rounded(wanted / to_float(unit), digits)
            for i in range(row.rows):
                if losses[i, i] == 0:  # then nothing stands beside it in −(F + Fᵀ) ⪰ 0
                    lower[:, i] = skew[:, i]
            F = with_rows(lower)
            if definiteness(-(F + F.T))[0] in ("positive", "flat"):
                return F
    rate = power_of_two(float(np.abs(float_matrix(sized)).max()))
    return with_rows((-(sized * G).T).row_join(-rate * G.T * G))
