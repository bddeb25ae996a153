"""Natural scales of length and energy in training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.derivatives import at, gradient

__all__ = ["Scales", "natural_scales"]


@dataclass(frozen=True)
class Scales:
    """Natural sizes of a plant, from its domain and its energy: units do not matter."""

    state: Vector  # (n + nc,) size of each state
    energy: float  # size of H

    @property
    def stiffness(self) -> Vector:
        """Diagonal of the reference stiffness P, energy/state²."""
        return self.energy / self.state**2


def natural_scales(loop: ClosedLoop, casimirs: Casimirs, x_star: Vector, xi: Vector) -> Scales:
    """Sizes of the states from the domain (half-width 2 is one unit), of H from its curvature.

    A controller state without a domain of its own takes the size that the Casimirs give it.
    """
    domain = loop.plant.domain
    size = np.full(len(loop.z), np.nan)
    for index, name in enumerate(loop.states):
        if name in domain:
            lo, hi = (float(bound) for bound in domain[name])
            size[index] = (hi - lo) / 4
    n = loop.plant.n
    size[:n] = np.where(np.isnan(size[:n]), 1.0, size[:n])
    point = dict(zip(loop.z, np.concatenate([x_star, xi]), strict=True))
    slopes = np.array(
        [[abs(float(v)) for v in at(gradient(c, loop.z), point)] for c in casimirs.functions]
    )
    reach = np.max(slopes[:, :n] * size[:n], axis=1, initial=0.0)
    for index in map(int, np.flatnonzero(np.isnan(size))):
        seen = float(reach @ slopes[:, index])
        if seen > 0:
            size[index] = seen / float(slopes[:, index] @ slopes[:, index])
    size[np.isnan(size)] = 1.0
    pairs = zip(loop.plant.grad_H, loop.plant.x, strict=True)
    second = at(sp.Matrix([sp.diff(slope, s) for slope, s in pairs]), point)
    curvature = [abs(float(v)) for v in second]
    energies = size[:n] ** 2 * np.array(curvature)
    energy = float(energies[energies > 0].mean()) if np.any(energies > 0) else 1.0
    return Scales(size, energy)
