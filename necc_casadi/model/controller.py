"""The controller ξ̇ = (Jc − Rc)∇Hc + Gc u_c, y_c = Gcᵀ∇Hc (eq. Controller)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.entries import (
    Property,
    check_psd,
    check_rank,
    check_skew,
    check_states,
    shaped_matrix,
    square_matrix,
)
from necc_casadi.model.plant import Plant

__all__ = ["Controller", "default_controller", "make_controller"]


@dataclass(frozen=True, eq=False)
class Controller:
    """Structure of the controller (eq. Controller); Hc comes later, from the design."""

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

    Raises
    ------
    ModelError
        ``name_clash, duplicate_state, shape, undefined_symbol, not_real, non_smooth, singular,
        jc_not_skew, rc_not_psd, gc_rank``.
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
    properties = (
        check_skew(interconnection, "Jc", "jc_not_skew"),
        check_psd(dissipation, "Rc", "rc_not_psd", "rc_not_psd"),
        check_rank(ports, "Gc", "gc_rank"),
    )
    return Controller(xi, interconnection, dissipation, ports, properties)
