"""Checks of a model that need the target: finite and real there, structure at sampled points."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.domain import exact_bounds
from necc_casadi.model.entries import PropertyKind, not_psd, shown_point
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.zero import random_point

__all__ = ["check_model_at"]


_Box = Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]]


_Sampler = Callable[[sp.MatrixBase, str, _Box], None]


_SAMPLES = 200


#: A rank or a sign that is this small relative to the matrix is not told from zero.
_RELATIVE = 1e-12


def check_model_at(loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr]) -> None:
    """Refuse a model that is not defined at x*, or whose structure fails there or nearby.

    What algebra left undecided is tried at random points of the domain, target ± 2 by default.

    Raises
    ------
    ModelError
        ``singular, not_real, g_rank, gc_rank, j_not_skew, r_not_psd, jc_not_skew, rc_not_psd``,
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
    box = exact_bounds(loop, x_star)
    samplers: dict[PropertyKind, _Sampler] = {"skew": _sample_skew, "psd": _sample_psd}
    for kind, sample in samplers.items():
        for p in loop.properties:
            if p.kind == kind and not p.proved:
                sample(structure[p.matrix], p.matrix, box)


def _check_defined(expr: sp.Expr, label: str, x_star: Mapping[sp.Symbol, sp.Expr]) -> None:
    here = {symbol: x_star[symbol] for symbol in expr.free_symbols}
    value = expr.subs(here)
    where = f"at {shown_point(here)}"
    remedy = "Choose a target inside the region where the model is defined."
    if not is_finite(value):
        raise ModelError("singular", f"{label} = {expr} is not finite {where}", remedy)
    if value.is_real is False or (value.is_real is None and sp.N(value).has(sp.I)):
        raise ModelError("not_real", f"{label} = {expr} is not real {where}", remedy)


def _check_rank(matrix: sp.MatrixBase, label: str, x_star: Mapping[sp.Symbol, sp.Expr]) -> None:
    values = matrix.subs(x_star)
    if values.free_symbols or not values:  # a Gc(ξ): ξ* is not known yet
        return
    singular = np.linalg.svd(np.array(values.evalf(), float), compute_uv=False)
    if singular[-1] <= _RELATIVE * singular[0]:
        raise ModelError(
            f"{label.lower()}_rank",
            f"{label} loses rank at {shown_point(x_star)}: {label} = {values.tolist()}",
            "Choose a target at which every input acts.",
        )


def _samples(
    matrix: sp.MatrixBase, label: str, box: _Box
) -> list[tuple[dict[sp.Symbol, sp.Rational], Vector]]:
    """Random points of the box and the matrix there."""
    symbols = sorted(matrix.free_symbols, key=str)
    evaluate = sp.lambdify(symbols, matrix, "numpy")
    result = []
    for seed in range(_SAMPLES):
        point = random_point(symbols, seed, box)
        with np.errstate(all="ignore"):
            value = np.array(evaluate(*[float(point[s]) for s in symbols]), dtype=float)
        if not np.all(np.isfinite(value)):
            raise ModelError(
                "singular",
                f"{label} is not finite at {shown_point(point)}",
                "Choose a domain without poles: domain = {state: (lo, hi)}.",
            )
        result.append((point, value))
    return result


def _sample_psd(matrix: sp.MatrixBase, label: str, box: _Box) -> None:
    for point, value in _samples(matrix, label, box):
        if np.linalg.eigvalsh(value)[0] < -_RELATIVE * max(1.0, float(np.abs(value).max())):
            raise ModelError(f"{label.lower()}_not_psd", *not_psd(matrix, label, point))


def _sample_skew(matrix: sp.MatrixBase, label: str, box: _Box) -> None:
    for point, value in _samples(matrix, label, box):
        i, j = np.unravel_index(np.argmax(np.abs(value + value.T)), value.shape)
        total = value[i, j] + value[j, i]
        if abs(total) > _RELATIVE * max(1.0, float(np.abs(value).max())):
            raise ModelError(
                f"{label.lower()}_not_skew",
                f"{label} must be skew-symmetric: {label}[{i},{j}] + {label}[{j},{i}] = "
                f"{total:.4g} at {shown_point(point)}",
                f"Set {label}[{j},{i}] = -{label}[{i},{j}].",
            )
