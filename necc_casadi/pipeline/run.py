"""One run of ``necc-design``, stage by stage: verdict, design, certificate, responses, files.

Each stage takes what it needs and returns what it found; :func:`run_design` alone puts that
together.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.choice.choose import Choice, choose
from necc_casadi.choice.fitness import response_faults
from necc_casadi.choice.judged import Judged
from necc_casadi.designs.design import Design
from necc_casadi.designs.outcome import Start
from necc_casadi.errors import InputError
from necc_casadi.export.sampled_loop import SampledLoop
from necc_casadi.files import LISTING, check_writable, write_text
from necc_casadi.folders import whole_folder
from necc_casadi.methods.find import Found, find_method
from necc_casadi.methods.method import Method
from necc_casadi.model.model_file import Model, load_model
from necc_casadi.model.plant import Plant
from necc_casadi.model.spot_checks import check_model_at
from necc_casadi.performance.shares import sampled_share
from necc_casadi.pipeline.advice import (
    design_notes,
    loop_notes,
    nearest_note,
    region_notes,
    response_notes,
    structure_offers,
)
from necc_casadi.pipeline.clock import Clock, Say
from necc_casadi.pipeline.request import (
    Request,
    read_options,
    read_parameters,
    read_target,
    with_structure,
)
from necc_casadi.pipeline.sweep import sweep_a
from necc_casadi.report.figures import (
    lyapunov_figure,
    region_boundary,
    region_figure,
    responses_figure,
    sweep_figure,
    write_figure,
)
from necc_casadi.report.findings import Findings
from necc_casadi.report.landscape_figure import landscape_figure
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.simulation.convergence import simulated_share
from necc_casadi.simulation.responses import Trajectory, random_states, simulate
from necc_casadi.synthesis.asked import Answer
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.synthesis import answered

if TYPE_CHECKING:
    from necc_casadi.performance.measure import Performance

__all__ = ["run_design"]


#: Structures of one method that are designed for, to keep the one that responds best.
_STRUCTURES = 2


#: Multiple of LQR's cost up to which the first one will do.
_CHEAP = 2.0


_RESPONSES = 10


#: Points of a response in the plane of two states.
_POINTS = 251


#: A parameter that is not known well, over the one of the model.
_LARGER = sp.Rational(11, 10)


#: Seconds of computing that all responses together may take.
_PATIENCE = 10.0


#: A file of others in one of these places is found before any training.
_EXPECTED = ("design.json", "certificate.json", "c/necc.h", "c/necc.c")


def run_design(request: Request, say: Say) -> Findings:
    """Judge the target and, where it is assignable, design, certify, simulate and write.

    Raises
    ------
    InputError
        For a model, a target, an option or a folder that cannot be used; before any training.
    """
    clock = Clock(say)
    with clock.stage("symbolic", "reading the model"):
        task = _judged(request, say)
    found = Findings(
        task.model.system,
        task.x_star,
        task.found,
        notes=task.notes,
        timings=dict(clock.timings),
    )
    if task.found.chosen is None or request.check:
        return found
    figures = ("figures/lyapunov.png",) if request.plots else ()
    with whole_folder(request.out, (*_EXPECTED, *figures)) as folder:
        return _made(request, task, found, folder, clock)


def _made(request: Request, task: _Task, found: Findings, folder: Path, clock: Clock) -> Findings:
    """Everything after a favourable verdict; files go into `folder`."""
    choice, method = _chosen(task, clock)
    task = replace(task, found=replace(task.found, chosen=method))
    found = replace(found, found=task.found)
    made, certificate = choice.design, choice.certificate
    files = _saved(made, certificate, folder)
    with ThreadPoolExecutor(1) as pool:  # compilers run while the loop is simulated and drawn
        exported = pool.submit(_exported, request, made, certificate, folder, clock)
        motion, share = _simulated(made, clock), sampled_share(made, certificate)
        sweep: tuple[SweepPoint, ...] = ()
        if request.sweep_a is not None:
            sweep = _swept(request.sweep_a, task, choice.kept.options, clock)
        performance = _compared(request, task, made, clock) if request.compare else None
        drawn = _drawn(
            request, made, certificate, motion.responses, sweep, performance, folder, clock
        )
        export = exported.result()
    return replace(
        found,
        design=made,
        certificate=certificate,
        choice=choice,
        responses=motion.responses,
        domain_share=share,
        simulated_share=motion.share,
        sampling=export.sampling,
        asked=choice.kept.asked,
        performance=performance,
        sweep=sweep,
        notes=(
            *task.notes,
            *design_notes(made, task.options),
            *region_notes(certificate, share, task.options),
            *response_notes(motion.responses, _PATIENCE),
            *export.notes,
        ),
        files=(
            *(path.relative_to(folder).as_posix() for path in (*files, *export.files, *drawn)),
            LISTING,
        ),
        timings=dict(clock.timings),
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """A judged target, and what the design is asked for."""

    model: Model
    x_star: dict[sp.Symbol, sp.Expr]
    found: Found
    options: Options
    notes: tuple[str, ...]

    @property
    def method(self) -> Method:
        """The loop that is to hold the target."""
        if self.found.chosen is None:
            raise ValueError("no method holds the target")
        return self.found.chosen


def _judged(request: Request, say: Say) -> _Task:
    """Read the model, find its Casimirs, judge the target."""
    if not request.check:
        check_writable(request.out)
    model = load_model(request.model, read_parameters(request.param))
    options = read_options(request, model)
    x_star = read_target(model, request.target)
    is_plant = isinstance(model.system, Plant)
    notes = [*model.notes, *(check_model_at(model.loop, x_star) if is_plant else ())]
    if request.structure is not None:
        model = with_structure(model, request.structure, x_star)
    found = find_method(
        model, x_star, request.method, say, most=1 if request.check else _STRUCTURES
    )
    if options.learn_casimir and found.learnable is not None:
        found = replace(found, chosen=found.learnable)
    if found.chosen is not None and not is_plant:
        notes += check_model_at(found.chosen.loop, x_star)
    if found.published is not None:
        notes += loop_notes(found.published, x_star)
    verdict = None if found.published is None else found.published.verdict
    if verdict is not None and verdict.reason == "not_an_equilibrium":
        notes += nearest_note(model, x_star)
    if is_plant and request.structure is None and _wants_more(found):
        say("searching for a controller structure that helps")
        notes += structure_offers(model, x_star)
    return _Task(model, x_star, found, options, tuple(notes))


def _wants_more(found: Found) -> bool:
    """Whether another controller structure of the published loop might hold more."""
    chosen = found.chosen
    return chosen is None or chosen.verdict.stability != "asymptotic"


def _trained(task: _Task, options: Options, say: Say) -> Design:
    """One design at the target with these options."""
    return _answered(task, options, say).design


def _answered(task: _Task, options: Options, say: Say) -> Answer:
    """The same, with how far the response is what was asked."""
    outcomes: list[Start] = []

    def report(start: Start) -> None:
        outcomes.append(start)
        say(f"training: start {len(outcomes)} of {options.starts}, loss {start.loss:.1e}")

    method = task.method
    return answered(method.loop, method.casimirs, method.verdict, task.x_star, options, report)


def _chosen(task: _Task, clock: Clock) -> tuple[Choice, Method]:
    """Train, damp and prove what the options leave to choose from, and keep one."""
    made: list[tuple[Choice, Method]] = []
    for method in (task.method, *task.found.alternatives):
        if made and _is_good(made[0][0].kept):
            break
        choice = choose(
            method.loop, method.casimirs, method.verdict, task.x_star, task.options, clock.say
        )
        made.append((choice, method))
        for stage, seconds in choice.seconds.items():
            clock.timings[stage] = clock.timings.get(stage, 0.0) + seconds
    return max(made, key=lambda pair: _fitness(pair[0].kept))


def _is_good(kept: Judged) -> bool:
    """Whether another structure need not be tried."""
    cheap = kept.cost_to_lqr is not None and kept.cost_to_lqr <= _CHEAP
    return cheap and kept.proved and not response_faults(kept)


def _fitness(kept: Judged) -> tuple[bool, int, float]:
    """What is proved, how many starts arrive, and what they cost: the more the better."""
    cost = kept.cost_to_lqr
    return (
        kept.proved and not response_faults(kept),
        kept.arrivals,
        -np.inf if cost is None else -cost,
    )


def _saved(made: Design, certificate: Certificate, out: Path) -> list[Path]:
    """Write the design and its certificate."""
    return [
        made.save(out / "design.json"),
        write_text(out / "certificate.json", certificate.to_json()),
    ]


@dataclass(frozen=True, eq=False)
class _Motion:
    """The design in time."""

    responses: tuple[Trajectory, ...]  # from random states of the domain
    share: float | None  # of such states from which it converges; None: not known


def _simulated(made: Design, clock: Clock) -> _Motion:
    """Simulate, for no longer than somebody waits."""
    with clock.stage("simulate", "simulating"):
        ends = time.perf_counter() + _PATIENCE
        responses = tuple(
            simulate(made, x0, patience=max(0.0, ends - time.perf_counter()))
            for x0 in random_states(made, _RESPONSES, made.seed)
        )
        return _Motion(responses, simulated_share(made, made.momenta, made.seed))


@dataclass(frozen=True)
class _Export:
    """Code that was written, and the loop that it makes with the sample time asked for."""

    files: tuple[Path, ...]
    sampling: SampledLoop | None

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know about the sample time."""
        warning = None if self.sampling is None else self.sampling.warning
        return () if warning is None else (warning,)


