"""One run of ``necc-design``, stage by stage: verdict, design, certificate, responses, files."""

from __future__ import annotations

import contextlib
import hashlib
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import GridRegion
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.design import Design
from necc_casadi.files import check_writable, write_text
from necc_casadi.model.model_file import Model, load_model
from necc_casadi.model.spot_checks import check_model_at
from necc_casadi.pipeline.advice import (
    NOTED_LOSS,
    SMALL_SHARE,
    model_notes,
    nearest_note,
    size_notes,
    structure_offers,
)
from necc_casadi.pipeline.request import (
    Request,
    read_options,
    read_parameters,
    read_target,
    with_structure,
)
from necc_casadi.report.figures import (
    lyapunov_figure,
    region_boundary,
    region_figure,
    responses_figure,
    sweep_figure,
    write_figure,
)
from necc_casadi.report.findings import Findings, SweepPoint
from necc_casadi.report.to_json import design_block
from necc_casadi.simulation.convergence import simulated_share
from necc_casadi.simulation.responses import random_states, simulate
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.synthesis import design
from necc_casadi.verdict.judge import judge
from necc_casadi.verdict.verdict import Verdict

__all__ = ["run_design"]


_RESPONSES = 10


#: Seconds of computing that all responses together may take.
_PATIENCE = 10.0


Say = Callable[[str], None]


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
    model = load_model(request.model, read_parameters(request.param))
    options = read_options(request, model)
    x_star = read_target(model, request.target)
    sampled = check_model_at(model.loop, x_star)
    if request.structure is not None:
        model = with_structure(model, request.structure, x_star)
    say("finding Casimirs")
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    say("judging the target")
    verdict = judge(model.loop, casimirs, x_star)
    found = Findings(
        model.loop,
        x_star,
        casimirs,
        verdict,
        notes=[*sampled, *model_notes(model, casimirs, x_star)],
    )
    if verdict.reason == "not_an_equilibrium":
        found.notes += nearest_note(model, x_star)
    if request.structure is None and not (verdict.assignable and verdict.stability == "asymptotic"):
        say("searching for a controller structure that helps")
        found.notes += structure_offers(model, x_star)
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
        found.notes += size_notes(made.sizes)
        if made.a < made.a_requested:
            found.notes.append(
                f"a = {made.a_requested:.4g} was asked for, but no network can exceed "
                f"a_max = {self.verdict.a_max:.4g}: a = {made.a:.4g} is used"
            )
        best = min(made.starts, key=lambda s: s.loss)
        if best.loss > NOTED_LOSS:
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
        small = (
            share is not None and share < SMALL_SHARE and isinstance(certificate.region, GridRegion)
        )
        if plain and small and options.phi == "sum":
            return ["the proved region is small: --shape level shapes V for a larger one"]
        return []

    def simulate(self, made: Design) -> None:
        """Responses from random states of the domain, and the share from which it converges."""
        with self.stage("simulate", "simulating"):
            states = random_states(made, _RESPONSES, made.seed)
            ends = time.perf_counter() + _PATIENCE
            self.found.responses = [
                simulate(made, x0, patience=max(0.0, ends - time.perf_counter())) for x0 in states
            ]
            cut = sum(response.cut for response in self.found.responses)
            if cut:
                self.found.notes.append(
                    f"{cut} of {_RESPONSES} responses were cut after {_PATIENCE:g} s of computing: "
                    "the loop is stiff or very slow"
                )
            self.found.simulated_share = simulated_share(made, made.momenta, made.seed)

    def export(self, made: Design, certificate: Certificate) -> None:
        """The C controller, and what was asked for around it."""
        from necc_casadi.export.c_project import export_c
        from necc_casadi.export.fmu import export_fmu
        from necc_casadi.export.matlab import export_mex

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
        from necc_casadi.export.sampled_loop import analyse_sampling

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
            simulated_share=simulated_share(made, made.momenta, made.seed),
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
