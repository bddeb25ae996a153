"""``necc-certify OUT``: the independent checker on the command line."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import click

from necc_casadi.errors import InputError

__all__ = ["certify_command"]


@click.command("necc-certify")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def certify_command(out: Path, as_json: bool) -> None:
    r"""Prove again, with other arithmetic, what OUT/certificate.json claims about OUT/design.json.

    \b
    Exit codes:
      0  every claim holds
      2  OUT cannot be read
      4  a claim does not hold
    """
    from necc_casadi.certificate.checker import check

    began = time.perf_counter()
    try:
        results = check(out)
    except InputError as problem:
        _refuse(problem, as_json)
        sys.exit(2)
    holds = all(result.holds for result in results)
    if as_json:
        claims = [vars(result) for result in results]
        seconds = time.perf_counter() - began
        status = "certified" if holds else "fell_short"
        click.echo(json.dumps({"status": status, "claims": claims, "seconds": seconds}))
    else:
        for result in results:
            verdict = "holds" if result.holds else "DOES NOT HOLD"
            click.echo(f"{result.name:12} {verdict:14} {result.statement}")
    sys.exit(0 if holds else 4)


def _refuse(problem: InputError, as_json: bool) -> None:
    if as_json:
        error = {"code": problem.code, "message": problem.fault}
        click.echo(json.dumps({"status": "error", "error": error}))
    else:
        click.echo(f"{problem.fault}\n{problem.remedy}", err=True)
