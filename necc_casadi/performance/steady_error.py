"""Where the loop comes to rest when the plant is another one, or a constant force acts on it."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.control_affine import Equilibria
from necc_casadi.model.rescale import rescaled_motion

__all__ = ["disturbed_error", "parameter_errors", "perturbed_error"]


#: Steps from the design's own plant to the other one, and Newton steps in each.
_STEPS, _NEWTON = 10, 20


#: A Newton step below this, in natural units, ends the iteration.
_SMALL = 1e-10


def disturbed_error(design: Design, share: float = 0.1) -> Vector | None:
    """|x − x*| in sizes, (n,), at rest under a matched disturbance of this share of each u's size.

    The largest over the inputs and both signs; None where no rest is found nearby at which every
    mode decays.
    """
    natural = design.natural
    worst = np.zeros(natural.loop.plant.n)
    for k, size in enumerate(natural.sizes.input):
        for sign in (1.0, -1.0):
            force = np.zeros(len(natural.sizes.input))
            force[k] = sign * share * size
            found = _error(natural, _dynamics(natural), force)
            if found is None:
                return None
            worst = np.maximum(worst, found)
    return worst


def perturbed_error(design: Design, other: Equilibria) -> Vector | None:
    """|x − x*| in sizes, (n,), at rest with the controller of `design` on another plant.

    None where no rest is found nearby at which every mode decays. `other` is in the units of the
    model.
    """
    motion = rescaled_motion(other, design.units)
    dynamics = (
        casadi_function("drift", motion.x, motion.f),
        casadi_function("directions", motion.x, motion.g),
    )
    return _error(design.natural, dynamics, np.zeros(other.m))


def parameter_errors(design: Design, others: Mapping[str, Equilibria]) -> dict[str, Vector | None]:
    """:func:`perturbed_error` on each plant, in the units of the model."""
    size = design.sizes.state[: design.loop.plant.n]
    found = {name: perturbed_error(design, plant) for name, plant in others.items()}
    return {name: None if e is None else e * size for name, e in found.items()}


#: (f, g) of ẋ = f + g u.
_Dynamics = tuple[ca.Function, ca.Function]


def _dynamics(natural: Design) -> _Dynamics:
    terms = natural.lyapunov.terms
    return terms.drift, terms.directions


def _error(natural: Design, other: _Dynamics, force: Vector) -> Vector | None:
    """Newton's method along a path from the design's plant to another with a force on its input."""
    V = natural.lyapunov
    n = V.terms.n
    z, way = ca.MX.sym("z", len(natural.z_star)), ca.MX.sym("way")
    x = z[:n]
    u, s_dot = V.control_law_function.call([x, z[n:]])

    pushed = u + way * ca.DM(force)
    own, changed = ((f(x) + g(x) @ pushed) for f, g in (_dynamics(natural), other))
    x_dot = (1 - way) * own + way * changed
    field = ca.vertcat(x_dot, s_dot)
    slope = ca.jacobian(field, z)
    both = ca.Function("rest", [z, way], [field, slope])
    at = natural.stored_z_bar
    for share in np.linspace(0, 1, _STEPS + 1)[1:]:
        for _ in range(_NEWTON):
            f, A = (np.asarray(v, float) for v in both.call([at, share]))
            if not np.isfinite(A).all():
                return None
            step = np.linalg.lstsq(A, f.ravel(), rcond=None)[0]
            at = at - step
            if np.linalg.norm(step) < _SMALL:
                break
        else:
            return None
    A = np.asarray(both.call([at, 1.0])[1], float)
    if np.linalg.eigvals(A).real.max() >= 0:
        return None
    size = natural.sizes.state[:n]
    return np.asarray(np.abs(at[:n] - natural.z_star[:n]) / size, float)
