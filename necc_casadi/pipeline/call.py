"""The whole tool in one call."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Unpack

from necc_casadi.model.model_file import Model
from necc_casadi.model.plant import Plant
from necc_casadi.pipeline.clock import Say
from necc_casadi.pipeline.given import RunOptions, Target, request_of
from necc_casadi.pipeline.result import Result
from necc_casadi.pipeline.run import run_design

__all__ = ["run"]


_LOG = logging.getLogger("necc_casadi")


def run(
    model: str | Path | Plant | Model,
    target: Target | None = None,
    *,
    out: str | Path | None = None,
    say: Say | None = None,
    **options: Unpack[RunOptions],
) -> Result:
    """Do what ``necc-design`` does: verdict, design, certificate, responses.

    Parameters
    ----------
    model
        Path of a model file, a model of :func:`make_model`, or a plant of :func:`make_plant`.
    target
        ``"pi/4"``, ``{"q": 0.8}``, or all states in order; by default the model file's.
    out
        Folder to write, with C code, figures and a report; by default none is.
    say
        Called with what is being done; by default the logger ``necc_casadi`` is told, at INFO.
    options
        As those of the command: ``check=True, settle=3, compare=True``; all of them:
        ``help(necc_casadi.RunOptions)``.

    Returns
    -------
    Result
        ``status``, ``design``, ``certificate``, ``summary()``, ``plot_responses()``, ``save()``.

    Raises
    ------
    InputError
        For a model, a target or an option that cannot be used; outcomes are values.

    Examples
    --------
    >>> from necc_casadi import run
    >>> result = run("pendulum.py", target="pi/4")
    >>> result.status, result.certificate.is_global
    ('certified', True)
    """
    request = request_of(model, target, out, options)
    return Result(run_design(request, say or _LOG.info), request)
