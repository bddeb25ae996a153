"""What a finished design reached, in numbers, in the units of the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.designs.error_bound import gradient_and_hessian, loss, published_bound

__all__ = ["Measures", "measure"]


@dataclass(frozen=True, eq=False)
class Measures:
    """Of the equilibrium that was assigned, of V there and of the loop."""

    loss: float  # ε
    gradient_norm: float  # ‖∇V(z*)‖
    distance: float  # ‖z̄ − z*‖
    bound_paper: float | None  # ε/(a − ε), None where a ≤ ε
    curvatures: Vector  # (n + nc,) eigenvalues of ∇²V(z̄), ascending
    spectrum: npt.NDArray[np.complex128]  # (n + nc,) of the linearisation at z̄, slowest first, 1/s


def measure(design: Design) -> Measures:
    """All of it, from the stored weights."""
    epsilon = loss(design)
    spectrum = design.spectrum
    return Measures(
        loss=epsilon,
        gradient_norm=float(np.linalg.norm(gradient_and_hessian(design)[0])),
        distance=float(np.linalg.norm(design.z_bar - design.z_star)),
        bound_paper=published_bound(epsilon, design.a),
        curvatures=np.asarray(np.linalg.eigvalsh(design.lyapunov.hessian(design.z_bar)), float),
        spectrum=spectrum[np.argsort(-spectrum.real, kind="stable")],
    )
