"""The members of a family as a design sees them: one V, an energy of the plant for each.

For Φ = H + Hc + C the networks do not know ϑ, and V(ẑ; ϑ) = H_ϑ(x̂) + Hc(ξ) + K(c(ẑ)): what a
member asks of V is what the nominal plant asks, shifted by the difference of two known energies
(docs/theory.md#families). So members cost no variable of any program: curvature is asked for below
all of them at once, rows of a shape take the worst of them.

Members are samples of ϑ. A certificate, not they, says what holds between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.family_terms import energies_of
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.model.samples import quasi_random
from necc_casadi.model.sizes import Sizes

__all__ = ["Members", "members_of"]


#: Corners of the box of ϑ at most, and members drawn from its inside.
_CORNERS, _INSIDE = 16, 8


#: Differences below this share of the largest entry are rounding.
_SAME = 1e-12


class Members:
    """Energies H_ϑ of members beside the nominal one, of the same states."""

    def __init__(self, nominal: ca.Function, energies: Sequence[ca.Function], n: int) -> None:
        self.energies = tuple(energies)
        x = ca.MX.sym("x", n)
        self._slopes, self._hessians, self._values = [], [], []
        for energy in self.energies:
            more = energy(x) - nominal(x)
            hessian, slope = ca.hessian(more, x)
            self._values.append(ca.Function("more", [x], [more]))
            self._slopes.append(ca.Function("slope", [x], [ca.densify(slope)]))
            self._hessians.append(ca.Function("bend", [x], [ca.densify(hessian)]))

    def __len__(self) -> int:
        return len(self.energies)

    def bends(self, x_star: Vector, size: int) -> list[Vector]:
        """∇²V of each member less that of the nominal one at z*, `size` × `size`; equal ones once.

        A member whose energy has no curvature there is left out.
        """
        found: list[Vector] = []
        for function in self._hessians:
            more, n = np.zeros((size, size)), len(x_star)
            more[:n, :n] = np.asarray(function(x_star), float)
            if np.isfinite(more).all() and not any(_are_equal(more, seen) for seen in found):
                found.append(more)
        return found

    def least_bend(self, x_star: Vector, scale: Vector) -> Vector:
        """A symmetric matrix ⪯ 0 and ⪯ each of the :meth:`bends`, in states of these sizes.

        A − (A − B)₊ ⪯ A and = B − (B − A)₊ ⪯ B, where X₊ keeps the eigenvalues above 0.
        """
        units = np.outer(scale, scale)
        least = np.zeros((len(scale), len(scale)))
        for more in self.bends(x_star, len(scale)):
            values, vectors = np.linalg.eigh(least - more * units)
            least = least - (vectors * np.maximum(values, 0.0)) @ vectors.T
        return least / units

    def least_rise(self, x_star: Vector, offsets: Vector) -> Vector:
        """The least of H_ϑ − H at x* + o over its value at x*, over the members, ≤ 0; (S,)."""
        return self._least(
            [f.map(len(offsets))(_columns(x_star, offsets)) - f(x_star) for f in self._values]
        )

    def least_slope(self, x_star: Vector, offsets: Vector, directions: Vector) -> Vector:
        """The least of (∇(H_ϑ − H)(x* + o) − ∇(H_ϑ − H)(x*))ᵀd, over the members, ≤ 0; (S,).

        Without the slope at x*, which moves a member's minimum and bends nothing.
        """
        n, at = len(x_star), _columns(x_star, offsets)
        found = []
        for f in self._slopes:
            turned = np.asarray(f.map(len(offsets))(at), float).T - np.asarray(f(x_star)).ravel()
            found.append((turned * directions[:, :n]).sum(1))
        return self._least(found)

    def _least(self, found: Sequence[Vector | ca.DM]) -> Vector:
        rows = np.array([np.asarray(row, float).ravel() for row in found])
        least: Vector = np.fmin(np.fmin.reduce(rows, axis=0), 0.0)
        return least


def members_of(family: FamilyLoop, units: Sizes, seed: int) -> Members:
    """Corners of the box of ϑ and places inside it, in these units; the same for the same seed."""
    count = len(family.parameters)
    if 2**count <= _CORNERS:
        corners = np.array(list(product((0.0, 1.0), repeat=count)))
    else:
        corners = np.round(quasi_random(_CORNERS, count, seed))
    shares = np.concatenate([corners, quasi_random(_INSIDE, count, seed)])
    nominal, energies = energies_of(family, units, shares)
    return Members(nominal, energies, family.loop.plant.n)


def _are_equal(one: Vector, other: Vector) -> bool:
    """Whether matrices differ by rounding only, whatever their unit."""
    return bool(np.abs(one - other).max() <= _SAME * np.abs(one).max())


def _columns(x_star: Vector, offsets: Vector) -> Vector:
    """The places x* + o, (n, S)."""
    return np.asarray(offsets[:, : len(x_star)].T + x_star[:, None])
