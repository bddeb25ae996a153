"""necc-sweep: many designs of one model."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from necc_casadi.cli.console import Progress
from necc_casadi.cli.design import _design, _request
from necc_casadi.cli.options import task_option
from necc_casadi.cli.studying import answer, filled, study_options
from necc_casadi.cli.terminal import GroupedCommand, NamedPath, run

__all__ = ["sweep_command"]


#: Headings of ``necc-design`` whose options say what a design is to be.
_OF_A_DESIGN = {
    "Task",
    "Response",
    "Form of the design",
    "Region of attraction",
    "Solver and damping",
}


@click.command("necc-sweep", cls=GroupedCommand)
@click.argument("model", type=NamedPath())
@task_option(
    "--vary",
    multiple=True,
    required=True,
    metavar="NAME=LO:HI:N",
    help="What takes N values from LO to HI, or those of a list, NAME=1,2,5: target, a state's "
    "set-point, or a parameter. Again for another axis of the grid.",
)
@task_option("--seeds", metavar="FROM:TO", help="Another axis: 0:5 for seeds 0, 1, 2, 3, 4.")
@study_options("necc-sweep", "<model>-sweep")
def _sweep(model: Path, vary: tuple[str, ...], seeds: str | None, **options: Any) -> int:
    """Design for every point of a grid, each as necc-design does, and keep a row for each.

    Nothing but the table is written. Each finished row is kept at once in rows.csv; run again, the
    command goes on with the rows that are missing.

    \b
    Examples:
      necc-sweep pendulum.py --vary target=0:3:13
      necc-sweep maglev.py --vary q=0.05:0.2:7 --vary m=0.09:0.11:3
      necc-sweep pendulum.py --vary target=pi/4,pi/2 --seeds 0:5 --paper

    \b
    Exit codes:
      0  every row is there, whatever became of the designs
      2  bad usage or model file, or Dask is missing
      130  interrupted; run again to go on
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.pipeline.request import read_model, read_options
        from necc_casadi.study.sweep import Sweep, what_varies
        from necc_casadi.study.vary import read_axes

        request = _request(model, {**options, "out": None, "debug": False})
        request = replace(request, out=None, plots=False, command="")
        known = read_model(request)
        read_options(request, known)  # what cannot be asked for is said at once
        axes = read_axes(vary, what_varies(known, request.target), seeds)
        source = model.read_text(encoding="utf-8")
        study = Sweep(request, source, known.loop.plant.states, axes)
        folder = options["folder"] or Path(f"{model.stem}-sweep")
        table = filled(study, study.count, folder, options, progress)
    found = {"outcomes": dict(Counter(word or "" for word in table.texts("status")))}

    def figure() -> Any:
        from necc_casadi.study.study_figures import maps

        plant = known.loop.plant
        return maps(table, [axis.name for axis in axes], plant.name, plant.units)

    outcomes = ", ".join(f"{count} {word}" for word, count in sorted(found["outcomes"].items()))
    text = f"{known.loop.plant.name}: {len(table)} designs: {outcomes}"
    return answer(table, folder, options, lambda: {"study": figure()}, found, text)


#: Everything that a design may be asked for may be asked of all of them.
_OWN = {"seed"}
_sweep.params[1:1] = [
    option
    for option in _design.params
    if getattr(option, "group", None) in _OF_A_DESIGN and option.name not in _OWN
]


def sweep_command() -> None:
    """Entry point of ``necc-sweep``."""
    sys.exit(run(_sweep))
