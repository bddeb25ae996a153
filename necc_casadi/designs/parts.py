"""What a finished design consists of, as values: what design.json holds and nothing derived."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.cases import InitialXi
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.integral import Integral
from necc_casadi.designs.outcome import Residual, Start
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.ranges import Range
from necc_casadi.model.sizes import Sizes
from necc_casadi.verdict.verdict import Verdict

__all__ = ["Parts"]


def _package_versions() -> dict[str, str]:
    """Versions of this package and of those whose arithmetic a design rests on."""
    names = ("necc-casadi", "casadi", "numpy", "sympy", "python-flint")
    return {name: metadata.version(name) for name in names}


#: Stands for sizes that are all 1.
_OF_THE_MODEL = Sizes.ones(0, 0, 0)


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
    damping: Vector  # 𝒟, (m + channels)², symmetric part ≻ 0
    a: float  # curvature asked of ∇²V(z*)
    a_requested: float
    seed: int
    starts: tuple[Start, ...] = ()
    initial_xi: InitialXi = "target"  # where ξ starts
    initial_gain: Vector | None = None  # T, (nc, n), where it starts at ξ* + T(x(0) − x*)
    integral: Integral | None = None  # integral action on the position; None: without
    #: coordinate → range in which its set-point moves at run time; {}: it does not
    setpoints: Mapping[str, Range] = field(default_factory=dict)
    told: Plants | None = None  # parameters that the controller is told at run time; None: none
    learned: Residual | None = None  # of a learned Casimir; None: Casimirs in closed form
    versions: Mapping[str, str] = field(default_factory=_package_versions)
    sizes: Sizes = _OF_THE_MODEL  # natural sizes at the target; by default the model's units
    units: Sizes = _OF_THE_MODEL  # powers of two near them: natural units
    #: (n + nc,) diagonal asked of ∇²V̂(z*), natural units; by default that of `a`
    curvature: Vector = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Without sizes a design is looked at in the units of its model."""
        N, m, r = self.loop.n, self.loop.plant.m, len(self.casimirs.functions)
        for name, default in (("sizes", Sizes.ones(N, m, r)), ("units", Sizes.ones(N, m, r))):
            if getattr(self, name) is _OF_THE_MODEL:
                object.__setattr__(self, name, default)
        if not self.curvature.size:
            in_units = self.units.state**2 / self.units.energy
            object.__setattr__(self, "curvature", self.a * in_units)

    @property
    def D(self) -> Vector:
        """Damping of the plant's port, u per y: the first diagonal block of 𝒟, (m, m)."""
        m = self.loop.plant.m
        return self.damping[:m, :m]

    @property
    def Dc(self) -> Vector:
        """Damping of the controller's port: the second diagonal block of 𝒟, (channels)²."""
        m = self.loop.plant.m
        return self.damping[m:, m:]
