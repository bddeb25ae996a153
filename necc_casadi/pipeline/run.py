"""One run of ``necc-design``, stage by stage: verdict, design, certificate, responses, files.

Each stage takes what it needs and returns what it found; :func:`run_design` alone puts that
together.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from necc_casadi.files import LISTING, write_text
from necc_casadi.folders import whole_folder
from necc_casadi.interrupts import uninterrupted
from necc_casadi.model.parametric import Parametric
from necc_casadi.pipeline.clock import Clock, Say
from necc_casadi.pipeline.judge import judge
from necc_casadi.pipeline.keep import keep, no_family
from necc_casadi.pipeline.request import Request
from necc_casadi.pipeline.study import study
from necc_casadi.report.findings import Findings

if TYPE_CHECKING:  # what --check does not need is loaded when it is reached
    from matplotlib.figure import Figure

    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.designs.design import Design

__all__ = ["REPORT", "run_design", "write_run"]


#: The page that shows a run.
REPORT = "report.html"


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
        task = judge(request, say)
    found = Findings(
        task.model.system,
        task.x_star,
        task.found,
        parametric=task.model.parametric,
        notes=task.notes,
        timings=dict(clock.timings),
    )
    none = no_family(request, task)
    if none is not None:
        notes = (*task.notes, f"no family: {none.sentence}")
        return replace(found, no_family=none, notes=notes)
    if task.found.chosen is None or request.check:
        return found
    _load_designs()
    if request.out is None:
        kept, task = keep(request, task, clock)
        return study(request, task, found, kept, clock)
    with whole_folder(request.out, _expected(request)) as folder:
        kept, task = keep(request, task, clock)
        with ThreadPoolExecutor(1) as pool:  # compilers run while the loop is simulated and drawn
            parametric = task.model.parametric
            exported = pool.submit(
                _exported, request, kept.design, kept.certificate, parametric, folder, clock
            )
            found = study(request, task, found, kept, clock)
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


def _drawn(request: Request, found: Findings, out: Path, clock: Clock) -> list[Path]:
    """Draw what there is to see, and write the page that shows it."""
    from necc_casadi.report.page import report

    figures: dict[str, Figure] = {}
    drawn: list[Path] = []
    if request.plots:  # what draws is slow to import
        from necc_casadi.report.gallery import figures_of
        from necc_casadi.report.style import picture

        kind = request.format
        with clock.stage("figures", "drawing"):
            figures = figures_of(found)
            drawn = [
                write_text(out / "figures" / f"{name}.{kind}", picture(figure, kind))
                for name, figure in figures.items()
            ]
    with clock.stage("report", "writing the report"):
        page = report(found, figures, request.command)
        return [*drawn, write_text(out / REPORT, page)]
