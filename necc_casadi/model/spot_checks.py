"""Checks of a model that need the target: finite and real there, structure at sampled points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import flint
import numpy as np
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.domain import sampling_box
from necc_casadi.model.entries import PropertyKind, not_psd, shown_point
from necc_casadi.symbolic.arb import enclosure, not_real
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.linear_algebra import generic_rank
from necc_casadi.symbolic.pieces import Box
from necc_casadi.symbolic.zero import Undecided, random_point

__all__ = ["check_model_at"]


_Check = Callable[[sp.MatrixBase, str, Mapping[sp.Symbol, sp.Expr]], None]


_SAMPLES, _BITS = 200, 256


#: Structure must hold for all x: it is sampled near the target and farther out.
_REACHES = (1, 4)


def check_model_at(loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr]) -> tuple[str, ...]:
    """Refuse a model that is not defined at x*, or whose structure fails there or nearby.

    What algebra left undecided is tried at random points of the domain; where the model names
    none, of a box around the target that stays away from poles and branch points.

    Returns
    -------
    tuple of str
        What made a box that the model does not name smaller, one note each.

    Raises
    ------
    ModelError
        ``singular, g_rank, gc_rank, j_not_skew, r_not_psd, jc_not_skew, rc_not_psd``,
        with the witness point.
    """
    plant, controller = loop.plant, loop.controller
    gradient = plant.grad_H
    for label, values in (
        ("H", [plant.H]),
        ("the gradient of H", gradient),
        ("the Hessian of H", gradient.jacobian(plant.x)),
        *((label, getattr(plant, label)) for label in "JRG"),
    ):
        # each different entry once: matrices of large plants are mostly zeros
        for expr in dict.fromkeys(value for value in values if value.free_symbols):
            _check_defined(expr, label, x_star)
    for label, matrix in (("G", plant.G), ("Gc", controller.Gc)):
        _check_rank(matrix, label, x_star)
    structure = {"J": plant.J, "R": plant.R, "Jc": controller.Jc, "Rc": controller.Rc}
    checks: dict[PropertyKind, _Check] = {"skew": _check_skew_at, "psd": _check_psd_at}
    notes: list[str] = []
    for p in loop.properties:
        if p.proved or p.kind not in checks:
            continue
        matrix, boxes = structure[p.matrix], []
        for reach in _REACHES:
            box, limits = sampling_box(loop, list(matrix), x_star, reach)
            boxes.append(box)
        notes += [
            f"{p.matrix} is sampled around the target only as far as {limit}: "
            "name a domain to have it sampled elsewhere"
            for limit in limits
        ]
        for point in _points(matrix, p.matrix, boxes, set(plant.domain)):
            checks[p.kind](matrix, p.matrix, point)
    return tuple(dict.fromkeys(notes))


def _check_defined(expr: sp.Expr, label: str, x_star: Mapping[sp.Symbol, sp.Expr]) -> None:
    here = {symbol: x_star[symbol] for symbol in expr.free_symbols}
    value = expr.subs(here)
    where = f"at {shown_point(here)}"
    remedy = "Choose a target inside the region where the model is defined."
    if not is_finite(value):
        raise ModelError("singular", f"{label} = {expr} is not finite {where}", remedy)
    if value.is_real is not True and not_real(value):
        raise ModelError("singular", f"{label} = {expr} is not real {where}", remedy)


def _check_rank(matrix: sp.MatrixBase, label: str, x_star: Mapping[sp.Symbol, sp.Expr]) -> None:
    """A rank that is proved to be less; one that is not decided is the verdict's affair."""
    values = sp.Matrix(matrix.subs(x_star))
    if values.free_symbols or not values:  # a Gc(ξ): ξ* is not known yet
        return
    try:
        rank = generic_rank(values)
    except Undecided:
        return
    if rank < min(values.shape):
        raise ModelError(
            f"{label.lower()}_rank",
            f"{label} loses rank at {shown_point(x_star)}: {label} = {values.tolist()}",
            "Choose a target at which every input acts.",
        )


def _points(
    matrix: sp.MatrixBase, label: str, boxes: Sequence[Box], bounded: set[str]
) -> Iterator[dict[sp.Symbol, sp.Rational]]:
    """Random points of the boxes, in turn, at which the matrix has a value.

    A point of the user's own domain without one is refused; another one is passed over.
    """
    symbols = sorted(matrix.free_symbols, key=str)
    own = {str(s) for s in symbols} <= bounded
    for seed in range(_SAMPLES if symbols else 1):
        point = random_point(symbols, seed, boxes[seed % len(boxes)])
        with flint.ctx.workprec(_BITS):
            known = all(enclosure(entry, point).is_finite() for entry in matrix)
        if known:
            yield point
        elif own:
            raise ModelError(
                "singular",
                f"{label} is not finite at {shown_point(point)}",
                "Choose a domain without poles: domain = {state: (lo, hi)}.",
            )


def _check_psd_at(matrix: sp.MatrixBase, label: str, point: Mapping[sp.Symbol, sp.Expr]) -> None:
    """Refuse where a direction with a certainly negative quadratic form is found."""
    with flint.ctx.workprec(_BITS):
        middles = [float(enclosure(entry, point).mid()) for entry in matrix]
        table = np.array(middles).reshape(matrix.shape)
        size = np.sqrt(np.abs(np.diag(table)))
        # powers of two on both sides: the units of the states do not matter
        scale = np.exp2(-np.round(np.log2(np.where(size > 0, size, 1.0))))
        eigenvectors = np.linalg.eigh(scale[:, None] * table * scale)[1]
        for direction in (*np.eye(len(table)), scale * eigenvectors[:, 0]):
            exact = sp.Matrix([sp.Rational(float(v)) for v in direction])
            if enclosure((exact.T * matrix * exact)[0], point) < 0:
                raise ModelError(f"{label.lower()}_not_psd", *not_psd(matrix, label, point))


def _check_skew_at(matrix: sp.MatrixBase, label: str, point: Mapping[sp.Symbol, sp.Expr]) -> None:
    """Refuse where an entry and its mirror certainly do not cancel."""
    with flint.ctx.workprec(_BITS):
        for i in range(matrix.rows):
            for j in range(i + 1):
                total = enclosure(matrix[i, j] + matrix[j, i], point)
                if not total.contains(0):
                    raise ModelError(
                        f"{label.lower()}_not_skew",
                        f"{label} must be skew-symmetric: {label}[{j},{i}] + {label}[{i},{j}] = "
                        f"{float(total.mid()):.4g} at {shown_point(point)}",
                        f"Set {label}[{i},{j}] = -{label}[{j},{i}].",
                    )
