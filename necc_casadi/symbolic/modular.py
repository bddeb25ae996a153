"""Linear algebra over a finite field."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import flint
import numpy as np
import numpy.typing as npt
import sympy as sp

from necc_casadi.symbolic.finite_field import PRIMES, Residues

__all__ = ["null_basis", "nullspace", "pivots", "rank", "rational_rows"]


def _table(matrix: Residues, prime: int) -> flint.nmod_mat:
    rows, columns = matrix.shape
    return flint.nmod_mat(rows, columns, matrix.ravel().tolist(), prime)


def rank(matrix: Residues, prime: int = PRIMES[0]) -> int:
    """Rank of a matrix of residues."""
    return 0 if 0 in matrix.shape else int(_table(matrix, prime).rank())


def pivots(matrix: Residues, prime: int = PRIMES[0]) -> list[int]:
    """Columns of `matrix` that are independent of the columns before them."""
    if 0 in matrix.shape:
        return []
    reduced, size = _table(matrix, prime).rref()
    entries = [int(v) != 0 for v in reduced.entries()[: size * matrix.shape[1]]]
    return np.argmax(np.array(entries).reshape(size, -1), axis=1).tolist() if size else []


def null_basis(matrix: Residues, prime: int = PRIMES[0]) -> npt.NDArray[Any]:
    """Basis of {v : matrix·v = 0} over GF(prime), one vector per row."""
    return _modular_nullspace(matrix, prime)[1]


def _modular_nullspace(matrix: Residues, prime: int) -> tuple[list[int], npt.NDArray[Any]]:
    """(free columns, basis rows): row k has 1 at its free column and pivot entries before it."""
    columns = matrix.shape[1]
    reduced, size = _table(matrix, prime).rref()
    entries = [int(v) for v in reduced.entries()[: size * columns]]
    table = np.array(entries, dtype=np.int64).reshape(size, columns)
    leading = np.argmax(table != 0, axis=1) if size else np.zeros(0, dtype=np.int64)
    free = np.flatnonzero(~np.isin(np.arange(columns), leading))
    basis = np.zeros((len(free), columns), dtype=np.int64)
    basis[np.arange(len(free)), free] = 1
    basis[:, leading] = (-table[:, free] % prime).T
    return free.tolist(), basis.astype(object)


#: Where so many more primes have given no further vector, the others are not rational.
_IRRATIONAL = 3


def nullspace(table: Callable[[int], Residues]) -> list[list[sp.Rational]]:
    """Rational vectors v with T·v = 0, from the residues `table(p)` of T for several primes p.

    Primes are added until one more changes nothing.

    Vector k has entry 1 at the k-th free column and is supported on columns before it. Entries
    are reconstructed from their residues; a vector that does not come out rational is dropped.
    """
    free, combined = _modular_nullspace(table(PRIMES[0]), PRIMES[0])
    modulus = PRIMES[0]
    rows, settled = rational_rows(combined, modulus), 0
    for prime in PRIMES[1:] if free else ():
        same, basis = _modular_nullspace(table(prime), prime)
        if same == free:
            lift = (basis - combined) * pow(modulus, -1, prime) % prime
            combined, modulus = combined + modulus * lift, modulus * prime
            before, rows = rows, rational_rows(combined, modulus)
            settled = settled + 1 if rows == before else 0
            if settled and (len(rows) == len(free) or settled >= _IRRATIONAL):
                break
    return rows


def rational_rows(basis: npt.NDArray[Any], prime: int = PRIMES[0]) -> list[list[sp.Rational]]:
    """The rows whose residues are those of small fractions."""
    rows = [[_reconstruct(int(v), prime) for v in row] for row in basis]
    return [[v for v in row if v is not None] for row in rows if None not in row]


def _reconstruct(residue: int, modulus: int) -> sp.Rational | None:
    """The fraction a/b with a ≡ b·residue and |a|, b below sqrt(modulus/2), if there is one."""
    if residue == 0:
        return sp.Integer(0)
    bound = int(sp.integer_nthroot(modulus // 2, 2)[0])
    r0, r1, s0, s1 = modulus, residue, 0, 1
    while r1 > bound:
        quotient = r0 // r1
        r0, r1, s0, s1 = r1, r0 - quotient * r1, s1, s0 - quotient * s1
    return sp.Rational(r1, s1) if 0 < abs(s1) <= bound else None
