"""necc-simulate: one response of a saved design."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from necc_casadi.cli.console import echo, echo_json, fitting
from necc_casadi.cli.options import (
    Positive,
    json_option,
    last_options,
    numbers,
    output_option,
    task_option,
)
from necc_casadi.cli.terminal import GroupedCommand, NamedPath, run
from necc_casadi.errors import OptionError

if TYPE_CHECKING:
    from necc_casadi.designs.design import Design
    from necc_casadi.simulation.responses import Trajectory

__all__ = ["simulate_command"]


@click.command("necc-simulate", cls=GroupedCommand)
@click.argument("out", type=NamedPath())
@numbers(
    task_option,
    "--x0",
    "State to start from as it is measured, all in order.  [default: "
    "the middle between target and domain edge]",
)
@numbers(
    task_option, "--xi0", "Controller state to start from.  [default: as the design starts it]"
)
@task_option("--time", "horizon", type=Positive(), help="Horizon, s.")
@output_option(
    "--points",
    type=click.IntRange(2, 1_000_000),
    default=501,
    show_default=True,
    help="Number of output times.",
)
@output_option(
    "--csv",
    type=NamedPath(dir_okay=False),
    help="Write the response to a CSV file (- for stdout).",
)
@output_option(
    "--plot",
    type=NamedPath(dir_okay=False),
    help="Draw it to a file: PNG, or PDF or SVG by its name.",
)
@json_option()
@last_options("necc-simulate")
def _simulate(out: Path, **options: Any) -> int:
    """Simulate the design in the folder OUT that necc-design wrote.

    \b
    Examples:
      necc-simulate pendulum-design --x0 0,0
      necc-simulate pendulum-design --x0 -1,0.5 --time 20 --csv response.csv
    """
    if options["as_json"] and str(options["csv"]) == "-":
        raise OptionError(
            "usage", "--csv - and --json both want stdout", "Name a file: --csv response.csv."
        )
    from necc_casadi.designs.design import Design
    from necc_casadi.files import write_text
    from necc_casadi.simulation.responses import simulate

    made = Design.load(out)
    names = {"x0": made.measurement.names, "xi0": made.loop.controller.states}
    for key, states in names.items():
        if options[key] is not None and len(options[key]) != len(states):
            raise OptionError(
                "usage",
                f"--{key}: {len(states)} number(s) are needed, not {len(options[key])}",
                f"Give one for each of {', '.join(states)}.",
            )
    middle = (made.z_star + made.domain.hi)[: made.loop.plant.n] / 2
    x0 = options["x0"] or tuple(made.lyapunov.measured(middle))
    xi0 = options["xi0"] or None
    response = simulate(made, x0, xi0, time=options["horizon"], points=options["points"])
    shown = (*made.measurement.names, *made.loop.controller.states)
    text = response.csv(shown, made.loop.plant.inputs)
    if options["csv"] is not None and str(options["csv"]) != "-":
        write_text(options["csv"], text)
    if options["plot"] is not None:
        from necc_casadi.report.responses_figure import responses_figure
        from necc_casadi.report.style import styled, write_figure

        with styled():
            write_figure(responses_figure(made, [response]), options["plot"])
    if str(options["csv"]) == "-":
        click.echo(fitting(text, sys.stdout), nl=False)
    elif options["as_json"]:
        echo_json(_response_json(made, response))
    else:
        echo(_response_text(made, response))
    return 0 if response.complete else 4


def _response_json(made: Design, response: Trajectory) -> dict[str, Any]:
    return {
        "states": [*made.measurement.names, *made.loop.controller.states],
        "t_end": float(response.t[-1]),
        "z_end": response.shown[-1].tolist(),
        "settling_time": response.settling_time,
        "peak_input": response.peak_input,
        "complete": response.complete,
    }


def _response_text(made: Design, response: Trajectory) -> str:
    names = (*made.measurement.names, *made.loop.controller.states)
    end = ", ".join(f"{s} = {v:.6g}" for s, v in zip(names, response.shown[-1], strict=True))
    settled = (
        f"settles within 2 % in {response.settling_time:.4g} s"
        if response.converged
        else "has not settled"
    )
    stopped = "" if response.complete else "\nThe integrator gave up: the response may diverge."
    return (
        f"{made.loop.plant.name}: {settled}; peak |u| {response.peak_input:.4g}\n"
        f"at t = {response.t[-1]:.4g} s: {end}{stopped}"
    )


def simulate_command() -> None:
    """Entry point of ``necc-simulate``."""
    sys.exit(run(_simulate))
