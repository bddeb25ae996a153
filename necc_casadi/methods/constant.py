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
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import ModelError
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.methods.refutation import (
    no_constant_structure,
    nothing_is_conserved,
    uncontrollable_growth,
)
from necc_casadi.methods.semidefinite_program import SemidefiniteProgram
from necc_casadi.methods.structure_family import combined, dissipation, reduced, symmetry_rows
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.matching import Matching
from necc_casadi.model.plant import make_plant
from necc_casadi.symbolic.definiteness import definiteness, rational
from necc_casadi.symbolic.derivatives import at, gradient, sparse_hessian, value_at
from necc_casadi.symbolic.expressions import complexity, split_logarithms
from necc_casadi.symbolic.floats import float_matrix, to_float
from necc_casadi.symbolic.linear_algebra import constant_kernel, kernel, reduced_rows, tidy
from necc_casadi.symbolic.primitive import primitive
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = ["constant_structure"]


_FAMILY = "constant F_d"

#: Shares of the fastest rate by which dissipation is asked to exceed zero, the largest first.
_MARGINS = (0.1, 0.01, 1e-3, 0.0)

#: Decimal digits to which proposals are rounded, the fewest first.
_DIGITS = (2, 3, 5, 8, 12)

#: Share of a vector across another one below which it is taken as rounding.
_PARALLEL = 1e-9

#: Sizes whose squares and their ratios are doubles.
_FARTHEST = sp.Integer(2) ** 200

#: States beyond which expressions take minutes.
_LARGEST = 16

#: Symbols, powers and functions in ∂s/∂x beyond which proofs of what is symmetric take minutes:
#: about those of four links.
_LONGEST = 10_000

#: States beyond which subsets of coordinates are not tried one after another.
_MOST_STATES = 6


@dataclass(frozen=True, eq=False)
class _Question:
    """ẋ = f + G u at an equilibrium, in units in which every state has a natural size."""

    f: sp.Matrix  # n × 1
    G: sp.Matrix  # n × m, constant
    x: tuple[sp.Symbol, ...]
    x_star: Mapping[sp.Symbol, sp.Expr]
    sizes: tuple[sp.Rational, ...]  # (n,) powers of two
    cheap: Vector | None = None  # (m, n) gains of LQR, in the units of the model

    @property
    def T(self) -> sp.Matrix:
        """The sizes as a diagonal matrix."""
        return sp.diag(*self.sizes)

    @cached_property
    def annihilator(self) -> sp.Matrix:
        """G⊥, its rows scaled to about 1 in natural units."""
        rows = kernel(self.G.T).T
        sized = float_matrix(rows * self.T)
        scale = [_power_of_two(1 / float(np.linalg.norm(row))) for row in sized]
        return sp.diag(*scale) * rows if scale else rows

    @cached_property
    def s(self) -> sp.Matrix:
        """G⊥f."""
        return (self.annihilator * self.f.applyfunc(split_logarithms)).applyfunc(sp.expand)

    @cached_property
    def slopes(self) -> sp.Matrix:
        """∂s/∂x."""
        return sp.Matrix(self.s).jacobian(self.x)

    @cached_property
    def slopes_there(self) -> sp.Matrix:
        """∂s/∂x at x*."""
        return sp.Matrix(at(self.slopes, self.x_star))

    @property
    def inputs(self) -> Vector:
        """G, in natural units, its columns scaled to 1."""
        G = float_matrix(self.T.inv() * self.G)
        return np.asarray(G / np.linalg.norm(G, axis=0), float)

    @cached_property
    def cheap_loop(self) -> Vector | None:
        """A − GK of LQR, in natural units."""
        if self.cheap is None:
            return None
        size = np.diag(float_matrix(self.T))
        A = float_matrix(at(self.f.jacobian(self.x), self.x_star))
        return np.asarray((A - float_matrix(self.G) @ self.cheap) * size / size[:, None], float)

    @cached_property
    def rate(self) -> float:
        """The fastest rate of the linearised plant, in natural units."""
        A = float_matrix(at(self.f.jacobian(self.x), self.x_star) * self.T)
        return float(np.linalg.norm(A / np.diag(float_matrix(self.T))[:, None], 2)) or 1.0

    def proved(self, B: sp.Matrix) -> bool:
        """Whether (ii) and (iii) are proved; (i) holds by the family that B is taken from."""
        curved = B * self.slopes_there.T
        if definiteness((curved + curved.T) / 2)[0] != "positive":
            return False
        return definiteness(dissipation(B, self.annihilator))[0] in ("positive", "flat")


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
    chosen = tuple(_sizes(x, A, sizes or {}, domain or {}))
    if not all(1 / _FARTHEST < size < _FARTHEST for size in chosen):
        reason = "the sizes of the states are too far from 1 for floating point"
        return NoStructure(_FAMILY, reason, False)
    question = _Question(f, G, tuple(x), x_star, chosen, cheap)
    try:
        return _structure(question, A, name, units or {}, domain or {})
    except Undecided as unknown:
        reason = f"no proof was found whether {unknown} is zero"
    except ModelError as problem:
        reason = problem.fault
    return NoStructure(_FAMILY, reason, False)


