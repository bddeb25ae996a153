"""Closed forms of Casimirs: a linear solve over functions that occur in the model.

The unknown is C = Σ aₖφₖ(z) with rational aₖ. At points of a finite field ∇CᵀM = 0 is a linear
system in a; its null vectors are candidates, and each is proved symbolically before it is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import sympy as sp

from necc_casadi.casimirs.condition import independent, is_casimir
from necc_casadi.casimirs.integrability import integrated_kernel
from necc_casadi.casimirs.vocabulary import (
    MOST_WORDS,
    angles,
    occurring,
    products,
    rotation_angles,
    times,
    trig_products,
    unique,
)
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.derivatives import value_at
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.finite_field import NoFiniteFieldValue, Residues, values
from necc_casadi.symbolic.linear_algebra import constant_kernel
from necc_casadi.symbolic.modular import null_basis, nullspace, pivots, rank

__all__ = ["CasimirSearch", "ClosedForm", "find_closed_forms"]


_MOST_PROOFS = 40


#: Only the constant sub-kernel, only single functions of the model, or everything.
Effort = Literal["constant", "quick", "full"]


class ClosedForm(NamedTuple):
    """A Casimir that is proved."""

    function: sp.Expr  # of z
    origin: str  # how it was found


@dataclass(frozen=True, eq=False)
class CasimirSearch:
    """A loop whose Casimirs are sought; what the search needs is computed once."""

    loop: ClosedLoop
    kernel_rank: int
    target: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)

    @cached_property
    def support(self) -> tuple[sp.Symbol, ...]:
        """The states on which a Casimir can depend: nonzero in some vector of the kernel."""
        M, z = self.loop.M, self.loop.z
        if self.kernel_rank == 0:
            return ()
        table = values(list(M), 1)[0].reshape(M.shape)
        basis = null_basis(table.T)
        return tuple(s for i, s in enumerate(z) if np.any(basis[:, i]))

    @cached_property
    def columns(self) -> list[list[tuple[int, sp.Expr]]]:
        """Nonzero entries (row, value) of the columns of M that span its image generically."""
        M = self.loop.M
        table: dict[int, list[tuple[int, sp.Expr]]] = {
            j: [] for j in pivots(values(list(M), 1)[0].reshape(M.shape))
        }
        for (i, j), entry in M.todok().items():
            if j in table:
                table[j].append((i, entry))
        return list(table.values())

    @cached_property
    def functions(self) -> list[sp.Expr]:
        """Functions of the support that occur in M, their partners, powers and primitives."""
        return occurring(self.loop.M.todok().values(), self.support)

    @cached_property
    def energy_functions(self) -> list[sp.Expr]:
        """Functions of the support that occur in H as well."""
        terms = sp.Add.make_args(sp.expand(self.loop.plant.H))
        return [f for f in occurring(terms, self.support) if f not in self.functions]

    def has_pole(self, c: sp.Expr) -> bool:
        """Whether `c` or its gradient is not finite at the target."""
        for part in (c, *[sp.diff(c, s) for s in c.free_symbols]):
            if not is_finite(value_at(part, self.target)):
                return True
        return False


def find_closed_forms(
    search: CasimirSearch, forms: list[ClosedForm], wanted: int, effort: Effort = "full"
) -> None:
    """Append proved, independent Casimirs to `forms` until there are `wanted`."""
    if len(forms) >= wanted:
        return
    try:
        if effort == "constant":
            forms.extend(ClosedForm(c, "constant kernel") for c in _linear(search))
            return
        for candidates, origin in _proposals(search):
            _adopt(search, forms, wanted, candidates, origin)
            if len(forms) >= wanted or effort == "quick":
                return
    except NoFiniteFieldValue:
        return


def _proposals(search: CasimirSearch) -> Iterable[tuple[list[sp.Expr], str]]:
    """Candidates from growing sets of functions, simplest first; not yet proved."""
    for words, origin in _vocabularies(search):
        yield _solutions(search, words), origin
    yield integrated_kernel(search.loop), "integrated one-form"


def _vocabularies(search: CasimirSearch) -> Iterable[tuple[list[sp.Expr], str]]:
    variables, functions = list(search.support), search.functions
    rotations = rotation_angles(sp.Matrix(search.loop.M), search.loop.z)
    single = unique([*variables, *_with_constants(search, variables), *functions, *rotations])
    yield single, "functions of the model"
    turning = angles(functions)
    trig = trig_products(turning)
    if trig:
        yield unique([*variables, *trig, *times(variables, trig)]), "trigonometric ansatz"
        # A yaw angle does not occur in M: where there are angles, every state may be one.
        every = list(dict.fromkeys([*turning, *variables]))
        yield unique([*variables, *trig_products(every)]), "trigonometric ansatz"
    yield _with_products(single, (2,)), "ansatz of degree 2"
    yield _with_products(single, (2, 3)), "ansatz of degree 3"
    yield _with_products([*single, *search.energy_functions], (2,)), "ansatz of degree 2"
    powers = [s**k for s in variables for k in range(1, 5)]
    mixed = products(variables, (2, 3, 4))
    yield [] if mixed is None else unique([*powers, *mixed]), "polynomial"


def _with_products(words: Sequence[sp.Expr], degrees: Sequence[int]) -> list[sp.Expr]:
    """The words and their products, none where those are too many."""
    words = unique(words)
    more = products(words, degrees)
    return [] if more is None else unique([*words, *more])


def _with_constants(search: CasimirSearch, variables: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """κ·zᵢ for the irrational constants κ that occur: coefficients are sought among rationals."""
    constants = {
        part
        for entry in search.loop.M.todok().values()
        for part in sp.preorder_traversal(entry)
        if part.is_number and not part.is_Rational and (part.is_Atom or part.is_Pow)
    }
    return [k * s for k in sorted(constants, key=str)[:4] for s in variables]


def _linear(search: CasimirSearch) -> list[sp.Expr]:
    """All constant v with vᵀM(z) ≡ 0, as vᵀz with the reduced-echelon basis."""
    z = search.loop.z
    basis = constant_kernel(sp.Matrix(search.loop.M).T)
    return [
        sp.Add(*[basis[i, k] * s for i, s in enumerate(z) if basis[i, k] != 0])
        for k in range(basis.cols)
    ]


def _solutions(search: CasimirSearch, words: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Candidates among the combinations of words; none where the words are too many."""
    if len(words) > MOST_WORDS:
        return []
    vectors = _null_vectors(search, words)
    return [
        _normalised(
            sp.Add(*[a * w for a, w in zip(v, words, strict=True) if a != 0]), search.loop.z
        )
        for v in vectors
    ]


