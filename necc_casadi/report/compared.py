"""A design beside LQR and the optimum, as a table of plain text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.model.modulated import System

if TYPE_CHECKING:
    from necc_casadi.performance.measure import Performance, Rating

__all__ = ["cells", "comparison", "error_lines", "parameter_lines"]


#: Columns of a label and of each controller.
_LABEL, _COLUMN = 30, 15


def comparison(found: Performance, plant: System) -> list[str]:
    """Lines of the table, of one width."""
    return [_line(row) for row in cells(found, plant)]


def cells(found: Performance, plant: System) -> list[list[str]]:
    """The table: a label and one cell per controller in each row, their names in the first."""
    shown: list[tuple[str, Rating]] = [("this design", found.design)]
    shown += [("LQR", found.lqr)] if found.lqr is not None else []
    shown += [("optimum", found.optimum)] if found.optimum is not None else []
    rows = [[f"{found.starts} random starts", *(name for name, _ in shown)]]

    def row(label: str, cells: list[str]) -> None:
        rows.append([label, *cells])

    each = [rating for _, rating in shown]
    if found.optimum is not None:
        row("cost / optimum: mean, worst", [_costs(r) for r in each])
    row("starts that arrive", [f"{100 * r.converging_share:.0f} %" for r in each])
    row("settles within 2 %, median, s", [_number(r.settling_time) for r in each])
    row("overshoot, median", [_percent(r.overshoot) for r in each])
    row("largest |u|", [_vector(r.peak_u) for r in each])
    if plant.u_limits is not None:
        row("the same, asked for", [_vector(r.peak_demand) for r in each])
        row("limits of u", [_limits(plant.u_limits)])
    with_margins = [r.margins for r in each if r.margins is not None]
    if with_margins:
        row("phase margin", [f"{m.phase_deg:.0f}°" for m in with_margins])
        row(
            "gain margin: down, up", [f"{m.gain_down:.2g}, {_number(m.gain)}" for m in with_margins]
        )
        row("disk margin α, at most 2", [f"{m.disk:.2f}" for m in with_margins])
        row("delay margin, s", [_number(m.delay) for m in with_margins])
    return rows


def error_lines(found: Performance, plant: System) -> list[str]:
    """How far from the target each changed plant rests, in the units of the model."""
    pushed = f"10 % disturbance of u: {_error(found.errors.disturbance, plant)}"
    return [pushed, *parameter_lines(found.errors.parameters, plant)]


def parameter_lines(errors: Mapping[str, Vector | None], plant: System) -> list[str]:
    """How far from the target it rests on the plant with each parameter 10 % larger."""
    return [f"{name} + 10 %: {_error(error, plant)}" for name, error in errors.items()]


def _error(error: Vector | None, plant: System) -> str:
    if error is None:
        return "no rest is found nearby at which every mode decays"
    away = [
        f"{name} {value:.2g} {plant.units.get(name, '')}".rstrip()
        for name, value in zip(plant.states, error, strict=True)
        if value > _NOTHING * max(float(np.max(error)), np.finfo(float).tiny)
    ]
    if float(np.max(error)) < _NOTHING or not away:
        return "rests at the target"
    return f"rests off by {', '.join(away)}"


#: An error below this share of the others is rounding.
_NOTHING = 1e-9


def _line(row: list[str]) -> str:
    label, *others = row
    return f"{label:<{_LABEL}}" + "".join(f"{cell:>{_COLUMN}}" for cell in others)


def _costs(rating: Rating) -> str:
    if rating.cost_to_optimum is None or rating.worst_to_optimum is None:
        return "–"
    return f"{rating.cost_to_optimum:.2f}, {rating.worst_to_optimum:.2f}"


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return "∞" if np.isinf(value) else f"{value:.3g}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.0f} %"


def _vector(values: Vector | None) -> str:
    return "–" if values is None else ", ".join(f"{v:.3g}" for v in values)


def _limits(limits: tuple[tuple[float, float], ...]) -> str:
    return ", ".join(f"{low:.3g} … {high:.3g}" for low, high in limits)
