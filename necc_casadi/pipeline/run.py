"""One run of ``necc-design``, stage by stage: verdict, design, certificate, responses, files.

Each stage takes what it needs and returns what it found; :func:`run_design` alone puts that
together.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.outputs import integrated_outputs
from necc_casadi.errors import InputError
from necc_casadi.files import LISTING, check_writable, write_text
from necc_casadi.folders import whole_folder
from necc_casadi.interrupts import uninterrupted
from necc_casadi.methods.find import Found, find_method
from necc_casadi.methods.method import Method
from necc_casadi.model.family_loop import FamilyLoop, NoFamily
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.model_file import Model
from necc_casadi.model.modulated import System
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant
from necc_casadi.model.ranges import Range
from necc_casadi.model.spot_checks import check_model_at
from necc_casadi.pipeline.advice import (
    design_notes,
    loop_notes,
    nearest_note,
    region_notes,
    response_notes,
    structure_offers,
)
from necc_casadi.pipeline.clock import Clock, Say
from necc_casadi.pipeline.families import (
    family_notes,
    family_of,
    refused_by_all,
    with_family,
)
from necc_casadi.pipeline.ranges import with_ranges
from necc_casadi.pipeline.request import (
    Request,
    read_method,
    read_model,
    read_options,
    read_target,
    with_structure,
)
from necc_casadi.report.findings import Findings
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.synthesis.options import Options

if TYPE_CHECKING:  # what --check does not need is loaded when it is reached
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.choice.choose import Choice
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.family import Family
    from necc_casadi.designs.outcome import Start
    from necc_casadi.export.sampled_loop import SampledLoop
    from necc_casadi.performance.beside_proof import BesideProof
    from necc_casadi.performance.measure import Performance
    from necc_casadi.simulation.responses import Trajectory
    from necc_casadi.synthesis.asked import Answer

__all__ = ["REPORT", "run_design", "write_run"]


#: The page that shows a run.
REPORT = "report.html"


#: Structures that may be designed for, to keep one; the third only if nothing else is proved.
_STRUCTURES = 3


_RESPONSES = 10


#: A parameter that is not known well, over the one of the model.
_LARGER = sp.Rational(11, 10)


#: Seconds of computing that all responses together may take.
_PATIENCE = 10.0


#: A file of others in one of these places is found before any training.
_EXPECTED = ("design.json", "certificate.json", "c/necc.h", "c/necc.c", REPORT)


def run_design(request: Request, say: Say) -> Findings:
    """Judge the target and, where it is assignable, design, certify, simulate and write.

    Nothing is written where the request names no folder.

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
        parametric=task.model.parametric,
        notes=task.notes,
        timings=dict(clock.timings),
    )
    none = _no_family(request, task)
    if none is not None:
        notes = (*task.notes, f"no family: {none.sentence}")
        return replace(found, no_family=none, notes=notes)
    if task.found.chosen is None or request.check:
        return found
    _load_designs()
    if request.out is None:
        kept, task = _kept(request, task, clock)
        return _studied(request, task, found, kept, clock)
    with whole_folder(request.out, _expected(request)) as folder:
        kept, task = _kept(request, task, clock)
        with ThreadPoolExecutor(1) as pool:  # compilers run while the loop is simulated and drawn
            parametric = task.model.parametric
            exported = pool.submit(
                _exported, request, kept.design, kept.certificate, parametric, folder, clock
            )
            found = _studied(request, task, found, kept, clock)
            return _written(request, found, folder, exported.result, clock)


def _load_designs() -> None:
    """Load what designs are made of, CasADi among it: while it starts, it swallows a Ctrl-C."""
    with uninterrupted():
        import_module("necc_casadi.designs.design")


