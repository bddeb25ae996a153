"""The controller ξ̇ = (Jc − Rc)∇Hc + Gc u_c, y_c = Gcᵀ∇Hc (eq. Controller)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.entries import (
    Property,
    check_states,
    check_structure,
    shaped_matrix,
    square_matrix,
)
from necc_casadi.model.plant import Plant

__all__ = ["Controller", "default_controller", "make_controller"]


@dataclass(frozen=True, eq=False)
class Controller:
    """Structure of the controller (eq. Controller); Hc comes later, from the design.

    Examples
    --------
    The controller of a model file that names none: one integrator per input.

    >>> from necc_casadi import load_model
    >>> controller = load_model("pendulum.py").loop.controller
    >>> controller.states, controller.Jc, controller.Gc
    (('xi1',), Matrix([[0]]), Matrix([[1]]))
    """

    xi: tuple[sp.Symbol, ...]  # (nc,)
    Jc: sp.ImmutableMatrix  # nc × nc, skew-symmetric
    Rc: sp.ImmutableMatrix  # nc × nc, ⪰ 0
    Gc: sp.ImmutableMatrix  # nc × m, full rank
    properties: tuple[Property, ...] = ()

    @property
    def nc(self) -> int:
        """Number of controller states."""
        return len(self.xi)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the controller states, in order."""
        return tuple(str(s) for s in self.xi)


def default_controller(plant: Plant) -> Controller:
    """One integrator per input: Jc = 0, Rc = 0, Gc = I, states xi1 … xim."""
    xi = sp.symbols([f"xi{i + 1}" for i in range(plant.m)], real=True)
    m = plant.m
    return make_controller(plant, xi, sp.zeros(m, m), sp.zeros(m, m), sp.eye(m))


def make_controller(
    plant: Plant, xi: Sequence[sp.Symbol], Jc: sp.MatrixBase, Rc: sp.MatrixBase, Gc: sp.MatrixBase
) -> Controller:
    """Check the structure of eq. Controller against `plant`.

    Parameters
    ----------
    plant
        With m inputs.
    xi
        Controller states, nc symbols that are no plant states.
    Jc, Rc, Gc
        Interconnection nc × nc, dissipation nc × nc and input matrix nc × m, of ξ.

    Returns
    -------
    Controller
        Exact and checked.

    Raises
    ------
    ModelError
        ``name_clash, duplicate_state, shape, undefined_symbol, not_real, non_smooth, singular,
        jc_not_skew, rc_not_psd, gc_rank``; see docs/contract.md#errors.

    Examples
    --------
    >>> import sympy as sp
    >>> from necc_casadi import make_controller, make_plant
    >>> q, p = sp.symbols("q p", real=True)
    >>> J, G = sp.Matrix([[0, 1], [-1, 0]]), sp.Matrix([0, 1])
    >>> plant = make_plant((q, p), J, sp.zeros(2, 2), G, p**2 / 2 + 1 - sp.cos(q))
    >>> xi = sp.Symbol("xi", real=True)
    >>> make_controller(plant, [xi], sp.zeros(1, 1), sp.zeros(1, 1), sp.eye(1)).states
    ('xi',)
    """
    xi = tuple(xi)
    check_states(xi, "xi")
    clash = sorted({str(s) for s in xi} & set(plant.states))
    if clash:
        raise ModelError(
            "name_clash",
            f"{clash[0]} is a plant state and a controller state",
            "Rename one of them; the default controller states are called xi1, xi2, ….",
        )
    nc = len(xi)
    interconnection = square_matrix(Jc, nc, "Jc", xi)
    dissipation = square_matrix(Rc, nc, "Rc", xi)
    ports = shaped_matrix(Gc, "Gc", xi)
    if ports.shape != (nc, plant.m):
        raise ModelError(
            "shape",
            f"Gc has shape {ports.rows}×{ports.cols}",
            f"Gc must be {nc}×{plant.m}: controller states by inputs.",
        )
    properties = check_structure(
        interconnection,
        dissipation,
        ports,
        "c",
        code_skew="jc_not_skew",
        code_symmetric="rc_not_psd",
        code_psd="rc_not_psd",
        code_rank="gc_rank",
    )
    return Controller(xi, interconnection, dissipation, ports, properties)
