"""One run of ``necc-design``, stage by stage: verdict, design, certificate, responses, files."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.artifact import Design, write_text
from necc_casadi.assignability import Verdict, judge
from necc_casadi.casimirs import Casimirs, find_casimirs
from necc_casadi.certificate import Certificate, certify
from necc_casadi.certificate.region import GridRegion
from necc_casadi.certificate.structure import quadratic_states
from necc_casadi.errors import OptionError, OutputError
from necc_casadi.figures import (
    SweepPoint,
    lyapunov_figure,
    region_boundary,
    region_figure,
    responses_figure,
    sweep_figure,
    write_figure,
)
from necc_casadi.loop import interconnect
from necc_casadi.model_file import Model, damping_matrix, load_model
from necc_casadi.report import Findings, design_block
from necc_casadi.sampling import check_model_at
from necc_casadi.simulation import random_states, simulate, simulated_share
from necc_casadi.structures import suggest_controllers
from necc_casadi.synthesis import Options, check_options, design, paper_options
from necc_casadi.target import (
    free_coordinates,
    nearest_equilibrium,
    parse_target,
    target_from_model,
)

__all__ = ["Request", "run_design"]

_RESPONSES = 10
#: A design whose ε is above this gets a note with IPOPT's status and what to try.
_NOTED_LOSS = 1e-9
#: A proved region below this share of the domain gets a note on how it may grow.
_SMALL = 0.1

Say = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What one run is asked for, as the command line says it."""

    model: Path
    out: Path
    target: str | None = None
    param: Sequence[str] = ()  # NAME=VALUE
    check: bool = False
    paper: bool = False
    chosen: dict[str, Any] = field(default_factory=dict)  # fields of Options that were given
    damping: tuple[float, ...] | None = None
    controller_damping: tuple[float, ...] | None = None
    plots: bool = True
    sweep_a: tuple[float, float, int] | None = None
    structure: str | None = None  # name of a controller structure that the tool offers
    real: str = "double"
    sample_time: float | None = None
    integrator: str = "heun"
    fmu: bool = False
    mex: bool = False


def run_design(request: Request, say: Say) -> Findings:
    """Judge the target and, where it is assignable, design, certify, simulate and write.

    Raises
    ------
    InputError
        For a model, a target, an option or a folder that cannot be used; before any training.
    """
    began = time.perf_counter()
    say("reading the model")
    if not request.check:
        check_writable(request.out)
    model = load_model(request.model, _parameters(request.param))
    options = _options(request, model)
    x_star = _target(model, request.target)
    check_model_at(model.loop, x_star)
    if request.structure is not None:
        model = _with_structure(model, request.structure, x_star)
    say("finding Casimirs")
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    say("judging the target")
    verdict = judge(model.loop, casimirs, x_star)
    found = Findings(model.loop, x_star, casimirs, verdict, notes=_notes(model, casimirs))
    if verdict.reason == "not_an_equilibrium":
        found.notes += _nearest(model, x_star)
    if request.structure is None and not (verdict.assignable and verdict.stability == "asymptotic"):
        say("searching for a controller structure that helps")
        found.notes += _offers(model, x_star)
    found.timings["symbolic"] = time.perf_counter() - began
    learning = options.learn_casimir and verdict.assignable is not False
    if (verdict.assignable or learning) and not request.check:
        _Making(request, model, casimirs, verdict, options, found, say).everything()
    return found