def _compared(request: Request, task: _Task, made: Design, clock: Clock) -> Performance:
    """Measure the design beside LQR and the optimum, and on plants that differ a little."""
    from necc_casadi.performance.measure import measure

    given, values = read_parameters(request.param), task.model.params
    with clock.stage("compare", "comparing with LQR and the optimum"):
        others = {}
        for name, value in values.items():
            if value != 0:
                changed = {**given, name: sp.sstr(value * _LARGER)}
                with contextlib.suppress(InputError):  # no such plant: nothing to hold
                    others[name] = load_model(request.model, changed).system
        return measure(made, cost=task.options.cost(made.sizes, made.loop.plant.n), others=others)


def _exported(
    request: Request, made: Design, certificate: Certificate, out: Path, clock: Clock
) -> _Export:
    """Write the C controller and what was asked for around it; look at the sampled loop."""
    from necc_casadi.export.c_project import export_c
    from necc_casadi.export.fmu import export_fmu
    from necc_casadi.export.matlab import export_mex
    from necc_casadi.export.sampled_loop import analyse_sampling

    time, integrator = request.sample_time, request.integrator
    common: dict[str, Any] = {
        "real": request.real,
        "sample_time": time,
        "integrator": integrator,
        "prefix": request.prefix,
        "certificate": certificate,
    }
    with clock.stage("export", "writing the C controller"):
        files = export_c(made, out / "c", **common)
        if request.fmu:
            name = re.sub(r"\W", "_", request.model.stem)
            files.append(export_fmu(made, out / f"{name}.fmu", **common))
        if request.mex:
            files.append(export_mex(made, out / "matlab", request.prefix))
    sampling = None if time is None else analyse_sampling(made, time, integrator)
    return _Export(tuple(files), sampling)


