"""What is measured and simulated of the design that is kept."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import InputError
from necc_casadi.model.modulated import System
from necc_casadi.model.parametric import Parametric
from necc_casadi.pipeline.advice import design_notes, region_notes, response_notes
from necc_casadi.pipeline.clock import Clock
from necc_casadi.pipeline.families import family_notes
from necc_casadi.pipeline.judge import Task, train
from necc_casadi.pipeline.keep import Kept
from necc_casadi.pipeline.request import Request, read_model
from necc_casadi.report.findings import Findings
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.synthesis.options import Options

if TYPE_CHECKING:  # what --check does not need is loaded when it is reached
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.family import Family
    from necc_casadi.export.sampled_loop import SampledLoop
    from necc_casadi.performance.beside_proof import BesideProof
    from necc_casadi.performance.measure import Performance
    from necc_casadi.simulation.responses import Trajectory

__all__ = ["study"]


_RESPONSES = 10


#: A parameter that is not known well, over the one of the model.
_LARGER = sp.Rational(11, 10)


#: Seconds of computing that all responses together may take.
_PATIENCE = 10.0


def study(request: Request, task: Task, found: Findings, kept: Kept, clock: Clock) -> Findings:
    """What is to be known of the design that is kept, nothing written."""
    from necc_casadi.performance.shares import sampled_share

    made, certificate, choice = kept.design, kept.certificate, kept.choice
    motion = _simulated(made, clock)
    share = sampled_share(made, certificate) if made.integral is None else None  # Ω is without ζ
    sweep: tuple[SweepPoint, ...] = ()
    if request.sweep_a is not None:
        sweep = _swept(request.sweep_a, task, choice.kept.options, clock)
    performance = _compared(request, task, made, clock) if request.compare else None
    sampling = _sampled(request, made)
    warning = None if sampling is None else sampling.warning
    return replace(
        found,
        found=task.found,
        design=made,
        certificate=certificate,
        choice=choice if made.integral is None else None,
        responses=motion.responses,
        domain_share=share,
        simulated_share=motion.share,
        sampling=sampling,
        family=kept.family,
        beside=_beside_proof(made, certificate, kept.family, task.model.parametric, clock),
        asked=choice.kept.asked if made.integral is None else None,
        performance=performance,
        parameter_errors=_displaced(request, task, made, performance, clock),
        sweep=sweep,
        notes=(
            *task.notes,
            *design_notes(made, task.options),
            *(() if kept.because is None else (f"family: {kept.because}",)),
            *family_notes(made, task.model, kept.family),
            *region_notes(certificate, share, task.options),
            *response_notes(motion.responses, _PATIENCE),
            *(() if warning is None else (warning,)),
        ),
        timings=dict(clock.timings),
    )


@dataclass(frozen=True, eq=False)
class _Motion:
    """The design in time."""

    responses: tuple[Trajectory, ...]  # from random states of the domain
    share: float | None  # of such states from which it converges; None: not known


def _simulated(made: Design, clock: Clock) -> _Motion:
    """Simulate, for no longer than somebody waits."""
    from necc_casadi.simulation.convergence import simulated_share
    from necc_casadi.simulation.responses import random_states, response_from

    with clock.stage("simulate", "simulating"):
        ends = time.perf_counter() + _PATIENCE
        responses = tuple(
            response_from(made, x0, patience=max(0.0, ends - time.perf_counter()))
            for x0 in random_states(made, _RESPONSES, made.seed)
        )
        return _Motion(responses, simulated_share(made, made.momenta, made.seed))


def _beside_proof(
    made: Design,
    certificate: Certificate,
    family: Family | None,
    parametric: Parametric | None,
    clock: Clock,
) -> BesideProof | None:
    """Plants that the proof is about, simulated; None where it is about one plant."""
    from necc_casadi.performance.beside_proof import beside_proof, proved

    found = proved(made, certificate, family)
    if found is None:
        return None
    with clock.stage("plants", "simulating plants of the ranges that are proved"):
        return beside_proof(made, found, parametric, made.seed)


def _compared(request: Request, task: Task, made: Design, clock: Clock) -> Performance:
    """Measure the design beside LQR and the optimum, and on plants that differ a little."""
    from necc_casadi.performance.measure import measure

    with clock.stage("compare", "comparing with LQR and the optimum"):
        others = _with_larger_parameters(request, task)
        return measure(made, cost=task.options.cost(made.sizes, made.loop.plant.n), others=others)


def _displaced(
    request: Request, task: Task, made: Design, known: Performance | None, clock: Clock
) -> Mapping[str, Vector | None]:
    """Where a controller that contains the model rests when a parameter is wrong."""
    from necc_casadi.performance.steady_error import parameter_errors

    if task.method.name == "interconnection":
        return {}
    if known is not None:
        return known.errors.parameters
    with clock.stage("compare", "trying other parameters"):
        return parameter_errors(made, _with_larger_parameters(request, task))


def _with_larger_parameters(request: Request, task: Task) -> dict[str, System]:
    """The plant with each of its parameters a little larger, by name."""
    others = {}
    for name, value in task.model.params.items():
        if value != 0:
            changed = f"{name}={sp.sstr(value * _LARGER)}"
            with contextlib.suppress(InputError):  # no such plant: nothing to hold
                others[name] = read_model(request, changed).system
    return others


def _sampled(request: Request, made: Design) -> SampledLoop | None:
    """The loop that the C code makes with the sample time asked for."""
    if request.sample_time is None:
        return None
    from necc_casadi.export.sampled_loop import analyse_sampling

    return analyse_sampling(made, request.sample_time, request.integrator)


def _swept(
    values: tuple[float, float, int], task: Task, options: Options, clock: Clock
) -> tuple[SweepPoint, ...]:
    """Designs made like the one that is kept, whether a network can reach their a or not."""
    from necc_casadi.pipeline.sweep import sweep_a

    with clock.stage("sweep", "sweeping a"):
        return sweep_a(
            values,
            lambda a: train(task, replace(options, a=a, keep_a=True), clock.say),
            clock.say,
        )
