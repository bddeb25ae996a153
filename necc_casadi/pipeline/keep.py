"""The design that is kept, and what is proved of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from necc_casadi.methods.method import Method
from necc_casadi.model.family_loop import FamilyLoop, NoFamily
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.model_file import Model
from necc_casadi.model.ranges import Range
from necc_casadi.pipeline.clock import Clock
from necc_casadi.pipeline.disturbances import read_disturbances
from necc_casadi.pipeline.families import family_of, refused_by_all, with_family
from necc_casadi.pipeline.judge import Task
from necc_casadi.pipeline.request import Request

if TYPE_CHECKING:  # what --check does not need is loaded when it is reached
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.choice.choose import Choice
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.family import Family

__all__ = ["Kept", "keep", "no_family"]


def _chosen(request: Request, task: Task, clock: Clock) -> tuple[Choice, Task]:
    """Train, damp and prove what the options leave to choose from, and keep one.

    The task that comes back names the structure that is kept.
    """
    from necc_casadi.choice.structures import best_structure

    methods = (task.method, *task.found.alternatives)

    def family(method: Method) -> FamilyLoop | None:
        if request.integral is not False:
            return None
        return family_of(task.model, method, task.x_star, task.options)

    kept = best_structure(methods, task.x_star, task.options, clock.say, family)
    clock.timings.update(kept.seconds)
    found = replace(task.found, chosen=kept.method, passed=kept.passed)
    return kept.choice, replace(task, found=found)


@dataclass(frozen=True, eq=False)
class Kept:
    """The design that is kept and what is proved of it, with why its V is the one that is kept."""

    design: Design
    certificate: Certificate
    choice: Choice
    family: Family | None = None
    because: str | None = None  # nothing is proved of the family


def keep(request: Request, task: Task, clock: Clock) -> tuple[Kept, Task]:
    """The choice, with integral action on top and the sampled loop proved where asked for."""
    choice, task = _chosen(request, task, clock)
    made, certificate = _with_plants(request, task, choice, clock)
    family, because = None, None
    if task.model.ranges and request.integral is False:
        with clock.stage("family", "proving the family"):
            certificate, family, because = with_family(made, certificate, task.model)
    certificate = _with_sampled_loop(request, made, certificate, clock)
    return Kept(made, certificate, choice, family, because), task


def no_family(request: Request, task: Task) -> NoFamily | None:
    """Why no loop that may be taken holds the target for all of the ranges, proved."""
    first = task.found.chosen
    if first is None or request.integral is not False:
        return None
    methods = (first, *task.found.alternatives)
    return refused_by_all(task.model, methods, task.x_star, task.options)


def _with_plants(
    request: Request, task: Task, choice: Choice, clock: Clock
) -> tuple[Design, Certificate]:
    """The design that was chosen, with integral action where it is asked for."""
    plants = None
    ranges = task.model.ranges
    if ranges.uncertain and task.model.parametric is not None:
        plants = Plants(task.model.parametric, ranges.uncertain)
    if request.integral is False:
        made, certificate = choice.design, choice.certificate
        told = _told(task.model)
        if ranges.setpoints or told is not None:
            with clock.stage("setpoints", "proving a box for all set-points"):
                made, certificate = _with_setpoints(made, certificate, ranges.setpoints, told)
        return made, _with_momenta(made, certificate, plants)
    from necc_casadi.certificate.prover.certify import certify
    from necc_casadi.synthesis.integral import with_integral

    with clock.stage("integral", "adding integral action"):
        tau = None if request.integral is True else float(request.integral)
        made = with_integral(choice.design, tau, plants, ranges.disturbance)
        return made, certify(made, plants=plants, disturbance=ranges.disturbance)


def _with_sampled_loop(
    request: Request, made: Design, certificate: Certificate, clock: Clock
) -> Certificate:
    """The certificate with what is proved of the loop that the C code makes."""
    from necc_casadi.certificate.prover.certify import with_sampled_loop

    if request.sample_time is None:
        return certificate
    with clock.stage("sampled", "proving the sampled loop"):
        asked = read_disturbances(request, made.loop.plant)
        return with_sampled_loop(made, certificate, request.sample_time, request.integrator, asked)


def _with_setpoints(
    made: Design, certificate: Certificate, setpoints: Mapping[str, Range], told: Plants | None
) -> tuple[Design, Certificate]:
    """The design with set-points that move and parameters that are told, where its code can.

    What else is proved of it stays as it is.
    """
    from necc_casadi.certificate.claims.statements import SETPOINTS_ARE_NOT_COVERED
    from necc_casadi.certificate.prover.setpoints import prove_setpoints

    moving = replace(made, setpoints=setpoints, told=told)
    claim = prove_setpoints(moving)
    if claim is not None and claim.statement == SETPOINTS_ARE_NOT_COVERED:
        return made, certificate
    claims = certificate.claims if claim is None else (*certificate.claims, claim)
    return moving, replace(certificate, design_hash=moving.hash, claims=claims)


def _told(model: Model) -> Plants | None:
    """The plant with the parameters that are told at run time; None where none are."""
    if not model.told or model.parametric is None:
        return None
    known = {k: v for k, v in model.parametric.values.items() if k not in model.told}
    return Plants(model.parametric.at(known), model.told)


def _with_momenta(made: Design, certificate: Certificate, plants: Plants | None) -> Certificate:
    """The certificate with what is proved of momenta that are fed from plants that vary."""
    if plants is None:
        return certificate
    from necc_casadi.certificate.prover.momenta import prove_momenta

    claim = prove_momenta(made, plants)
    return (
        certificate if claim is None else replace(certificate, claims=(*certificate.claims, claim))
    )
