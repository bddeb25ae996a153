"""The minimum z̄ of V near z*: existence, uniqueness and distance, proved.

This is eq. ErrorUpperBound with a proved μ in place of a − ε and a proof that z̄ exists:
if ∇²V ⪰ μI on a ball of radius r around z* and g = ‖∇V(z*)‖ < μr, then V has exactly one critical
point z̄ there, a strict minimum, and ‖z̄ − z*‖ ≤ g/μ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.definite import (
    lowest_eigenvalue,
    norm,
    positive_definite,
)
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential, target_enclosure
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_on, written

__all__ = ["Equilibrium", "prove_equilibrium"]


#: Radii that are tried, in the order of preference: the largest one that can be proved is kept.
_RADII = 2.0 ** -np.arange(-1.0, 17.0)


#: The larger radii are tried first: most often one of them holds.
_BATCHES = 3


#: μ is this share of the smallest eigenvalue at z*, the first that can be proved.
_SHARES = (0.5, 0.25, 0.05)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """What is proved about z̄; `mu` and the rest are None where nothing is."""

    z_bar: Vector  # (N,), a point of the enclosure
    gradient_norm: float  # upper bound of ‖∇V(z*)‖
    mu: float | None = None  # ∇²V ⪰ μI on the ball
    radius: float | None = None  # of the ball around z*
    enclosure: float | None = None  # ‖z̄ − z_bar‖ is at most this

    @property
    def proved(self) -> bool:
        """Whether z̄ exists and is unique in the ball."""
        return self.mu is not None

    @property
    def bound(self) -> float | None:
        """Upper bound g/μ of ‖z̄ − z*‖."""
        if self.mu is None:
            return None
        return float(np.nextafter(self.gradient_norm / self.mu, np.inf))

    @property
    def box(self) -> Interval:
        """A box (N,) that contains z̄."""
        radius = np.inf if self.enclosure is None else self.enclosure
        return Interval(
            np.nextafter(self.z_bar - radius, -np.inf), np.nextafter(self.z_bar + radius, np.inf)
        )


def prove_equilibrium(potential: Potential) -> Equilibrium:
    """Find the largest ball around z* in which z̄ is proved to exist alone, and enclose z̄."""
    z_star = target_enclosure(potential.design)
    z_bar = potential.design.z_bar
    points = Interval(np.stack([z_star.lo, z_bar]), np.stack([z_star.hi, z_bar]))
    at = potential.jet(points)
    gradient_norm, residual = (_eased(float(v)) for v in norm(at.grad))
    unproved = Equilibrium(z_bar, gradient_norm)
    lowest = float(lowest_eigenvalue(at.hess)[0])
    if not (lowest > 0 and np.isfinite(gradient_norm)):
        return unproved
    found = _largest_ball(potential, z_star, gradient_norm, lowest)
    if found is None:
        return unproved
    radius, mu = found
    enclosure = float(np.nextafter(residual / mu, np.inf))
    inside = norm(z_star - z_bar) < radius
    return Equilibrium(z_bar, gradient_norm, mu, radius, enclosure) if inside else unproved


def _eased(bound: float) -> float:
    """A little more than the bound, so that other arithmetic can confirm it."""
    return 1.01 * bound + 1e-15


def _largest_ball(
    potential: Potential, z_star: Interval, gradient_norm: float, lowest: float
) -> tuple[float, float] | None:
    """(r, μ) with ∇²V ⪰ μI on the cube z* ± r, which holds the ball, and g < μr."""
    hessians: list[Interval] = []  # of the cubes, made as they are needed
    for share in _SHARES:
        mu = share * lowest
        for k, radii in enumerate(np.array_split(_RADII, _BATCHES)):
            if k == len(hessians):
                hessians.append(potential.lower_hessian(_cubes(z_star, radii[:, None])))
            holds = positive_definite(hessians[k], mu)
            holds &= gradient_norm < np.nextafter(mu * radii, 0)
            for radius in radii[holds]:
                if _smooth(potential, z_star, float(radius)):
                    return float(radius), mu
    return None


def _cubes(z_star: Interval, r: Vector | float) -> Interval:
    """The cubes z* ± r."""
    below, above = np.nextafter(z_star.lo - r, -np.inf), z_star.hi + r
    return Interval(below, np.nextafter(above, np.inf))


def _smooth(potential: Potential, z_star: Interval, radius: float) -> bool:
    """Whether V is made of smooth parts, and the loop as well, on the cube z* ± radius."""
    design = potential.design
    return is_smooth_on(written(design), design.loop.z, _cubes(z_star, radius))
