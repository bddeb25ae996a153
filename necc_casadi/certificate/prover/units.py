"""The natural units of a design, as a certificate states them."""

from __future__ import annotations

from necc_casadi.certificate.claims.units import Units
from necc_casadi.designs.design import Design

__all__ = ["units_of"]


def units_of(design: Design) -> Units:
    """The natural units of a design."""
    units = design.units
    return Units(tuple(map(float, units.state)), float(units.energy), float(units.time))