def _structure(
    question: _Question,
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
        tried: Iterator[Iterator[_Proposal]] = iter(())
    else:
        tried = _candidates(question)
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


@dataclass(frozen=True, eq=False)
class _Proposal:
    """B, exact, and what it was made with, in natural units."""

    B: sp.Matrix
    P: Vector | None = None  # (n, n) ∇²H₀(x*)⁻¹; None: any
    F: Vector | None = None  # (n, n) F_d; None: any


def _candidates(question: _Question) -> Iterator[Iterator[_Proposal]]:
    """For each proposal its roundings B, which satisfy (i)."""
    if question.annihilator.rows == 1:
        for roundings in _single_rows(question):
            yield map(_Proposal, roundings)
        return
    family = [
        B / _power_of_two(float(np.abs(float_matrix(B * question.T.inv())).max()))
        for B in reduced(_symmetric_family(question), question.annihilator)
    ]
    if not family:
        return
    if question.cheap_loop is not None:
        for margin in _MARGINS:
            found = _well_conditioned(question, family, margin, question.cheap_loop)
            if found is not None:
                weights, P = found
                yield _cheap_proposals(family, weights, P / question.rate, question.cheap_loop)
                break
    for margin in _MARGINS:
        found = _well_conditioned(question, family, margin)
        if found is not None:
            yield (_Proposal(combined(family, w)) for w in _roundings(found[0]))


def _cheap_proposals(
    family: Sequence[sp.Matrix], weights: Vector, P: Vector, closed: Vector
) -> Iterator[_Proposal]:
    """Proposals with F_d = (A − GK)P, so that F_d ∇²H₀ = A − GK."""
    scale = np.abs(weights).max()
    for rounded in _roundings(weights, 1):
        yield _Proposal(combined(family, rounded), P / scale, closed @ P / scale)


def _roundings(values: Vector, first: int = 0) -> Iterator[list[sp.Expr]]:
    """The values, up to a common factor, to more and more digits."""
    scaled = values / np.abs(values).max()
    for digits in _DIGITS[first:]:
        yield [rational(float(v), 10**digits) for v in scaled]


def _single_rows(question: _Question) -> Iterator[Iterator[sp.Matrix]]:
    """One unactuated direction: b with b·∇s(x*) > 0 > b·g⊥, by linear algebra.

    ∇s = κg⊥ + w with w ⊥ g⊥ in natural units. For κ < 0 ∇s itself will do; otherwise b is ∇s less
    enough of g⊥. Then the same on fewer coordinates, where quadratures are simpler.
    """
    T = question.T
    slope, row = question.slopes_there * T, question.annihilator * T
    n = len(question.x)
    for size in range(n, 0, -1) if n <= _MOST_STATES else (n,):
        for kept in combinations(range(n), size):
            mask = sp.diag(*[int(k in kept) for k in range(n)])
            a, g = float_matrix(slope * mask)[0], float_matrix(row * mask)[0]
            b = _between(a, g)
            if b is not None:
                yield (sp.Matrix([exact]) * T for exact in _roundings(b))


def _between(a: Vector, g: Vector) -> Vector | None:
    """Find b with b·a > 0 > b·g, midway; None where a = κg, κ ≥ 0."""
    length = float(np.linalg.norm(g))
    if length == 0:
        return a if np.any(a) else None
    unit = g / length
    kappa = float(a @ unit)
    across = a - kappa * unit
    w = float(np.linalg.norm(across))
    if kappa < 0:
        return a
    if w <= _PARALLEL * float(np.linalg.norm(a)):
        return None
    return across - min(w / 2, w**2 / (2 * kappa) if kappa else w / 2) * unit


def _symmetric_family(question: _Question) -> list[sp.Matrix]:
    """A basis of constant B with a symmetric S for all x, each one proved."""
    basis = constant_kernel(symmetry_rows(question.slopes))
    shape = question.slopes.shape
    return [sp.Matrix(*shape, list(basis[:, k])) for k in range(basis.cols)]


def _well_conditioned(
    question: _Question,
    family: Sequence[sp.Matrix],
    margin: float,
    closed: Vector | None = None,
) -> tuple[Vector, Vector] | None:
    """Weights of the family with B = G⊥AP, I ⪯ P ⪯ κI and the least κ, in natural units, and P.

    With a loop ẋ = closed·x of the linearised plant, P⁻¹ is to be a Lyapunov function of it too.
    """
    size = np.diag(float_matrix(question.T))
    row = float_matrix(question.annihilator * question.T)
    slope = float_matrix(question.slopes_there * question.T) / question.rate
    members = np.array([float_matrix(B) / size for B in family])
    r, n = row.shape
    units = [(i, j) for i in range(n) for j in range(i + 1)]
    count, width = len(members), len(members) + len(units) + 1
    P = np.zeros((width, n, n))
    for k, (i, j) in enumerate(units):
        P[count + k, i, j] = P[count + k, j, i] = 1.0
    top, losing = np.zeros((width, n, n)), np.zeros((width, r, r))
    top[-1] = np.eye(n)
    products = members @ row.T
    losing[:count] = -(products + products.transpose(0, 2, 1))
    free = [np.abs(losing[:, i, i]).max() > 0 for i in range(r)]
    equations = []
    for i in range(r):
        for j in range(n):
            entry = np.zeros(width)
            entry[:count] = members[:, i, j]
            entry -= np.einsum("k,wk->w", slope[i], P[:, :, j])
            equations.append((entry, 0.0))
    inequalities = [
        (-np.eye(n), P),
        (np.zeros((n, n)), top - P),
        (-margin * np.diag(np.array(free, float)), losing),
    ]
    if closed is not None:
        frame = np.hstack([row.T, question.inputs])
        falling = -frame.T @ (closed @ P + P @ closed.T) @ frame / question.rate
        kept = np.array([*np.flatnonzero(free), *range(r, n)])
        inequalities.append((-margin * np.eye(len(kept)), falling[:, kept][:, :, kept]))
        lossless = [i for i in range(r) if not free[i]]
        equations += [(falling[:, i, j], 0.0) for i in lossless for j in range(r, n)]
    found = SemidefiniteProgram(np.eye(width)[-1], inequalities, equations).solution()
    return None if found is None else (found[:count], np.einsum("k,kij->ij", found, P))


def _matching(
    question: _Question,
    proposal: _Proposal,
    name: str,
    units: Mapping[str, str],
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]],
) -> Matching | str:
    """The structure of a proved B, or why it could not be written down."""
    B = proposal.B
    energy = _energy(question, B)
    if energy is None:
        return "B∇H₀ = s has no closed form that was found"
    N = _of_one_size(kernel(B))
    H = _with_minimum(question, B, N, energy, proposal.P)
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
            sp.ImmutableMatrix(u0.applyfunc(_tidy)),
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


