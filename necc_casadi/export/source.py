"""What the C code is made from: a design and the options of the export."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from necc_casadi.cases import NAME_IN_C, Integrator, Precision
from necc_casadi.casimirs.outputs import refuse_without_time
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.designs.design import Design, refuse_other
from necc_casadi.errors import OptionError
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.kept_casimirs import KeptCasimirs, kept_casimirs
from necc_casadi.export.sampled_loop import largest_stable_time
from necc_casadi.export.templating import PREFIX, prefixed
from necc_casadi.lyapunov.damping import is_coupled
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.shaped_loop import ShapedLoop

__all__ = ["Source"]


#: s: no controller is called at such periods.
_FOREVER = 1e30


#: Samples in one natural time, and how far below the largest stable sample time, by default.
_PER_NATURAL_TIME, _BELOW_LARGEST = 100, 10


@dataclass(frozen=True, eq=False)
class Source:
    """A design with the options of :func:`necc_casadi.export.c_project.export_c`, checked.

    Raises
    ------
    OptionError
        For an unknown type or integrator, one that does not fit the design, a sample time that is
        not positive, a prefix that is no beginning of a name in C, or the certificate of another
        design.
    """

    design: Design
    real: Precision = "double"
    sample_time: float | None = None  # s
    integrator: Integrator = "heun"
    certificate: Certificate | None = None
    prefix: str = PREFIX
    parametric: Parametric | None = None  # the plant with its parameters as symbols

    def __post_init__(self) -> None:
        if self.real not in get_args(Precision):
            raise OptionError(
                "usage", f"real = {self.real!r}", f"Use {' or '.join(get_args(Precision))}."
            )
        known = get_args(Integrator)
        if self.integrator not in known:
            raise OptionError(
                "usage", f"integrator = {self.integrator!r}", f"Use {', '.join(known)}."
            )
        if self.sample_time is not None and not 0 < self.sample_time < np.inf:
            raise OptionError(
                "usage", f"the sample time is {self.sample_time}", "Give seconds, above 0."
            )
        if re.fullmatch(NAME_IN_C, self.prefix) is None:
            raise OptionError(
                "usage",
                f"--prefix {self.prefix!r} cannot begin the names of C",
                "Use a letter, then letters, digits and _, at most 31 together.",
            )

        if self.kept is not None:
            self.kept.checked_steps(self.step_time)
        if self.certificate is not None:
            refuse_other(self.design, self.certificate)

    @property
    def certificate_hash(self) -> str | None:
        """SHA-256 of certificate.json."""
        if self.certificate is None:
            return None
        return hashlib.sha256(self.certificate.to_json().encode()).hexdigest()

    @property
    def claims(self) -> tuple[str, ...]:
        """What is claimed of the loop in continuous time, in words."""
        held = self._held
        own = ("sampled", "disturbed")
        return tuple(claim.statement for claim in held if claim.name not in own)

    @property
    def sampled_claim(self) -> str | None:
        """What is claimed of the loop that this code makes, in words; None of another method."""
        region = None if self.certificate is None else self.certificate.sampled
        if region is None or region.integrator != self.integrator:
            return None
        return next((claim.statement for claim in self._held if claim.name == "sampled"), None)

    @property
    def disturbed_claim(self) -> str | None:
        """The same under rounding of the type of this code, noise and delay."""
        if self.sampled_claim is None:
            return None
        same = (c for c in self._held if c.name == "disturbed" and c.data["precision"] == self.real)
        return next((claim.statement for claim in same), None)

    @property
    def _held(self) -> tuple[Claim, ...]:
        claims = () if self.certificate is None else self.certificate.claims
        return tuple(claim for claim in claims if claim.holds)

    def named(self, code: str) -> str:
        """C code with the prefix of this export."""
        return prefixed(code, self.prefix)

    @property
    def number(self) -> Real:
        """The type of the exported numbers."""
        return Real(self.real)

    @property
    def n(self) -> int:
        """Number of plant states."""
        return self.design.loop.plant.n

    @property
    def nc(self) -> int:
        """Number of controller states."""
        return self.design.loop.controller.nc

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.design.loop.plant.m

    @property
    def r(self) -> int:
        """Number of Casimirs."""
        return len(self.design.casimirs.functions)

    @property
    def shaped(self) -> bool:
        """Whether the code keeps ξ − γ(x) in place of ξ."""
        return isinstance(self.design.loop, ShapedLoop)

    @property
    def scales_rate(self) -> bool:
        """Whether limits of u scale damping that moves ξ, too."""
        design = self.design
        return design.scales_damping and is_coupled(design.damping, self.m)

    @property
    def asked(self) -> str:
        """What in ``necc_output`` is added to, of u."""
        return "resting" if self.design.scales_damping else "v"

    @property
    def measures_velocity(self) -> bool:
        """Whether the code takes q̇ where the model has momenta."""
        return self.design.measurement.of_velocities

    @property
    def zeta_names(self) -> list[str]:
        """Names of the entries of ζ; none without integral action."""
        return [] if self.design.integral is None else [f"zeta{i + 1}" for i in range(self.m)]

    @property
    def input_columns(self) -> list[str]:
        """Names of the inputs in tables and units: u1 … um where they have none of their own."""
        return list(self.design.loop.plant.inputs) or [f"u{i + 1}" for i in range(self.m)]

    @cached_property
    def kept(self) -> KeptCasimirs | None:
        """What is kept of ξ where it is not integrated; None: it is."""
        if self.integrator != "casimir":
            return None
        if self.sample_time is None:
            refuse_without_time()
        return kept_casimirs(self.design)

    @property
    def substeps(self) -> int:
        """Steps that ξ takes at a sample where Casimirs are kept; else 1."""
        return 1 if self.kept is None else self.kept.steps(self.step_time)

    @property
    def longest_due(self) -> float:
        """Of a longer period no more counts for these steps, s."""
        fastest = 0.0 if self.kept is None else self.kept.fastest
        return min(self.substeps / fastest, _FOREVER) if fastest > 0 else _FOREVER

    @property
    def neural_phi(self) -> bool:
        """Whether Φ is a network; else Φ = H + Hc + C and Φ₁ = Φ₂ = 1."""
        return self.design.form.phi is not None

    @cached_property
    def step_time(self) -> float:
        """The sample time, or else one far from the stability limit and the natural time, s."""
        if self.sample_time is not None:
            return self.sample_time
        largest = largest_stable_time(self.design, self.integrator)
        times = [self.design.sizes.time / _PER_NATURAL_TIME]
        times += [] if largest is None else [largest / _BELOW_LARGEST]
        return float(f"{min(times):.1g}")
