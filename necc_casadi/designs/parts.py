"""What a finished design consists of, as values: what design.json holds and nothing derived."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.outcome import Residual, Start
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.sizes import Sizes
from necc_casadi.verdict.verdict import Verdict

__all__ = ["Parts"]


def _package_versions() -> dict[str, str]:
    """Versions of this package and of those whose arithmetic a design rests on."""
    names = ("necc-casadi", "casadi", "numpy", "sympy", "python-flint")
    return {name: metadata.version(name) for name in names}


@dataclass(frozen=True, eq=False)
class Parts:
    """Model, Casimirs, verdict, weights, equilibrium and damping."""

    loop: ClosedLoop
    casimirs: Casimirs
    x_star: tuple[sp.Expr, ...]  # (n,) exact
    verdict: Verdict
    form: Form
    weights: Vector  # (form.size,)
    xi_star: Vector  # (nc,)
    D: Vector  # m × m
    Dc: Vector  # m × m
    a: float  # curvature asked of ∇²V(z*)
    a_requested: float
    sizes: Sizes  # natural sizes at the target
    units: Sizes  # powers of two near them, of the design in natural units
    curvature: Vector  # (n + nc,) diagonal asked of ∇²V̂(z*), natural units: at least a S²/E
    seed: int
    starts: tuple[Start, ...] = ()
    learned: Residual | None = None  # of a learned Casimir; None: Casimirs in closed form
    versions: Mapping[str, str] = field(default_factory=_package_versions)
