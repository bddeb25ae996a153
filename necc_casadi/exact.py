"""Exact decisions on symbolic scalars and matrices: zero, sign, rank, definiteness.

Each answer is True (proved), False (refuted) or None (not decided); None is
never turned into a yes. Refutations come from exact values or from
high-precision values far from zero, proofs from symbolic algebra.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import sympy as sp
from sympy.polys.matrices import DomainMatrix

from necc_casadi.specialise import Unspecialised, nullspace, rank, real_rank, values

__all__ = [
    "blocks",
    "constant_kernel",
    "generic_rank",
    "has_rank",
    "is_positive_semidefinite",
    "is_zero",
    "kernel",
    "normal_form",
    "random_point",
    "reduced_rows",
    "sign",
]

_DIGITS = 40
_PROBES = 3
_LONG = 40  # operations of a constant beyond which a shorter form is not sought


def random_point(
    symbols: Iterable[sp.Symbol],
    seed: int = 0,
    box: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]] | None = None,
) -> dict[sp.Symbol, sp.Rational]:
    """Rational values, one per symbol: inside `box` where it names the symbol, else in [-2, 2].

    Symbols that are declared positive stay positive.
    Denominators are primes near 1000, so that a generic property holds there unless unlucky.
    """
    rng = random.Random(seed)
    point = {}
    for symbol in sorted(symbols, key=str):
        lowest = sp.Rational(1, 8) if symbol.is_positive else sp.Integer(-2)
        lo, hi = (box or {}).get(symbol, (lowest, sp.Integer(2)))
        lo, hi = sp.Rational(str(sp.N(lo, 17))), sp.Rational(str(sp.N(hi, 17)))
        fraction = sp.Rational(rng.randrange(1, 1009), 1009)
        point[symbol] = sp.Rational(str(sp.N(lo + (hi - lo) * fraction, 8)))
    return point


@lru_cache(maxsize=65536)
def sign(expr: sp.Expr) -> int | None:
    """Sign of a real constant, exactly: -1, 0 or 1; None where it is not a finite real number."""
    expr = sp.sympify(expr)
    if expr.is_Rational:
        return int(sp.sign(expr))
    if not expr.is_number or expr.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
        return None
    value = _probe(expr)
    if value is None or abs(sp.im(value)) > sp.Float(10) ** (-_DIGITS // 2):
        return None
    if abs(value) > sp.Float(10) ** (-_DIGITS // 2):
        return 1 if sp.re(value) > 0 else -1
    if sp.simplify(expr) == 0 or expr.equals(0):
        return 0
    value = sp.re(expr.evalf(1000, maxn=5000))  # a very small number that is not zero?
    if value.is_comparable and value != 0 and abs(value) > sp.Float(10) ** -900:
        return 1 if value > 0 else -1
    return None


def _probe(expr: sp.Expr) -> sp.Expr | None:
    value = expr.evalf(_DIGITS, maxn=4 * _DIGITS)
    return value if value.is_number and value.is_finite is not False and value != sp.nan else None


@lru_cache(maxsize=65536)
def is_zero(expr: sp.Expr) -> bool | None:
    """Whether `expr` vanishes identically in its symbols."""
    expr = sp.sympify(expr)
    if expr == 0:
        return True
    if not expr.free_symbols:
        value = sign(expr)
        return None if value is None else value == 0
    for seed in range(_PROBES):
        value = _probe(expr.subs(random_point(expr.free_symbols, seed)))
        if value is None or not _is_small(sp.im(value)):
            continue  # outside the domain of a root or a logarithm: shows nothing
        if not _is_small(value):
            return False
    attempts = (sp.expand, normal_form, sp.trigsimp, sp.simplify)
    return True if any(attempt(expr) == 0 for attempt in attempts) else None


def normal_form(expr: sp.Expr) -> sp.Expr:
    """A numerator of `expr` in which sums of angles, sin² + cos² = 1 and exp(a + b) are resolved.

    It is 0 for every rational function of the states, of sines and cosines of their rational
    combinations and of exponentials that vanishes identically.
    """
    expr = expr.replace(
        lambda e: isinstance(e, (sp.sinh, sp.cosh, sp.tanh)), lambda e: e.rewrite(sp.exp)
    )
    expr = expr.replace(
        lambda e: isinstance(e, sp.tan), lambda e: sp.sin(*e.args) / sp.cos(*e.args)
    )
    expr = _whole_angles(expr)
    expr = sp.expand_trig(expr) if expr.has(sp.sin, sp.cos) else expr
    expr = sp.expand_power_exp(expr) if expr.has(sp.exp) else expr
    angles = {f.args[0] for f in expr.atoms(sp.sin, sp.cos)}
    pairs = {a: (sp.Dummy("c"), sp.Dummy("s")) for a in angles}
    expr = expr.xreplace(
        {f: pairs[f.args[0]][int(isinstance(f, sp.sin))] for f in expr.atoms(sp.sin, sp.cos)}
    )
    result = sp.expand(sp.numer(sp.together(expr)))
    for cosine, sine in pairs.values():
        if result.has(sine) and result.is_polynomial(sine):
            result = sp.rem(result, sine**2 + cosine**2 - 1, sine)
            result = sp.expand(result)
    return result


def _whole_angles(expr: sp.Expr) -> sp.Expr:
    """`expr` with every symbol scaled so that angles and exponents have integer coefficients."""
    arguments = [f.args[0] for f in expr.atoms(sp.sin, sp.cos, sp.exp)]
    terms = [t for a in arguments for t in sp.Add.make_args(sp.expand(a))]
    factors = [t.as_coeff_Mul()[0] for t in terms]
    scale = math.lcm(*[int(f.q) for f in factors if f.is_Rational])
    if scale == 1:
        return expr.replace(
            lambda e: isinstance(e, (sp.sin, sp.cos, sp.exp)),
            lambda e: e.func(sp.expand(e.args[0])),
        )
    units = {t.as_coeff_Mul()[1] for t in terms if t.free_symbols}
    scaled = {u: scale * sp.Dummy(real=True) for u in units}
    return expr.replace(
        lambda e: isinstance(e, (sp.sin, sp.cos, sp.exp)),
        lambda e: e.func(sp.expand(sp.expand(e.args[0]).subs(scaled))),
    )


def generic_rank(matrix: sp.Matrix, tries: int = _PROBES) -> int:
    """Rank of `matrix` at generic points: the largest found at random points.

    Exact for constant matrices. For others it is the rank over a finite field at random values
    of the functions that occur, a lower bound that is missed with probability below 1e-6; where
    that cannot be evaluated, the rank to 40 digits at random rational points.
    """
    if 0 in matrix.shape:
        return 0
    if not matrix.free_symbols:
        return len(reduced_rows(matrix)[1])
    try:
        table = values(list(matrix), tries)
    except Unspecialised:
        return _sampled_rank(matrix, tries)
    return max(rank(row.reshape(matrix.shape)) for row in table)


def has_rank(matrix: sp.Matrix, wanted: int) -> bool:
    """Whether a constant matrix is proved to have at least rank `wanted`, by Arb balls."""
    return real_rank(matrix, (), wanted, tries=1)


def _is_small(value: sp.Expr) -> bool:
    return bool(abs(value) < sp.Float(10) ** (-_DIGITS // 2))


def _sampled_rank(matrix: sp.Matrix, tries: int) -> int:
    best = 0
    for seed in range(tries):
        value = matrix.subs(random_point(matrix.free_symbols, seed))
        if not value.has(sp.zoo, sp.nan, sp.oo):
            best = max(best, int(value.evalf(_DIGITS).rank(iszerofunc=_is_small)))
    return best


def kernel(matrix: sp.Matrix) -> sp.Matrix:
    """Basis of {v : matrix·v = 0} as columns, over the field that the entries generate.

    The reduced-echelon basis of the kernel itself; where a vector is rational it is scaled to
    primitive integers, first nonzero coefficient positive.
    """
    columns = matrix.cols
    if matrix.rows == 0:
        return sp.eye(columns)
    if not matrix.free_symbols and not all(entry.is_Rational for entry in matrix):
        used = [j for j in range(columns) if any(entry != 0 for entry in matrix[:, j])]
        if len(used) <= matrix.rows and has_rank(matrix, len(used)):
            return sp.eye(columns).extract(
                list(range(columns)), [j for j in range(columns) if j not in used]
            )
    rows, leading = reduced_rows(matrix)
    free = [j for j in range(columns) if j not in set(leading)]
    if not free:
        return sp.zeros(columns, 0)
    basis = sp.zeros(len(free), columns)
    for k, j in enumerate(free):
        basis[k, j] = 1
        for i, lead in enumerate(leading):
            if rows[i, j] != 0:
                basis[k, lead] = -rows[i, j]
    reduced, _ = reduced_rows(basis)
    return sp.Matrix([_primitive(row) for row in reduced.tolist()]).T


def constant_kernel(matrix: sp.Matrix) -> sp.Matrix:
    """Basis of the constant v with matrix(z)·v ≡ 0, as columns, each one proved.

    Reduced-echelon over the rationals, primitive integers, first nonzero coefficient positive;
    for a constant matrix the same as :func:`kernel`.
    """
    if not matrix.free_symbols:
        return kernel(matrix)
    rows = [i for i in range(matrix.rows) if any(e != 0 for e in matrix[i, :])]
    points = matrix.cols // len(rows) * 2 + 4
    try:
        vectors = nullspace(
            lambda prime: values(list(matrix), points, prime=prime).reshape(-1, matrix.cols), 3
        )
    except Unspecialised:
        vectors = []
    if not vectors:
        return sp.zeros(matrix.cols, 0)
    basis = kernel(kernel(sp.Matrix(vectors)).T)
    kept = [
        basis[:, k]
        for k in range(basis.cols)
        if all(is_zero(entry) is True for entry in sp.SparseMatrix(matrix) * basis[:, k])
    ]
    return sp.Matrix.hstack(*kept) if kept else sp.zeros(matrix.cols, 0)


def reduced_rows(matrix: sp.Matrix) -> tuple[sp.Matrix, list[int]]:
    """Nonzero rows of the reduced row-echelon form and its pivot columns.

    Identities such as sin² + cos² = 1 are respected: every pivot is proved or measured to be
    different from zero, and what counts as zero is zero.
    """
    if all(entry.is_Rational for entry in matrix):
        reduced, leading = DomainMatrix.from_Matrix(matrix).to_field().rref()
        return reduced.to_Matrix()[: len(leading), :], list(leading)
    rows = [list(row) for row in matrix.tolist()]
    leading, done = [], 0
    for column in range(matrix.cols):
        rows[done:] = [
            [*row[:column], _tidy(row[column]), *row[column + 1 :]] for row in rows[done:]
        ]
        candidates = [i for i in range(done, len(rows)) if is_zero(rows[i][column]) is not True]
        if not candidates:
            continue
        best = min(candidates, key=lambda i: (rows[i][column].count_ops(), i))
        rows[done], rows[best] = rows[best], rows[done]
        pivot = rows[done][column]
        rows[done] = [_tidy(entry / pivot) for entry in rows[done]]
        for i, row in enumerate(rows):
            if i != done and row[column] != 0:
                factor = row[column]
                rows[i] = [_tidy(a - factor * b) for a, b in zip(row, rows[done], strict=True)]
        leading.append(column)
        done += 1
    return sp.Matrix(done, matrix.cols, [e for row in rows[:done] for e in row]), leading


def _tidy(expr: sp.Expr) -> sp.Expr:
    """A shorter form of the same value; 0 where it is known to vanish."""
    if expr.is_Rational:
        return expr
    if not expr.free_symbols:
        if sign(expr) == 0:
            return sp.Integer(0)
        return sp.radsimp(sp.expand(expr)) if expr.count_ops() < _LONG else expr
    if expr.is_rational_function(*expr.free_symbols):
        return sp.cancel(expr)
    return sp.Integer(0) if is_zero(expr) else sp.factor_terms(sp.trigsimp(sp.cancel(expr)))


def _primitive(row: Sequence[sp.Expr]) -> list[sp.Expr]:
    if not all(entry.is_Rational for entry in row):
        return list(row)
    scale = math.lcm(*[int(entry.q) for entry in row])
    integers = [entry * scale for entry in row]
    divisor = math.gcd(*[int(entry) for entry in integers]) or 1
    first = next((entry for entry in integers if entry != 0), sp.Integer(1))
    return [entry / divisor * (1 if first > 0 else -1) for entry in integers]


def blocks(matrix: sp.Matrix) -> list[list[int]]:
    """Indices of the diagonal blocks of a symmetric sparsity pattern, each sorted."""
    neighbours: list[set[int]] = [set() for _ in range(matrix.rows)]
    for i, j in matrix.todok():
        neighbours[i].add(j)
        neighbours[j].add(i)
    seen: set[int] = set()
    result = []
    for start in range(matrix.rows):
        if start in seen:
            continue
        block, stack = {start}, [start]
        while stack:
            fresh = neighbours[stack.pop()] - block
            block |= fresh
            stack.extend(fresh)
        seen |= block
        result.append(sorted(block))
    return result


def is_positive_semidefinite(matrix: sp.Matrix) -> bool | None:
    """Whether a symmetric matrix is positive semidefinite for all real values of its symbols."""
    verdicts = [_block_psd(matrix.extract(block, block)) for block in blocks(matrix)]
    if False in verdicts:
        return False
    return None if None in verdicts else True


def _block_psd(block: sp.Matrix) -> bool | None:
    """Symmetric elimination with pivots of known sign, then principal minors."""
    remaining = sp.Matrix(block)
    while remaining.rows:
        signs = [_sign_everywhere(remaining[i, i]) for i in range(remaining.rows)]
        if "-" in signs:
            return False
        if "+" in signs:
            pivot = signs.index("+")
        elif "0" in signs:
            zero = signs.index("0")
            others = [_is_zero_row(remaining, zero, j) for j in range(remaining.rows) if j != zero]
            if False in others:
                return False
            if None in others:
                return None
            remaining = _without(remaining, zero)
            continue
        else:
            return _minors_psd(remaining)
        column = _without(remaining, pivot, rows_only=True)[:, pivot]
        schur = _without(remaining, pivot) - column * column.T / remaining[pivot, pivot]
        remaining = schur.applyfunc(_tidy)
    return True


def _is_zero_row(matrix: sp.Matrix, i: int, j: int) -> bool | None:
    return is_zero(matrix[i, j])


def _without(matrix: sp.Matrix, index: int, rows_only: bool = False) -> sp.Matrix:
    keep = [i for i in range(matrix.rows) if i != index]
    return matrix.extract(keep, list(range(matrix.cols)) if rows_only else keep)


def _sign_everywhere(expr: sp.Expr) -> str:
    """``+`` positive, ``0`` zero, ``>`` nonnegative, ``-`` negative, ``?`` unknown."""
    if not expr.free_symbols:
        return {1: "+", 0: "0", -1: "-", None: "?"}[sign(expr)]
    simplified = sp.factor(expr)
    for candidate in (expr, simplified):
        if candidate.is_positive:
            return "+"
        if candidate.is_negative:
            return "-"
        if candidate.is_nonnegative:
            return ">"
    return "0" if is_zero(expr) else "?"


def _minors_psd(matrix: sp.Matrix, limit: int = 5) -> bool | None:
    """All principal minors nonnegative; only for small matrices."""
    if matrix.rows > limit:
        return None
    for mask in range(1, 2**matrix.rows):
        chosen = [i for i in range(matrix.rows) if mask >> i & 1]
        kind = _sign_everywhere(sp.expand(matrix.extract(chosen, chosen).det()))
        if kind == "-":
            return False
        if kind == "?":
            return None
    return True
