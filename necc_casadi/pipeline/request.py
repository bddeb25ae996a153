"""What one run is asked for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.cases import (
    Activation,
    CasimirForm,
    Format,
    Integrator,
    MethodWord,
    PhiForm,
    Precision,
    Shape,
)
from necc_casadi.casimirs.outputs import refuse_kept, refuse_without_time
from necc_casadi.errors import ModelError, OptionError
from necc_casadi.model.file_entries import damping_matrix
from necc_casadi.model.model_file import Model, load_model
from necc_casadi.model.plant import Plant
from necc_casadi.model.target import free_coordinates, parse_target, target_from_model
from necc_casadi.pipeline.disturbances import check_disturbances
from necc_casadi.pipeline.ranges import middle_of_target
from necc_casadi.synthesis.options import Options, check_options, paper_options
from necc_casadi.verdict.controller_structures import suggest_controllers

__all__ = [
    "Choices",
    "Request",
    "option_word",
    "read_model",
    "read_options",
    "read_parameters",
    "read_target",
    "with_structure",
]


@dataclass(frozen=True)
class Choices:
    """Fields of the synthesis' options, as far as they were given; None: not given."""

    hidden_k: tuple[int, ...] | None = None
    hidden_h: tuple[int, ...] | None = None
    activation: Activation | None = None
    casimir_form: CasimirForm | None = None
    phi: PhiForm | None = None
    a: float | None = None
    convex: bool | None = None
    learn_casimir: bool | None = None
    polish: bool | None = None
    shape: Shape | None = None
    gamma: float | None = None
    seed: int | None = None
    starts: int | None = None
    verbose: bool | None = None

    def over(self, options: Options) -> Options:
        """The options with what was given in place of theirs."""
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(options, **{name: v for name, v in given.items() if v is not None})


@dataclass(frozen=True)
class Request:
    """What one run is asked for, as the command line says it."""

    model: Path | Plant | Model
    out: Path | None = None  # None: nothing is written
    target: str | None = None
    param: Sequence[str] = ()  # NAME=VALUE
    check: bool = False
    paper: bool = False
    chosen: Choices = Choices()
    rate: float | None = None  # 1/s
    settle: float | None = None  # s, 2 %
    peak_u: tuple[float, ...] | None = None
    compare: bool = False
    uncertain: str | None = None  # NAME=SHARE% or NAME=LO:HI, with commas
    disturbance: str | None = None  # sizes, one or one per input
    integral: float | bool = False  # integral action; a number: its τ, s
    damping: tuple[float, ...] | None = None
    controller_damping: tuple[float, ...] | None = None
    plots: bool = True
    sweep_a: tuple[float, float, int] | None = None
    method: MethodWord = "auto"
    structure: str | None = None  # name of a controller structure that the tool offers
    real: Precision = "double"
    sample_time: float | None = None
    min_sample_time: float | None = None  # s
    noise: str | None = None  # NAME=SIZE,… of measured states
    input_error: str | None = None  # NAME=SIZE,… of inputs as they are applied
    delay: bool = False  # u is applied one sample late
    integrator: Integrator = "heun"
    prefix: str = "necc"
    fmu: bool = False
    mex: bool = False
    format: Format = "png"  # of the figures
    command: str = ""  # what a user says to get the same

    @property
    def word(self) -> str:
        """The model's name as a word, for files that are called after it."""
        model = self.model
        if isinstance(model, Path):
            return re.sub(r"\W", "_", model.stem)
        plant = model if isinstance(model, Plant) else model.loop.plant
        return re.sub(r"\W", "_", plant.name)


def read_model(request: Request, *changed: str) -> Model:
    """The model of a request; `changed` are parameters that differ, NAME=VALUE.

    Raises
    ------
    ModelError
        When the file cannot be used, or a model that is no file is to have other parameters.
    """
    values = read_parameters([*request.param, *changed])
    if isinstance(request.model, Path):
        return load_model(request.model, values)
    if values:
        raise ModelError(
            "param",
            f"param: {', '.join(values)} cannot be set, the model is no file",
            "Put the values in when you make the plant, or give the path of a model file.",
        )
    if isinstance(request.model, Model):
        return request.model
    return Model(request.model)


def with_structure(model: Model, name: str, x_star: Mapping[sp.Symbol, sp.Expr]) -> Model:
    """The model with one of the offered controller structures in place of its own.

    Raises
    ------
    OptionError
        Where no structure of that name helps at this target; the offered ones are listed.
    """
    offers = suggest_controllers(model.loop.plant, x_star)
    for label, controller, _ in offers:
        if option_word(label) == name:
            return replace(model, controller=controller, casimirs=())
    raise OptionError(
        "usage",
        f"--structure {name}: no such structure helps at this target",
        f"Offered here: {', '.join(option_word(label) for label, _, _ in offers) or 'none'}.",
    )


def option_word(label: str) -> str:
    """The option value for a structure: ``copy of the kinematics …`` -> ``copy``."""
    return label.split()[0]