def _normalised(c: sp.Expr, z: Sequence[sp.Symbol]) -> sp.Expr:
    """First linear term with coefficient 1, as in q − ξ; else primitive integer coefficients."""
    if c.is_polynomial(*z):
        c = sp.expand(c)
    content, part = c.primitive()
    c = sp.Add(*sp.Add.make_args(part)) if content != 0 else c
    terms = [t.as_coeff_Mul() for t in sp.Add.make_args(c)]
    linear = {unit: coefficient for coefficient, unit in terms if unit in z}
    if linear:
        leading = next(linear[s] for s in z if s in linear)
        return sp.Add(*[coefficient / leading * unit for coefficient, unit in terms])
    return -c if c.could_extract_minus_sign() else c


def _null_vectors(search: CasimirSearch, words: Sequence[sp.Expr]) -> list[list[sp.Rational]]:
    """Rational a with ∇(Σ aₖφₖ)ᵀM = 0 at random points of several finite fields."""
    if not words:
        return []
    per_point = max(1, len(search.support) - search.kernel_rank)
    points = 13 * len(words) // (10 * per_point) + 6
    z = search.loop.z
    place = {s: i for i, s in enumerate(z)}
    slopes = [(k, place[s], slope(w, s)) for k, w in enumerate(words) for s in _states(w)]
    used = {i for _, i, _ in slopes}
    entries = [(i, j, e) for j, column in enumerate(search.columns) for i, e in column if i in used]
    shape = (points, len(z), len(search.columns), len(words))
    return nullspace(lambda prime: _system(slopes, entries, shape, prime))


def _states(word: sp.Expr) -> list[sp.Symbol]:
    return sorted(word.free_symbols, key=str)


def slope(word: sp.Expr, s: sp.Symbol) -> sp.Expr:
    """∂word/∂s; a product is left unexpanded, which is what the numerical evaluation wants."""
    if word.is_Mul:
        touched = [f for f in word.args if s in f.free_symbols]
        if len(touched) == 1:
            rest = [f for f in word.args if f is not touched[0]]
            return sp.Mul(sp.diff(touched[0], s), *rest, evaluate=False)
    return sp.diff(word, s)


def _system(
    slopes: Sequence[tuple[int, int, sp.Expr]],
    entries: Sequence[tuple[int, int, sp.Expr]],
    shape: tuple[int, int, int, int],
    prime: int,
) -> Residues:
    """Rows (point, column j of M), columns k: Σᵢ Mᵢⱼ ∂ᵢφₖ.

    `slopes` holds (k, i, ∂ᵢφₖ), `entries` holds (i, j, Mᵢⱼ), `shape` the numbers of points, of
    states, of columns j and of functions φ.
    """
    points, states, columns, words = shape
    residues = values([e for *_, e in slopes] + [e for *_, e in entries], points, prime=prime)
    gradient = np.zeros((points, states, words), dtype=np.int64)
    for at, (k, i, _) in enumerate(slopes):
        gradient[:, i, k] = residues[:, at]
    result = np.zeros((points, columns, words), dtype=np.int64)
    for at, (i, j, _) in enumerate(entries):
        weight = residues[:, len(slopes) + at][:, None]
        result[:, j, :] = (result[:, j, :] + weight * gradient[:, i, :]) % prime
    flat = result.reshape(-1, words)
    return flat[np.any(flat != 0, axis=1)] if np.any(flat) else flat[:1]


def _adopt(
    search: CasimirSearch,
    forms: list[ClosedForm],
    wanted: int,
    candidates: Sequence[sp.Expr],
    origin: str,
) -> None:
    """Take candidates that are new and proved: finite and regular at the target first."""
    known = [form.function for form in forms]
    new: list[sp.Expr] = []
    for c in sorted(candidates, key=lambda c: len(sp.Add.make_args(c))):
        if len(new) < _MOST_PROOFS and independent(known, c, search.loop.z):
            new.append(c)
    ordered = sorted(new, key=search.has_pole)
    for regular_only in (True, False):
        for c in ordered:
            if len(forms) >= wanted:
                return
            known = [form.function for form in forms]
            if regular_only and not _regular(search, [*known, c]):
                continue
            if independent(known, c, search.loop.z) and is_casimir(c, search.loop):
                forms.append(ClosedForm(c, origin))


def _regular(search: CasimirSearch, functions: Sequence[sp.Expr]) -> bool:
    """Whether the gradients are independent at the target, for generic ξ."""
    if not search.target:
        return False
    z = search.loop.z
    entries = [
        sp.diff(f, s) if s in f.free_symbols else sp.Integer(0) for f in functions for s in z
    ]
    entries = [value_at(e, search.target) for e in entries]
    if not all(map(is_finite, entries)):
        return False
    try:
        table = values(entries, 1).reshape(len(functions), len(z))
    except NoFiniteFieldValue:
        return False
    return rank(table) == len(functions)
