"""Linear costs over linear matrix inequalities, in floating point: an answer is a proposal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from necc_casadi.arrays import Vector

__all__ = ["SemidefiniteProgram"]


@dataclass(frozen=True, eq=False)
class SemidefiniteProgram:
    """Minimise costᵀx where equations hold and every M₀ + Σ xₖMₖ ⪰ 0.

    References
    ----------
    Goulart and Chen (2024), Clarabel.
    """

    cost: Vector  # (variables,)
    inequalities: Sequence[tuple[Vector, Vector]]  # M₀ (r, r) and M (variables, r, r), symmetric
    equations: list[tuple[Vector, float]] = field(default_factory=list)  # row·x = value

    def solution(self) -> Vector | None:
        """A minimiser; None where the solver found none, which proves nothing."""
        import clarabel  # slow to import, and few runs need it
        from scipy.sparse import csc_matrix

        rows, values, cones = [], [], []
        if self.equations:
            rows.append(np.array([row for row, _ in self.equations]))
            values.append(np.array([value for _, value in self.equations]))
            cones.append(clarabel.ZeroConeT(len(self.equations)))
        for constant, parts in self.inequalities:
            rows.append(-np.array([_triangle(part) for part in parts]).T)
            values.append(_triangle(constant))
            cones.append(clarabel.PSDTriangleConeT(len(constant)))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1  # the same answer every time
        size = len(self.cost)
        found = clarabel.DefaultSolver(
            csc_matrix((size, size)),
            self.cost,
            csc_matrix(np.vstack(rows)),
            np.concatenate(values),
            cones,
            settings,
        ).solve()
        usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        return np.array(found.x) if found.status in usable else None


def _triangle(matrix: Vector) -> Vector:
    """The upper triangle by columns, in which the scalar product of matrices is that of vectors."""
    columns, rows = np.tril_indices(len(matrix))
    weight = np.where(rows == columns, 1.0, np.sqrt(2.0))
    return np.asarray(weight * matrix[rows, columns], dtype=float)