def _tidy(expr: sp.Expr) -> sp.Expr:
    return sp.expand(expr) if expr.is_polynomial() else sp.factor_terms(sp.cancel(expr))


def _energy(question: _Question, B: sp.Matrix) -> sp.Expr | None:
    """H₀ with B∇H₀ = s: along x = Bᵀw + Vc, with units V off the pivots of B, ∂H₀/∂wᵢ = sᵢ."""
    r, n = B.shape
    pivots = reduced_rows(B)[1]
    rest = [j for j in range(n) if j not in pivots]
    w = [sp.Dummy(f"w{i}", real=True) for i in range(r)]
    c = [sp.Dummy(f"c{j}", real=True) for j in rest]
    V = sp.eye(n).extract(list(range(n)), rest)
    inside = B.T * sp.Matrix(w) + (V * sp.Matrix(c) if rest else sp.zeros(n, 1))
    forward = dict(zip(question.x, inside, strict=True))
    total: sp.Expr = sp.Integer(0)
    back = B.extract(list(range(r)), pivots).T.inv() * sp.Matrix(question.x).extract(pivots, [0])
    off = sp.Matrix(question.x) - B.T * back
    values = dict(zip([*w, *c], [*back, *(off[j] for j in rest)], strict=True))
    there = {symbol: value_at(value, question.x_star) for symbol, value in values.items()}
    for i, s in enumerate(w):
        missing = question.s[i].subs(forward, simultaneous=True) - sp.diff(total, s)
        # equal for all w₁ … wᵢ₋₁, even where that does not show
        missing = missing.subs({w[k]: value_at(back[k], question.x_star) for k in range(i)})
        part = _integral(missing, s)
        if part is None:
            return None
        total += _of_real_logarithms(part, there)
    return _in_partial_fractions(total.subs(values, simultaneous=True), question.x)