def read_parameters(texts: Sequence[str]) -> dict[str, str]:
    """``k=4`` of each --param, by name."""
    result = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name.strip() or not value.strip():
            raise OptionError("param", f"--param {text} is not NAME=VALUE", "Write --param k=4.")
        result[name.strip()] = value
    return result


def read_target(model: Model, text: str | None) -> dict[sp.Symbol, sp.Expr]:
    """x* from --target, else from the model file."""
    text = middle_of_target(text)
    if text is not None:
        return parse_target(model.system, text, model.target)
    if model.target is not None:
        return target_from_model(model.system, model.target)
    free, dimension = free_coordinates(model.system)
    names = ", ".join(map(str, free[:dimension])) or "none"
    raise OptionError(
        "usage",
        "no target: neither --target nor `target` in the model file",
        f"Say where to hold the plant with --target; free on the equilibrium set: {names}.",
    )


#: A mode exp(−αt) has fallen to 2 % after this many time constants: exp(−4) is 1.8 %.
_SETTLED = 4.0


def _with_response(options: Options, request: Request, m: int) -> Options:
    """What is asked of the response; it takes the least-cost program."""
    if request.rate is not None and request.settle is not None:
        raise OptionError(
            "usage",
            f"--rate {request.rate:g} and --settle {request.settle:g} both ask for a speed",
            f"Give one: --settle T is --rate {_SETTLED:g}/T.",
        )
    rate = request.rate if request.settle is None else _SETTLED / request.settle
    peak = None if request.peak_u is None else _peak(request.peak_u, m)
    return replace(options, rate=rate, peak_u=peak)


def read_method(request: Request, options: Options) -> MethodWord:
    """The methods that are asked; a Casimir is learned for the published loop alone.

    Raises
    ------
    OptionError
        Another method is asked for beside --learn-casimir.
    """
    if not options.learn_casimir:
        return request.method
    if request.method not in ("auto", "interconnection"):
        raise OptionError(
            "usage",
            f"--learn-casimir is about the published loop, --method {request.method} is another",
            "Leave one of them out.",
        )
    return "interconnection"


def _peak(values: tuple[float, ...], m: int) -> Vector:
    if len(values) not in (1, m) or not all(0 < value < np.inf for value in values):
        shown = ",".join(f"{value:g}" for value in values)
        raise OptionError(
            "usage",
            f"--peak-u {shown} is not a positive number for each of {m} input(s)",
            "Give one for all of them, or one each: --peak-u 2 or --peak-u 2,5.",
        )
    return np.array(values * (m if len(values) == 1 else 1), float)


def _check_integral(request: Request, options: Options, model: Model) -> None:
    """Refuse what is asked of the loop without ζ, or of another V than integral action covers."""
    beside = {
        "--rate, --settle and --peak-u": options.rate is not None or options.peak_u is not None,
        "--compare": request.compare,
        "--sweep-a": request.sweep_a is not None,
        "--learn-casimir": options.learn_casimir,
        "--casimir-form sum": options.casimir_form == "sum",
        "setpoints, or a target that is a range": bool(model.ranges.setpoints),
        "runtime": bool(model.told),
    }
    for name, given in beside.items():
        if given:
            raise OptionError(
                "usage",
                f"--integral: {name} would be about the loop without integral action",
                "Drop one of them.",
            )


def _check_kept(request: Request, options: Options) -> None:
    """Refuse what Casimirs cannot be kept with, before any training."""
    if request.sample_time is None:
        refuse_without_time()
    neither = {
        "--phi neural": options.phi != "sum",
        "--casimir-form sum": options.casimir_form != "joint",
        "--learn-casimir": options.learn_casimir,
    }
    for name, given in neither.items():
        if given:
            refuse_kept(f"with {name} nothing bounds the curvature of V in ξ")


def read_options(request: Request, model: Model) -> Options:
    """The options of the synthesis, from the request and the model."""
    m = model.system.m
    options = Options(
        D=model.D, Dc=model.Dc, state_cost=model.state_cost, input_cost=model.input_cost
    )
    options = paper_options(m) if request.paper else options
    if request.damping is not None:
        D = damping_matrix(np.array(request.damping), m, "--damping")
        options = replace(options, D=D)
    if request.controller_damping is not None:
        Dc = damping_matrix(np.array(request.controller_damping), m, "--controller-damping")
        options = replace(options, Dc=Dc)
    options = _with_response(request.chosen.over(options), request, m)
    check_options(options)
    if request.integral is not False:
        _check_integral(request, options, model)
    if request.integrator == "casimir":
        _check_kept(request, options)
    check_disturbances(request, model.system)
    if model.told and model.parametric is None:
        raise OptionError(
            "param",
            f"runtime names {', '.join(model.told)}, but the plant is not one with J, R, G and H",
            "Write it by q, M, V and B, or leave runtime out.",
        )
    return options
