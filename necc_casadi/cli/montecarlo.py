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
    required=True,
    metavar="NAME=BAND,…",
    help="Parameters of the model and their bands: m=10%,g=9.7:9.9. Drawn uniformly.",
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
    with the rows that are missing.

    \b
    Examples:
      necc-montecarlo pendulum-design --vary m=10%,g=5% -n 200
      necc-montecarlo pendulum-design --vary m=0.9:1.2 -n 1000 --out study

    \b
    Exit codes:
      0  every row is there, whatever the plants did
      2  bad usage, OUT cannot be used, or Dask is missing
      130  interrupted; run again to go on
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.designs.design import Design
        from necc_casadi.designs.plant_file import read_plant
        from necc_casadi.study.montecarlo import MonteCarlo
        from necc_casadi.study.vary import read_bands

        made = Design.load(out)
        plant, text = read_plant(out if out.is_dir() else out.parent, made)
        bands = read_bands(options["vary"], plant.values)
        study = MonteCarlo(made.text, text, bands, options["starts"], options["seed"])
        folder = options["folder"] or (out if out.is_dir() else out.parent)
        table = filled(study, options["plants"], folder, options, progress)
    found = _found(table, made)

    def figure() -> Any:
        from necc_casadi.study.study_figures import histograms

        return histograms(table, made.loop.plant.name, made.loop.plant.units)

    return answer(table, folder, options, figure, found, _text(found, made))


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