@dataclass(frozen=True, eq=False)
class _Making:
    """The stages after a favourable verdict; each adds to `found` and writes its files."""

    request: Request
    model: Model
    casimirs: Casimirs
    verdict: Verdict
    options: Options
    found: Findings
    say: Say

    def everything(self) -> None:
        """All stages, in order."""
        made = self.design()
        certificate = self.certify(made)
        self.simulate(made)
        self.export(made, certificate)
        if self.request.sweep_a is not None:
            self.sweep(self.request.sweep_a)
        if self.request.plots:
            self.draw(made)

    @contextlib.contextmanager
    def stage(self, name: str, text: str) -> Iterator[None]:
        """Name a stage in the progress display and time it."""
        self.say(text)
        began = time.perf_counter()
        yield
        self.found.timings[name] = time.perf_counter() - began

    def train(self, options: Options) -> Design:
        """One design at the target with these options."""
        count = 0

        def report(start: Any) -> None:
            nonlocal count
            count += 1
            self.say(f"training: start {count} of {options.starts}, loss {start.loss:.1e}")

        return design(
            self.model.loop, self.casimirs, self.verdict, self.found.x_star, options, report
        )

    def design(self) -> Design:
        """Train and damp."""
        found = self.found
        with self.stage("design", "training"):
            made = found.design = self.train(self.options)
        found.timings["solve"] = sum(s.seconds for s in made.starts)
        if made.a < made.a_requested:
            found.notes.append(
                f"a = {made.a_requested:.4g} was asked for, but no network can exceed "
                f"a_max = {self.verdict.a_max:.4g}: a = {made.a:.4g} is used"
            )
        best = min(made.starts, key=lambda s: s.loss)
        if best.loss > _NOTED_LOSS:
            found.notes.append(f"IPOPT: {best.explained.meaning}. {best.explained.remedy}")
        if self.options.shape != "none" and best.mode != "shaped":
            found.notes.append(
                f"--shape {self.options.shape} was not reached: V meets the conditions at z* only. "
                "Try another --seed, more --starts or wider networks"
            )
        return made

    def certify(self, made: Design) -> Certificate:
        """Prove what can be proved; write design and certificate."""
        with self.stage("certify", "proving"):
            certificate = certify(made, report=lambda stage, _: self.say(f"proving: {stage}"))
        self.found.certificate = certificate
        self.found.notes += self.advice(certificate)
        out = self.request.out
        self.wrote(made.save(out / "design.json"))
        self.wrote(write_text(out / "certificate.json", certificate.to_json()))
        return certificate

    def advice(self, certificate: Certificate) -> list[str]:
        """How a small region on a grid may grow: V can be shaped for it."""
        options, share = self.options, certificate.domain_share
        plain = options.shape == "none" and not (options.convex or options.learn_casimir)
        small = share is not None and share < _SMALL and isinstance(certificate.region, GridRegion)
        if plain and small and options.phi == "sum":
            return ["the proved region is small: --shape level shapes V for a larger one"]
        return []

    def simulate(self, made: Design) -> None:
        """Responses from random states of the domain, and the share from which it converges."""
        with self.stage("simulate", "simulating"):
            states = random_states(made, _RESPONSES, made.seed)
            self.found.responses = [simulate(made, x0) for x0 in states]
            self.found.simulated_share = simulated_share(made, quadratic_states(made), made.seed)

    def export(self, made: Design, certificate: Certificate) -> None:
        """The C controller, and what was asked for around it."""
        from necc_casadi.export import export_c, export_fmu, export_mex

        request, out = self.request, self.request.out
        common: dict[str, Any] = {
            "real": request.real,
            "sample_time": request.sample_time,
            "integrator": request.integrator,
            "certificate_hash": hashlib.sha256(certificate.to_json().encode()).hexdigest(),
            "claims": [claim.statement for claim in certificate.claims if claim.holds],
        }
        with self.stage("export", "writing the C controller"):
            paths = export_c(made, out / "c", **common)
            if request.fmu:
                name = re.sub(r"\W", "_", request.model.stem)
                paths.append(export_fmu(made, out / f"{name}.fmu", **common))
            if request.mex:
                paths.append(export_mex(made, out / "matlab" / "necc_control.c"))
        for path in paths:
            self.wrote(path)
        if request.sample_time is not None:
            self.sample(made, request.sample_time)

    def sample(self, made: Design, sample_time: float) -> None:
        """The sampled loop at the sample time that was asked for."""
        from necc_casadi.export import analyse_sampling

        sampling = analyse_sampling(made, sample_time, self.request.integrator)
        self.found.sampling = sampling
        if sampling.warning is not None:
            self.found.notes.append(sampling.warning)

    def sweep(self, values: tuple[float, float, int]) -> None:
        """One design for each value of a, in the same form, with what is proved about it."""
        with self.stage("sweep", "sweeping a"):
            self.found.sweep = [
                self.swept(float(a), f"sweeping a: {index + 1} of {values[2]}")
                for index, a in enumerate(np.linspace(*values))
            ]

    def swept(self, a: float, progress: str) -> SweepPoint:
        """The design for one value of a, its certificate and its simulated share."""
        self.say(progress)
        made = self.train(replace(self.options, a=a, keep_a=True))
        certificate = certify(made, report=lambda stage, _: self.say(f"{progress}, {stage}"))
        block = design_block(made, certificate)
        return SweepPoint(
            a=a,
            loss=block["loss"],
            distance=block["distance"],
            bound_paper=block["bound_paper"],
            bound_rigorous=block["bound_rigorous"],
            domain_share=certificate.domain_share,
            simulated_share=simulated_share(made, quadratic_states(made), made.seed),
            limited_by=certificate.limited_by,
        )

    def draw(self, made: Design) -> None:
        """The figures."""
        found = self.found
        with self.stage("figures", "drawing"):
            figures = {
                "lyapunov": lyapunov_figure(made),
                "responses": responses_figure(made, found.responses),
            }
            level = found.certificate.level if found.certificate else None
            if level is not None:
                starts = region_boundary(made, level)
                figures["region"] = region_figure(made, level, [simulate(made, s) for s in starts])
            if found.sweep:
                figures["sweep"] = sweep_figure(made, found.sweep)
            for name, figure in figures.items():
                self.wrote(write_figure(figure, self.request.out / "figures" / f"{name}.png"))

    def wrote(self, path: Path) -> None:
        """Remember a file, relative to OUT."""
        self.found.files.append(path.relative_to(self.request.out).as_posix())


