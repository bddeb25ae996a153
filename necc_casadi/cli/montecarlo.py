"""necc-montecarlo: one saved design on many plants."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from necc_casadi.cli.console import Progress
from necc_casadi.cli.options import task_option
from necc_casadi.cli.studying import answer, filled, study_options
from necc_casadi.cli.terminal import GroupedCommand, NamedPath, run

if TYPE_CHECKING:
    from necc_casadi.designs.design import Design
    from necc_casadi.study.tables import Table

__all__ = ["montecarlo_command"]


@click.command("necc-montecarlo", cls=GroupedCommand)
@click.argument("out", type=NamedPath())
@task_option(
    "--vary",
    metavar="NAME=BAND,…",
    help="Parameters of the model, or disturbances of inputs, and their bands: m=10%,g=9.7:9.9, "
    "d_u=-0.1:0.1. Drawn uniformly.  [default: the ranges that are proved]",
)
@task_option(
    "-n",
    "--plants",
    type=click.IntRange(1, 10_000_000),
    default=200,
    show_default=True,
    help="Number of plants.",
)
@task_option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=10,
    show_default=True,
    help="Random states that each plant starts from, the same for all of them.",
)
@task_option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of all draws."
)
@study_options("necc-montecarlo", "OUT itself")
def _montecarlo(out: Path, **options: Any) -> int:
    """Simulate the design in the folder OUT, as exported, on plants with other parameters.

    A row per plant: whether it settles from every start, where it comes to rest, how fast, and the
    largest inputs. Each finished row is kept at once in rows.csv; run again, the command goes on
    with the rows that are missing. Where something is proved of all these plants, it stands beside
    what is sampled, in the table of the answer and in a figure.

    \b
    Examples:
      necc-montecarlo pendulum-design --vary m=10%,g=5% -n 200
      necc-montecarlo pendulum-design --vary m=0.9:1.2 -n 1000 --out study
      necc-montecarlo family-design

    \b
    Exit codes:
      0  every row is there, whatever the plants did
      2  bad usage, OUT cannot be used, or Dask is missing
      130  interrupted; run again to go on
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.study.montecarlo import MonteCarlo
        from necc_casadi.study.proof import subject

        home = out if out.is_dir() else out.parent
        about = subject(home, options["vary"])
        made, bands = about.design, about.bands
        study = MonteCarlo(made.text, about.plant, bands, options["starts"], options["seed"])
        folder = options["folder"] or home
        table = filled(study, options["plants"], folder, options, progress)
    beside = about.beside(table, options["seed"])
    found = {**_found(table, made), "proved": about.in_json(beside)}

    def figures() -> dict[str, Any]:
        from necc_casadi.report.proof_figure import proof_figure
        from necc_casadi.study.study_figures import histograms

        plant = made.loop.plant
        drawn: dict[str, Any] = {"study": histograms(table, plant.name, plant.units)}
        if beside is not None:
            drawn["proof"] = proof_figure(beside, plant.name, plant.states, plant.units)
        return drawn

    text = "\n".join([_text(found, made), *about.rows(beside)])
    return answer(table, folder, options, figures, found, text)


def _found(table: Table, made: Design) -> dict[str, Any]:
    """What all plants have in common."""
    import numpy as np

    def largest(name: str) -> float | None:
        values = np.abs(table.numbers(name))
        return float(np.nanmax(values)) if np.isfinite(values).any() else None

    times = table.numbers("settling_time")
    known = times[np.isfinite(times)]
    return {
        "settled": int(table.numbers("settled").sum()),
        "converging_share": float(table.numbers("converging_share").mean()),
        "settling_time": None
        if not known.size
        else {"median": float(np.median(known)), "largest": float(known.max())},
        "largest_offset": {name: largest(f"offset_{name}") for name in made.loop.plant.states},
        "peak": {
            name.removeprefix("peak_"): largest(name)
            for name in table.columns
            if name.startswith("peak_")
        },
    }


def _text(found: dict[str, Any], made: Design) -> str:
    plant = made.loop.plant
    times = found["settling_time"]
    offsets = ", ".join(
        f"{name} {value:.3g} {plant.units.get(name, '')}".rstrip()
        for name, value in found["largest_offset"].items()
        if value is not None
    )
    peaks = ", ".join(f"|{name}| {value:.3g}" for name, value in found["peak"].items())
    settled = (
        "–"
        if times is None
        else f"median {times['median']:.3g} s, largest " + (f"{times['largest']:.3g} s")
    )
    return "\n".join(
        [
            f"{plant.name}: {found['settled']} plants settle from every start; of all starts "
            f"{100 * found['converging_share']:.3g} % settle",
            "",
            f"  settling    {settled}",
            f"  at rest     off by at most {offsets or '–: none comes to rest nearby'}",
            f"  inputs      at most {peaks}",
        ]
    )


def montecarlo_command() -> None:
    """Entry point of ``necc-montecarlo``."""
    sys.exit(run(_montecarlo))
