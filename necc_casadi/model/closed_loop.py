"""Controller structure and its power-preserving interconnection with the plant.

eq. Controller:       ξ̇ = (Jc − Rc)∇Hc + Gc u_c,  y_c = Gcᵀ∇Hc
eq. PlantControllerInterconnection:  u = −y_c + v,  u_c = y + v_c
eq. ClosedLoopSystem: Jcl = [[J, −G Gcᵀ], [Gc Gᵀ, Jc]],  Rcl = diag(R, Rc)

Every loop is ż = M∇(H + Hc) + 𝒢(v, v_c) with u = −A∇Hc + v. A controller keeps s = ξ − γ(x),
where γ = 0 in the published loop; see shaped_loop.py for another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import sympy as sp

from necc_casadi.model.controller import Controller
from necc_casadi.model.entries import Property
from necc_casadi.model.plant import Plant

__all__ = ["ClosedLoop", "interconnect"]


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Plant and controller, interconnected (eq. ClosedLoopSystem), z = (x, ξ).

    Examples
    --------
    >>> from necc_casadi import load_model
    >>> loop = load_model("pendulum.py").loop
    >>> loop.states
    ('q', 'p', 'xi1')
    >>> loop.J
    Matrix([
    [ 0, 1,  0],
    [-1, 0, -1],
    [ 0, 1,  0]])
    """

    plant: Plant
    controller: Controller

    @cached_property
    def z(self) -> tuple[sp.Symbol, ...]:
        """All states, plant first, (n + nc,)."""
        return self.plant.x + self.controller.xi

    @property
    def n(self) -> int:
        """Number of closed-loop states, n + nc."""
        return len(self.z)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of all states, plant first."""
        return self.plant.states + self.controller.states

    @cached_property
    def J(self) -> sp.ImmutableMatrix:
        """Jcl, (n + nc) × (n + nc)."""
        coupling = self.plant.G * self.controller.Gc.T
        upper = sp.Matrix.hstack(sp.Matrix(self.plant.J), sp.Matrix(-coupling))
        lower = sp.Matrix.hstack(sp.Matrix(coupling.T), sp.Matrix(self.controller.Jc))
        return sp.ImmutableMatrix(sp.Matrix.vstack(upper, lower))

    @cached_property
    def R(self) -> sp.ImmutableMatrix:
        """Rcl, (n + nc) × (n + nc)."""
        return sp.ImmutableMatrix(sp.diag(sp.Matrix(self.plant.R), sp.Matrix(self.controller.Rc)))

    @cached_property
    def M(self) -> sp.ImmutableMatrix:
        """Jcl − Rcl, so that a Casimir satisfies ∇Cᵀ M = 0 (eq. CasimirCondition)."""
        return sp.ImmutableMatrix(self.J - self.R)

    @cached_property
    def ports(self) -> sp.ImmutableMatrix:
        """𝒢 = diag(G, Gc), (n + nc) × (m + channels), through which v and v_c act."""
        return sp.ImmutableMatrix(sp.diag(sp.Matrix(self.plant.G), sp.Matrix(self.controller.Gc)))

    @property
    def channels(self) -> int:
        """Number of entries of v_c."""
        return int(self.controller.Gc.cols)

    @property
    def feedback(self) -> sp.ImmutableMatrix:
        """A in u = −A∇Hc + v, m × nc."""
        return sp.ImmutableMatrix(self.controller.Gc.T)

    @property
    def gamma(self) -> tuple[sp.Expr, ...]:
        """γ(x), (nc,): the controller keeps s = ξ − γ(x)."""
        return (sp.Integer(0),) * self.controller.nc

    @property
    def slopes(self) -> sp.ImmutableMatrix:
        """∇γ, n × nc."""
        return sp.ImmutableMatrix(sp.zeros(self.plant.n, self.controller.nc))

    @property
    def own_structure(self) -> sp.ImmutableMatrix:
        """M_s, nc × (n + nc), and with :attr:`own_ports` ṡ = M_s ∇(H + Hc) + 𝒢_s(v, v_c)."""
        return sp.ImmutableMatrix(self.M[self.plant.n :, :])

    @property
    def own_ports(self) -> sp.ImmutableMatrix:
        """𝒢_s, nc × (m + channels)."""
        return sp.ImmutableMatrix(self.ports[self.plant.n :, :])

    @property
    def matrices(self) -> tuple[sp.MatrixBase, ...]:
        """What the loop is made of beside H, as it was written."""
        plant, controller = self.plant, self.controller
        return (plant.J, plant.R, plant.G, controller.Jc, controller.Rc, controller.Gc)

    def rewritten(self, change: Callable[[sp.Expr], sp.Expr]) -> ClosedLoop:
        """The loop with every entry of its matrices changed."""
        changed = (sp.ImmutableMatrix(matrix.applyfunc(change)) for matrix in self.matrices)
        J, R, G, Jc, Rc, Gc = changed
        plant = replace(self.plant, J=J, R=R, G=G)
        return replace(self, plant=plant, controller=replace(self.controller, Jc=Jc, Rc=Rc, Gc=Gc))

    @property
    def properties(self) -> tuple[Property, ...]:
        """Structural properties of plant and controller."""
        return self.plant.properties + self.controller.properties


def interconnect(plant: Plant, controller: Controller) -> ClosedLoop:
    """The closed loop of eq. ClosedLoopSystem, before damping is injected.

    Parameters
    ----------
    plant, controller
        Coupled by u = −y_c + v, u_c = y + v_c (eq. PlantControllerInterconnection).

    Returns
    -------
    ClosedLoop
        With the n + nc states z = (x, ξ).

    Examples
    --------
    >>> import sympy as sp
    >>> from necc_casadi import interconnect, make_controller, make_plant
    >>> q, p = sp.symbols("q p", real=True)
    >>> J, G = sp.Matrix([[0, 1], [-1, 0]]), sp.Matrix([0, 1])
    >>> plant = make_plant((q, p), J, sp.zeros(2, 2), G, p**2 / 2 + 1 - sp.cos(q))
    >>> xi = sp.Symbol("xi", real=True)
    >>> controller = make_controller(plant, [xi], sp.zeros(1, 1), sp.zeros(1, 1), sp.eye(1))
    >>> loop = interconnect(plant, controller)
    >>> loop.n, (loop.J + loop.J.T).is_zero_matrix
    (3, True)
    """
    return ClosedLoop(plant, controller)
