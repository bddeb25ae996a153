"""What the sampled loop is asked to bear, on the command line: noise, errors of u, delay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from necc_casadi.errors import OptionError
from necc_casadi.model.measurement import Measurement
from necc_casadi.model.modulated import System
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.expressions import parse_number

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.disturbed import Disturbances
    from necc_casadi.pipeline.request import Request

__all__ = ["check_disturbances", "read_disturbances"]


def check_disturbances(request: Request, system: System) -> None:
    """Refuse what the sampled loop cannot be asked.

    Raises
    ------
    OptionError
        For a name that is not measured or applied, a size that is not positive, a shortest period
        beyond the longest, or any of these without a sample time.
    """
    given = {
        "--noise": request.noise is not None,
        "--input-error": request.input_error is not None,
        "--min-sample-time": request.min_sample_time is not None,
        "--delay": request.delay,
    }
    longest, shortest = request.sample_time, request.min_sample_time
    asked = next((name for name, said in given.items() if said), None)
    if longest is None and asked is not None:
        raise OptionError(
            "usage", f"{asked} is about the sampled loop", "Say how it is sampled: --sample-time."
        )
    if longest is not None and shortest is not None and shortest > longest:
        raise OptionError(
            "usage",
            f"--min-sample-time {shortest:g} is above --sample-time {longest:g}",
            "Give the shortest time between two calls.",
        )
    _noise(request, system)
    _input_error(request, system)


def read_disturbances(request: Request, system: System) -> Disturbances:
    """What is asked of the sampled loop beyond exact arithmetic, once it is checked."""
    from necc_casadi.certificate.claims.disturbed import Disturbances

    return Disturbances(
        precision=request.real,
        noise=_noise(request, system),
        input_error=_input_error(request, system),
        shortest=request.min_sample_time,
        delayed=request.delay,
    )


def _noise(request: Request, system: System) -> dict[str, float]:
    measured = Measurement(system).names if isinstance(system, Plant) else map(str, system.x)
    return _sizes("--noise", request.noise, list(measured))


def _input_error(request: Request, system: System) -> dict[str, float]:
    return _sizes("--input-error", request.input_error, system.input_names)


def _sizes(option: str, text: str | None, names: Sequence[str]) -> dict[str, float]:
    """``q=1e-3,p=0.01`` as sizes by name."""
    found: dict[str, float] = {}
    for part in [] if text is None else text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or name not in names or name in found:
            raise OptionError(
                "usage",
                f"{option} {part.strip()} is not NAME=SIZE of {', '.join(names)}",
                f"Write {option} {names[0]}=1e-3, the largest error, each once.",
            )
        size = float(parse_number(value, option, "usage", OptionError))
        if not 0 <= size < float("inf"):
            raise OptionError(
                "usage", f"{option} {part.strip()} is no size", "Give a number from 0 on."
            )
        found[name] = size
    return found