def _with_structure(model: Model, name: str, x_star: Mapping[sp.Symbol, sp.Expr]) -> Model:
    """The model with one of the offered controller structures in place of its own.

    Raises
    ------
    OptionError
        Where no structure of that name helps at this target; the offered ones are listed.
    """
    offers = suggest_controllers(model.loop.plant, x_star)
    for label, controller, _ in offers:
        if _word(label) == name:
            return replace(model, loop=interconnect(model.loop.plant, controller), casimirs=())
    raise OptionError(
        "usage",
        f"--structure {name}: no such structure helps at this target",
        f"Offered here: {', '.join(_word(label) for label, _, _ in offers) or 'none'}.",
    )


def _offers(model: Model, x_star: Mapping[sp.Symbol, sp.Expr]) -> list[str]:
    """What `--structure` would change, one note per structure."""
    notes = []
    for label, _, verdict in suggest_controllers(model.loop.plant, x_star):
        reach = "assignable" if verdict.assignable else "undecided"
        stability = f", {verdict.stability}" if verdict.stability else ""
        notes.append(
            f"with a {label} the target is {reach}{stability}: add --structure {_word(label)}"
        )
    return notes


def _word(label: str) -> str:
    """The option value for a structure: ``copy of the kinematics …`` -> ``copy``."""
    return label.split()[0]


def _parameters(texts: Sequence[str]) -> dict[str, str]:
    result = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name.strip() or not value.strip():
            raise OptionError("param", f"--param {text} is not NAME=VALUE", "Write --param k=4.")
        result[name.strip()] = value
    return result


def _nearest(model: Model, x_star: dict[sp.Symbol, sp.Expr]) -> list[str]:
    """An equilibrium near a target that is none."""
    plant = model.loop.plant
    nearest = nearest_equilibrium(plant, x_star)
    if nearest is None:
        return []
    values = ",".join(f"{s}={v:.6g}" for s, v in zip(plant.states, nearest, strict=True))
    return [f"the nearest equilibrium that was found: {values}"]


def _target(model: Model, text: str | None) -> dict[sp.Symbol, sp.Expr]:
    if text is not None:
        return parse_target(model.loop.plant, text)
    if model.target is not None:
        return target_from_model(model.loop.plant, model.target)
    free, dimension = free_coordinates(model.loop.plant)
    names = ", ".join(map(str, free[:dimension])) or "none"
    raise OptionError(
        "usage",
        "no target: neither --target nor `target` in the model file",
        f"Say where to hold the plant with --target; free on the equilibrium set: {names}.",
    )


def _options(request: Request, model: Model) -> Options:
    m = model.loop.plant.m
    options = paper_options(m) if request.paper else Options(D=model.D, Dc=model.Dc)
    dampings: dict[str, Any] = {}
    if request.damping is not None:
        dampings["D"] = damping_matrix(np.array(request.damping), m, "--damping")
    if request.controller_damping is not None:
        dampings["Dc"] = damping_matrix(
            np.array(request.controller_damping), m, "--controller-damping"
        )
    options = replace(options, **request.chosen, **dampings)
    check_options(options)
    return options


def _notes(model: Model, casimirs: Casimirs) -> list[str]:
    notes = [
        f"{p.name} held at sampled points only: what rests on it is not proved"
        for p in model.loop.properties
        if not p.proved
    ]
    return [*model.notes, *notes, *([casimirs.note] if casimirs.note else [])]


def check_writable(folder: Path) -> None:
    """Refuse early, before any work, where `folder` cannot be made or written.

    Raises
    ------
    OutputError
        Naming the folder.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(
            "output",
            f"{folder} cannot be written: {existing} is "
            + ("read-only" if existing.is_dir() else "not a folder"),
            "Choose a folder that can be written with --out.",
        )
