"""necc-certify: the independent checker."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import click

from necc_casadi.cli.console import Progress, echo, echo_json
from necc_casadi.cli.options import json_option, last_options
from necc_casadi.cli.terminal import GroupedCommand, NamedPath, run

__all__ = ["certify_command"]


@click.command("necc-certify", cls=GroupedCommand)
@click.argument("out", type=NamedPath())
@json_option()
@last_options("necc-certify")
def _certify(out: Path, **options: Any) -> int:
    """Prove again, with other arithmetic, what OUT/certificate.json claims about OUT/design.json.

    \b
    Exit codes:
      0  every claim holds
      2  OUT cannot be read
      4  a claim does not hold
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.certificate.checker.check import check

        progress.say("checking the certificate")
        began = time.perf_counter()
        results = check(out)
        seconds = time.perf_counter() - began
    holds = all(result.holds for result in results)
    if options["as_json"]:
        status = "certified" if holds else "fell_short"
        claims = [vars(result) for result in results]
        echo_json({"status": status, "claims": claims, "seconds": seconds})
    else:
        for result in results:
            mark = "holds" if result.holds else "DOES NOT HOLD"
            echo(f"{result.name:12} {mark:14} {result.statement}")
    return 0 if holds else 4


def certify_command() -> None:
    """Entry point of ``necc-certify``."""
    sys.exit(run(_certify))