def write_run(request: Request, found: Findings, out: Path, say: Say) -> Findings:
    """Write the folder of a run that was made without one.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    made, certificate = found.finished
    clock = Clock(say, dict(found.timings))
    with whole_folder(out, _expected(request)) as folder:
        return _written(
            request,
            found,
            folder,
            lambda: _exported(request, made, certificate, found.parametric, folder, clock),
            clock,
        )


def _expected(request: Request) -> tuple[str, ...]:
    """Paths at which a file of others is found before any training."""
    figures = (f"figures/lyapunov.{request.format}",) if request.plots else ()
    return (*_EXPECTED, *figures)


def _studied(request: Request, task: _Task, found: Findings, kept: _Kept, clock: Clock) -> Findings:
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


def _written(
    request: Request,
    found: Findings,
    folder: Path,
    exported: Callable[[], list[Path]],
    clock: Clock,
) -> Findings:
    """Everything that is written, into `folder`; `exported` gives the files of the C code."""
    made, certificate = found.finished
    saved = [
        made.save(folder / "design.json"),
        write_text(folder / "certificate.json", certificate.to_json()),
    ]
    if found.parametric is not None:
        from necc_casadi.designs.plant_file import PLANT_FILE, plant_text

        saved.append(write_text(folder / PLANT_FILE, plant_text(made, found.parametric)))
    if found.family is not None:
        from necc_casadi.designs.family import FAMILY_FILE

        saved.append(found.family.save(folder / FAMILY_FILE))
    drawn = _drawn(request, found, folder, clock)
    files = [path.relative_to(folder).as_posix() for path in (*saved, *exported(), *drawn)]
    return replace(found, files=(*files, LISTING), timings=dict(clock.timings))


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
    if request.out is not None and not request.check:
        check_writable(request.out)
    model = with_ranges(read_model(request), request.target, request.uncertain, request.disturbance)
    options = read_options(request, model)
    x_star = read_target(model, request.target)
    is_plant = isinstance(model.system, Plant)
    notes = [*model.notes, *(check_model_at(model.loop, x_star) if is_plant else ())]
    if request.structure is not None:
        model = with_structure(model, request.structure, x_star)
    method = read_method(request, options)
    kept = request.integrator == "casimir"
    most = 1 if request.check or kept else _STRUCTURES
    found = find_method(model, x_star, method, say, most, options.cost)
    if options.learn_casimir and found.learnable is not None:
        found = replace(found, chosen=found.learnable)
    if request.integral is not False and found.chosen is not None:
        from necc_casadi.synthesis.integral import refuse_integral

        held = found.chosen
        refuse_integral(held.loop, held.casimirs.functions, options.phi == "sum")
    if kept and found.chosen is not None:
        integrated_outputs(found.chosen.loop, found.chosen.casimirs.functions)
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
    from necc_casadi.synthesis.synthesis import answered

    outcomes: list[Start] = []

    def report(start: Start) -> None:
        outcomes.append(start)
        say(f"training: start {len(outcomes)} of {options.starts}, loss {start.loss:.1e}")

    method = task.method
    return answered(method.loop, method.casimirs, method.verdict, task.x_star, options, report)


def _chosen(request: Request, task: _Task, clock: Clock) -> tuple[Choice, _Task]:
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
class _Kept:
    """The design that is kept and what is proved of it, with why its V is the one that is kept."""

    design: Design
    certificate: Certificate
    choice: Choice
    family: Family | None = None
    because: str | None = None  # nothing is proved of the family


def _kept(request: Request, task: _Task, clock: Clock) -> tuple[_Kept, _Task]:
    """The choice, with integral action on top and the sampled loop proved where asked for."""
    choice, task = _chosen(request, task, clock)
    made, certificate = _with_plants(request, task, choice, clock)
    family, because = None, None
    if task.model.ranges and request.integral is False:
        with clock.stage("family", "proving the family"):
            certificate, family, because = with_family(made, certificate, task.model)
    certificate = _with_sampled_loop(request, made, certificate, clock)
    return _Kept(made, certificate, choice, family, because), task


def _no_family(request: Request, task: _Task) -> NoFamily | None:
    """Why no loop that may be taken holds the target for all of the ranges, proved."""
    first = task.found.chosen
    if first is None or request.integral is not False:
        return None
    methods = (first, *task.found.alternatives)
    return refused_by_all(task.model, methods, task.x_star, task.options)


def _with_plants(
    request: Request, task: _Task, choice: Choice, clock: Clock
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
        return with_sampled_loop(made, certificate, request.sample_time, request.integrator)


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


def _compared(request: Request, task: _Task, made: Design, clock: Clock) -> Performance:
    """Measure the design beside LQR and the optimum, and on plants that differ a little."""
    from necc_casadi.performance.measure import measure

    with clock.stage("compare", "comparing with LQR and the optimum"):
        others = _with_larger_parameters(request, task)
        return measure(made, cost=task.options.cost(made.sizes, made.loop.plant.n), others=others)


def _displaced(
    request: Request, task: _Task, made: Design, known: Performance | None, clock: Clock
) -> Mapping[str, Vector | None]:
    """Where a controller that contains the model rests when a parameter is wrong."""
    from necc_casadi.performance.steady_error import parameter_errors

    if task.method.name == "interconnection":
        return {}
    if known is not None:
        return known.errors.parameters
    with clock.stage("compare", "trying other parameters"):
        return parameter_errors(made, _with_larger_parameters(request, task))


def _with_larger_parameters(request: Request, task: _Task) -> dict[str, System]:
    """The plant with each of its parameters a little larger, by name."""
    others = {}
    for name, value in task.model.params.items():
        if value != 0:
            changed = f"{name}={sp.sstr(value * _LARGER)}"
            with contextlib.suppress(InputError):  # no such plant: nothing to hold
                others[name] = read_model(request, changed).system
    return others


def _exported(
    request: Request,
    made: Design,
    certificate: Certificate,
    parametric: Parametric | None,
    out: Path,
    clock: Clock,
) -> list[Path]:
    """Write the C controller and what was asked for around it."""
    from necc_casadi.export.c_project import export_c
    from necc_casadi.export.fmu import export_fmu
    from necc_casadi.export.matlab import export_mex

    common: dict[str, Any] = {
        "real": request.real,
        "sample_time": request.sample_time,
        "integrator": request.integrator,
        "prefix": request.prefix,
        "certificate": certificate,
        "parametric": parametric,
    }
    with clock.stage("export", "writing the C controller"):
        files = export_c(made, out / "c", **common)
        if request.fmu:
            files.append(export_fmu(made, out / f"{request.word}.fmu", **common))
        if request.mex:
            files.append(export_mex(made, out / "matlab", request.prefix))
    return files


def _sampled(request: Request, made: Design) -> SampledLoop | None:
    """The loop that the C code makes with the sample time asked for."""
    if request.sample_time is None:
        return None
    from necc_casadi.export.sampled_loop import analyse_sampling

    return analyse_sampling(made, request.sample_time, request.integrator)


def _swept(
    values: tuple[float, float, int], task: _Task, options: Options, clock: Clock
) -> tuple[SweepPoint, ...]:
    """Designs made like the one that is kept, whether a network can reach their a or not."""
    from necc_casadi.pipeline.sweep import sweep_a

    with clock.stage("sweep", "sweeping a"):
        return sweep_a(
            values,
            lambda a: _trained(task, replace(options, a=a, keep_a=True), clock.say),
            clock.say,
        )


def _drawn(request: Request, found: Findings, out: Path, clock: Clock) -> list[Path]:
    """Draw what there is to see, and write the page that shows it."""
    from necc_casadi.report.gallery import figures_of
    from necc_casadi.report.page import report
    from necc_casadi.report.style import picture

    figures, kind = {}, request.format
    drawn: list[Path] = []
    if request.plots:
        with clock.stage("figures", "drawing"):
            figures = figures_of(found)
            drawn = [
                write_text(out / "figures" / f"{name}.{kind}", picture(figure, kind))
                for name, figure in figures.items()
            ]
    with clock.stage("report", "writing the report"):
        page = report(found, figures, request.command)
        return [*drawn, write_text(out / REPORT, page)]
