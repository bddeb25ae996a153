"""Plants whose curved Casimirs see nothing of their energy, such as a satellite's attitude.

With no stiffness of the plant's own, the shape of V is the design's alone: K ties the plant to the
controller, Hc holds the controller. A K stiffer than Hc keeps the Casimirs near their values at z*,
where they are good coordinates, while plant and controller move far together: a wide region.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.interrupts import interruptible
from necc_casadi.lyapunov.lyapunov import Terms
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.derivatives import gradient

__all__ = ["HELD_XI", "POTENTIAL_FREE_STIFFNESS", "best_coordinates", "is_potential_free"]


#: Curvatures of Hc and of K, in natural units.
POTENTIAL_FREE_STIFFNESS = (2.0, 5.0)


#: Pull of ξ* to where it starts.
HELD_XI = 100.0


#: How far ξ* is searched, in natural sizes.
_REACH = 2.0


_TRIES = 4


#: Weight of the logarithm of the condition of Gc beside that of det ∂c/∂xᵀ∂c/∂x: for a satellite
#: its own and the controller's singular attitudes are then about equally far.
_APART = 0.1


def is_potential_free(loop: ClosedLoop, casimirs: Casimirs) -> bool:
    """Whether H depends on no state that a Casimir contains, and some Casimir is not linear.

    Linear Casimirs are good coordinates everywhere: K need not be stiff for their sake.
    """
    curved = any(gradient(c, loop.z).free_symbols for c in casimirs.functions)
    used = (c.free_symbols for c in casimirs.functions)
    return curved and not any(states & loop.plant.H.free_symbols for states in used)


def best_coordinates(terms: Terms, x_star: Vector, guess: Vector, scales: Sizes) -> Vector:
    """ξ* near `guess` at which the Casimirs are the best coordinates of x: log det ∂c/∂xᵀ∂c/∂x.

    A region ends where the controller's own kinematics Gc(ξ) do, at the latest: what its condition
    grows by on the way there is held against ξ*. Where the sum grows up to the end of the search,
    or not at all, the guess stays.
    """
    xi, z = ca.SX.sym("xi", terms.nc), ca.SX.sym("z", terms.n + terms.nc)
    slopes = ca.jacobian(terms.c(z), z)[:, : terms.n]
    N = ca.substitute(slopes, z, ca.vertcat(x_star, xi)) @ ca.diag(scales.state[: terms.n])
    own = _condition(terms, ca.vertcat(ca.SX(x_star), xi))
    worth = ca.log(ca.det(N @ N.T) + 1e-12) - _APART * own
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-8}
    solver = ca.nlpsol("chart", "ipopt", {"x": xi, "f": -worth}, options)
    half = _REACH * scales.state[terms.n :]
    rng = np.random.default_rng(0)
    best, found = guess, -float(ca.Function("worth", [xi], [worth])(guess)) - 1e-3
    for index in range(_TRIES):
        start = guess + half * (rng.uniform(-0.5, 0.5, guess.size) if index else 0.0)
        with interruptible():
            result = solver(x0=start, lbx=guess - half, ubx=guess + half)
        end = np.asarray(result["x"], float).ravel()
        inside = np.all(np.abs(end - guess) < 0.99 * half)
        if inside and solver.stats()["success"] and float(result["f"]) < found - 1e-6:
            best, found = end, float(result["f"])
    return best


def _condition(terms: Terms, z: ca.SX) -> ca.SX:
    """Logarithm of ‖Gc‖²‖Gc⁺‖², infinite where Gc is singular or has a pole."""
    Gc = terms.own_ports(z)[:, terms.m :]
    gram = Gc.T @ Gc
    result: ca.SX = ca.log(ca.trace(gram) * ca.trace(ca.inv(gram)))
    return result