def _in_partial_fractions(H: sp.Expr, x: Sequence[sp.Symbol]) -> sp.Expr:
    """The same sum with short numerators: over one denominator, enclosures of it are wide."""
    names = {e: sp.Dummy() for e in H.atoms(sp.Function) if e.free_symbols}
    total: sp.Expr = sp.Integer(0)
    for term in sp.Add.make_args(H.xreplace(names)):
        below = sp.denom(sp.together(term)).free_symbols & set(x)
        total += sp.apart(term, below.pop()) if len(below) == 1 else _tidy(term)
    return total.xreplace({name: e for e, name in names.items()})


def _of_real_logarithms(expr: sp.Expr, there: Mapping[Any, sp.Expr]) -> sp.Expr:
    """A primitive whose logarithms are real there: log(−e), as good as log(e), where e < 0."""
    negative = {e for e in expr.atoms(sp.log) if value_at(e.args[0], there).is_negative is True}
    return expr.xreplace({e: sp.log(sp.expand(-e.args[0])) for e in negative})


def _integral(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """A primitive, term by term."""
    total: sp.Expr = sp.Integer(0)
    for term in sp.Add.make_args(_flat(f)):
        part = _of_linear_argument(term, s) or primitive(term, s)
        if part is None:
            return None
        total += part
    return total


def _flat(f: sp.Expr) -> sp.Expr:
    """A sum whose functions keep their arguments in one piece."""
    names = {e: sp.Dummy() for e in f.atoms(sp.Function)}
    return sp.expand(f.xreplace(names)).xreplace({name: e for e, name in names.items()})


def _of_linear_argument(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """∫g(as + b)ds for one function g, which sympy's rules take long for with symbols in b."""
    coefficient, g = f.as_independent(s, as_Add=False)
    if not g.is_Function:
        return None
    slope = sp.diff(g.args[0], s)
    if slope == 0 or slope.has(s):
        return None
    u = sp.Dummy("u", real=True)
    inner = primitive(g.subs(g.args[0], u), u)
    return None if inner is None else coefficient / slope * inner.subs(u, g.args[0])


def _with_minimum(
    question: _Question, B: sp.Matrix, N: sp.Matrix, energy: sp.Expr, P: Vector | None
) -> sp.Expr | None:
    """H₀ with ∇H₀(x*) = 0 and ∇²H₀(x*) ≻ 0: what depends on Nᵀx is free, since BN = 0.

    In natural units, with Q = ∇²H₀, the free block is NᵀQN = CᵀS⁻¹C + σNᵀN, C = BQN, or with the
    Schur complement of P⁻¹ in place of σNᵀN.
    """
    x_star, x = question.x_star, question.x
    slope = N.T * sp.Matrix(at(gradient(energy, x), x_star))
    away = N.T * sp.Matrix([v - x_star[v] for v in x])
    gram = (N.T * N).inv()
    energy = _gathered(energy - (away.T * gram * slope)[0], x)
    Q0 = sp.Matrix(at(sparse_hessian(energy, x), x_star))
    size = np.diag(float_matrix(question.T))
    Q, rows, free = (
        float_matrix(Q0) * np.outer(size, size),
        float_matrix(B) / size,
        float_matrix(N) * size[:, None],
    )
    S, C, squares = rows @ Q @ rows.T, rows @ Q @ free, free.T @ free
    sigma, r = np.trace(S) / np.trace(rows @ rows.T), len(rows)
    beyond = sigma * squares
    if P is not None:  # the Schur complement of its inverse
        frame = np.hstack([rows.T, free])
        beyond = np.linalg.inv(np.linalg.inv(frame.T @ np.linalg.solve(P, frame))[r:, r:])
    wanted = C.T @ np.linalg.solve(S, C) + beyond - free.T @ Q @ free
    theta = np.linalg.solve(squares, np.linalg.solve(squares, wanted).T)
    scale = float(np.abs(theta).max()) or 1.0
    if not np.isfinite(scale):
        return None
    unit = _power_of_two(scale)
    shares = (theta + theta.T) / (2 * to_float(unit))
    for digits in _DIGITS:
        exact = unit * _rounded(shares, digits)
        if definiteness(Q0 + N * exact * N.T)[0] == "positive":
            return _gathered(energy + (away.T * exact * away)[0] / 2, x)
    return None


def _gathered(H: sp.Expr, x: Sequence[sp.Symbol]) -> sp.Expr:
    """`H` with one coefficient for each product of states and functions of them."""
    names = {e: sp.Dummy() for e in H.atoms(sp.Function) if e.free_symbols}
    flat = H.xreplace(names)
    variables = [*x, *names.values()]
    if not flat.is_polynomial(*variables):
        return sp.expand(H)
    terms = sp.Poly(flat, *variables).terms()
    products = [
        sp.Mul(*[v**k for v, k in zip(variables, powers, strict=True)]) for powers, _ in terms
    ]
    total = sp.Add(*[tidy(a) * p for (_, a), p in zip(terms, products, strict=True) if p != 1])
    return total.xreplace({name: e for e, name in names.items()})


def _completed(question: _Question, B: sp.Matrix, like: Vector | None) -> sp.Matrix:
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
        unit = _power_of_two(float(np.abs(wanted).max()))
        skew, losses = -(sized * G).T, dissipation(B, question.annihilator)
        for digits in _DIGITS[1:]:
            lower = unit * _rounded(wanted / to_float(unit), digits)
            for i in range(row.rows):
                if losses[i, i] == 0:  # then nothing stands beside it in −(F + Fᵀ) ⪰ 0
                    lower[:, i] = skew[:, i]
            F = with_rows(lower)
            if definiteness(-(F + F.T))[0] in ("positive", "flat"):
                return F
    rate = _power_of_two(float(np.abs(float_matrix(sized)).max()))
    return with_rows((-(sized * G).T).row_join(-rate * G.T * G))


def _rounded(values: Vector, digits: int) -> sp.Matrix:
    return sp.Matrix([[rational(float(v), 10**digits) for v in row] for row in values])


def _sizes(
    x: Sequence[sp.Symbol],
    A: sp.Matrix,
    given: Mapping[sp.Symbol, float],
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]],
) -> list[sp.Rational]:
    """Powers of two near the sizes of the states.

    Those that nobody gave fit the others best: within the mean time τ of the plant's modes a state
    moves another one by its size, sᵢ = τ|aᵢⱼ|sⱼ. A common factor does not matter.
    """
    known: dict[int, float] = {}
    for i, s in enumerate(x):
        if s in given:
            known[i] = float(given[s])
        elif str(s) in domain:
            lo, hi = domain[str(s)]
            known[i] = to_float(hi - lo) / 4
    rates = float_matrix(A)
    modes = np.abs(np.linalg.eigvals(rates))
    modes = modes[modes > _PARALLEL * modes.max()]
    rate = float(np.exp(np.mean(np.log(modes)))) if len(modes) else 1.0
    pairs = [(i, j) for i, j in np.argwhere(rates) if i != j]
    unknown = np.zeros((len(pairs), len(x)))
    for row, (i, j) in zip(unknown, pairs, strict=True):
        row[i], row[j] = 1.0, -1.0
    ratios = np.array([np.log(abs(rates[i, j]) / rate) for i, j in pairs])
    size = np.array([np.log(known.get(i, 1.0)) for i in range(len(x))])
    free = [i for i in range(len(x)) if i not in known]
    if pairs and free:
        rest = ratios - unknown @ size
        size[free] += np.linalg.lstsq(unknown[:, free], rest, rcond=None)[0]
    return [_power_of_two(float(value)) for value in np.exp(size)]


def _power_of_two(value: float) -> sp.Rational:
    """The nearest power of two, exact in binary and in decimal."""
    exponent = round(float(np.log2(value)))
    return sp.Rational(2**exponent) if exponent >= 0 else sp.Rational(1, 2**-exponent)
