"""Everything that one run found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import OptionError
from necc_casadi.methods.find import Found
from necc_casadi.methods.method import Method
from necc_casadi.model.modulated import System
from necc_casadi.model.parametric import Parametric
from necc_casadi.report.sweep_point import SweepPoint

if TYPE_CHECKING:  # a verdict alone needs none of these
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.certificate.claims.claim import Claim
    from necc_casadi.choice.choose import Choice
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.family import Family
    from necc_casadi.designs.measures import Measures
    from necc_casadi.export.sampled_loop import SampledLoop
    from necc_casadi.model.family_loop import NoFamily
    from necc_casadi.performance.beside_proof import BesideProof
    from necc_casadi.performance.measure import Performance
    from necc_casadi.simulation.responses import Trajectory
    from necc_casadi.synthesis.asked import Asked

__all__ = ["Findings", "attracts", "global_claim", "held_claim", "region_claim"]


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that one run found; what was not reached is None."""

    system: System  # the plant as the model file gives it
    x_star: Mapping[sp.Symbol, sp.Expr]
    found: Found
    design: Design | None = None
    certificate: Certificate | None = None
    choice: Choice | None = None  # why this design, and how it responds with clipped inputs
    responses: Sequence[Trajectory] = ()
    domain_share: float | None = None  # of random states of the domain, momenta at rest, in Ω
    simulated_share: float | None = None  # of such states, from which the loop converges
    sampling: SampledLoop | None = None
    asked: Asked | None = None  # of the response
    performance: Performance | None = None  # with --compare
    parameter_errors: Mapping[str, Vector | None] = field(default_factory=dict)  # as of Errors
    sweep: Sequence[SweepPoint] = ()
    family: Family | None = None  # that the design is one of
    beside: BesideProof | None = None  # plants that a proof is about, simulated
    no_family: NoFamily | None = None  # why there is provably none
    parametric: Parametric | None = None  # the plant with its parameters as symbols
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()  # relative to the folder that was written
    timings: Mapping[str, float] = field(default_factory=dict)  # s, by stage

    @property
    def method(self) -> Method | None:
        """The loop that is to hold the target."""
        return self.found.chosen

    @cached_property
    def measures(self) -> Measures | None:
        """What the design reached."""
        from necc_casadi.designs.measures import measure

        return None if self.design is None else measure(self.design)

    @property
    def finished(self) -> tuple[Design, Certificate]:
        """The design and what is proved of it.

        Raises
        ------
        OptionError
            Where the run ended before a design.
        """
        if self.design is None or self.certificate is None:
            raise OptionError(
                "usage",
                f"{self.system.name}: there is no design, the run ended {self.status}",
                "The verdict says why, and what would work.",
            )
        return self.design, self.certificate

    @property
    def status(self) -> str:
        """The word for the outcome, see docs/contract.md#json."""
        if self.found.refused or self.no_family is not None:
            return "refused"
        if self.design is None:
            known = self.method is not None and self.method.verdict.assignable
            return "assignable" if known else "undecided"
        from necc_casadi.designs.error_bound import ACCEPTED_LOSS, natural_loss

        certified = self.certificate is not None and self.certificate.certified
        certified = certified and (self.asked is None or self.asked.met)
        fit = certified and natural_loss(self.design) <= ACCEPTED_LOSS and not self.faults
        return "certified" if fit else "fell_short"

    @property
    def faults(self) -> tuple[str, ...]:
        """What the response has against what is claimed: nothing is certified then."""
        if self.choice is None:
            return ()
        from necc_casadi.choice.fitness import response_faults

        return response_faults(self.choice.kept)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the response has beyond what is claimed, and V elsewhere."""
        if self.choice is None:
            return self._restless
        from necc_casadi.choice.fitness import response_warnings

        return response_warnings(self.choice)

    @property
    def _restless(self) -> tuple[str, ...]:
        """Random starts that do not settle, where nothing else is known of responses."""
        left = sum(not response.converged for response in self.responses)
        if not left:
            return ()
        return (f"{left} of {len(self.responses)} random starts do not settle at the target",)

    @property
    def exit_code(self) -> int:
        """The exit code for the outcome, see docs/contract.md#exit-codes."""
        return {"certified": 0, "assignable": 0, "refused": 3}.get(self.status, 4)


def region_claim(certificate: Certificate) -> Claim | None:
    """The claim about the region."""
    return _named(certificate, "region")


def global_claim(certificate: Certificate) -> Claim | None:
    """The claim about the whole space."""
    return _named(certificate, "global")


def held_claim(certificate: Certificate | None, name: str) -> Claim | None:
    """A claim that is proved; None without it."""
    claim = None if certificate is None else _named(certificate, name)
    return claim if claim is not None and claim.holds else None


def _named(certificate: Certificate, name: str) -> Claim | None:
    return next((claim for claim in certificate.claims if claim.name == name), None)


def attracts(claim: Claim) -> bool:
    """Whether all solutions from a proved region, or from anywhere, converge; or they stay."""
    return claim.holds and claim.data.get("follows") == "converges"