def _swept(
    values: tuple[float, float, int], task: _Task, options: Options, clock: Clock
) -> tuple[SweepPoint, ...]:
    """Designs made like the one that is kept, whether a network can reach their a or not."""
    with clock.stage("sweep", "sweeping a"):
        return sweep_a(
            values,
            lambda a: _trained(task, replace(options, a=a, keep_a=True), clock.say),
            clock.say,
        )


def _drawn(
    request: Request,
    made: Design,
    certificate: Certificate,
    responses: Sequence[Trajectory],
    sweep: Sequence[SweepPoint],
    performance: Performance | None,
    out: Path,
    clock: Clock,
) -> list[Path]:
    """Draw what there is to see."""
    if not request.plots:
        return []
    with clock.stage("figures", "drawing"):
        figures = {
            "lyapunov": lyapunov_figure(made),
            "responses": responses_figure(made, responses),
        }
        if certificate.level is not None:
            starts = region_boundary(made, certificate.level, certificate.reach)
            inside = [simulate(made, start, made.xi_star, points=_POINTS) for start in starts]
            figures["region"] = region_figure(made, certificate.level, inside, certificate.reach)
        landscape = landscape_figure(made, certificate)
        if landscape is not None:
            figures["landscape"] = landscape
        if performance is not None:
            from necc_casadi.report.comparison_figures import frequency_figure, step_figure

            compared = {
                "step": step_figure(made, performance),
                "loop": frequency_figure(made, performance),
            }
            figures |= {name: figure for name, figure in compared.items() if figure is not None}
        if sweep:
            figures["sweep"] = sweep_figure(made, sweep)
        folder = out / "figures"
        return [write_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]
