"""What the commands that fill a table share: their options, their progress, their answer."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from necc_casadi.cases import Format
from necc_casadi.cli.console import Progress, echo, echo_json
from necc_casadi.cli.options import choice, json_option, last_options, output_option
from necc_casadi.cli.terminal import NamedPath, grouped

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from necc_casadi.study.fill import Study
    from necc_casadi.study.tables import Table

__all__ = ["answer", "filled", "study_options"]


_dask_option = grouped("Dask")


def study_options(name: str, out: str) -> Callable[[Any], Any]:
    """Where rows are computed and kept."""

    def options(command: Any) -> Any:
        for decorator in reversed(
            (
                _dask_option(
                    "--scheduler",
                    metavar="ADDRESS",
                    help="A Dask scheduler, tcp://HOST:PORT.  [default: processes of this machine]",
                ),
                _dask_option(
                    "--workers",
                    type=click.IntRange(1, 1024),
                    help="Processes on this machine.  [default: one per core]",
                ),
                output_option(
                    "--out",
                    "folder",
                    type=NamedPath(),
                    help=f"Folder of the table.  [default: {out}]",
                ),
                json_option(),
                output_option("--no-plots", is_flag=True, help="Draw no figure."),
                output_option(
                    "--format",
                    type=choice(Format),
                    default="png",
                    show_default=True,
                    help="Of the figure.",
                ),
                last_options(name),
            )
        ):
            command = decorator(command)
        return command

    return options


def filled(
    study: Study, count: int, out: Path, options: Mapping[str, Any], progress: Progress
) -> Table:
    """The whole table; on a terminal, the share that is done."""
    from necc_casadi.study.fill import fill

    def told(done: int) -> None:
        if sys.stderr.isatty():
            progress.say(f"{done} of {count} rows ({100 * done / count:.0f} %)")

    where = {"scheduler": options["scheduler"], "workers": options["workers"]}
    try:
        return fill(study, count, out, told, **where)
    except KeyboardInterrupt:
        echo("finished rows are kept: run the command again to go on", err=True)
        raise


def answer(
    table: Table,
    out: Path,
    options: Mapping[str, Any],
    figures: Callable[[], Mapping[str, Figure | None]],
    found: Mapping[str, Any],
    text: str,
) -> int:
    """Write tables and figures, by name, say what was found; the exit code."""
    from necc_casadi.report.style import write_figure
    from necc_casadi.study.rows import ROWS, STUDY
    from necc_casadi.study.tables import write_tables

    files = write_tables(table, out)
    for name, drawn in ({} if options["no_plots"] else figures()).items():
        if drawn is not None:
            files.append(write_figure(drawn, out / f"{name}.{options['format']}"))
    names = [STUDY, ROWS, *(path.name for path in files)]
    if options["as_json"]:
        echo_json({"status": "finished", "rows": len(table), **found, "files": names})
    else:
        echo(f"{text}\n\n  written     {out}: {', '.join(names)}")
    return 0
