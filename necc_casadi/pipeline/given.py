"""What a call from Python gives, as the request that the command line would make of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypedDict, get_args, get_origin, get_type_hints

import numpy as np
import sympy as sp

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
from necc_casadi.errors import OptionError
from necc_casadi.model.model_file import Model
from necc_casadi.model.plant import Plant
from necc_casadi.pipeline.request import Choices, Request

__all__ = ["RunOptions", "Target", "request_of"]


#: ``"pi/4"``, one number, all states in order, or values by the names of states.
Target = str | float | sp.Expr | Sequence[float | sp.Expr | str] | Mapping[str, Any]


_Numbers = float | Sequence[float]


class RunOptions(TypedDict, total=False):
    """Options of :func:`necc_casadi.run`, each as the option of ``necc-design`` of that name.

    Attributes
    ----------
    check
        Stop after the verdict: no training.
    param
        Parameters of the model file by name, ``{"k": 4}``.
    compare
        Measure the design beside LQR and the optimum.
    integral
        Integral action on the position; ``True``, or its τ in s.
    uncertain
        Ranges of parameters, ``"m=10%,g=0.95:1.05"``.
    disturbance
        Size of constant disturbances of the inputs, ``"0.2"``, or one per input.
    settle
        Time in which a response is to come within 2 %, s.
    rate
        Rate that every mode at the target is to exceed, 1/s.
    peak_u
        Largest size of u from random starts, a number or one per input.
    polish
        Lower the cost of responses from 32 starts.
    method
        ``"auto"``, or the one method to be tried: ``"interconnection"``, ``"shaping"``,
        ``"modulated"``, ``"mechanical"`` or ``"constant"``.
    structure
        A controller structure that a note offered; by default integrators, one per input.
    paper
        The published form.
    hidden_k, hidden_h
        Widths of the hidden layers of K and Hc, ``(64, 64)``.
    activation
        ``"tanh"``, ``"sin"`` or ``"squareplus"``.
    casimir_form
        ``"joint"`` or ``"sum"``.
    phi
        ``"sum"`` or ``"neural"``.
    convex
        V convex everywhere: ``--global``.
    learn_casimir
        A network in place of closed forms that are missing.
    shape, gamma
        What is asked of V over the domain: ``"level"``, or ``"regulariser"`` with its γ.
    a
        Curvature asked of ∇²V(z*).
    seed, starts
        Seed of the first start; number of starts.
    damping, controller_damping
        D and Dc, a number or one per input.
    plots
        Whether figures are written with the folder.
    format
        ``"png"``, ``"pdf"`` or ``"svg"``, of these.
    sweep_a
        ``(lo, hi, n)``: also design for n values of a.
    real, integrator, sample_time, prefix
        Of the C code: ``"double"`` or ``"float"``; ``"heun"``, ``"euler"``, ``"rk4"`` or
        ``"casimir"``; s; a word.
    min_sample_time, noise, input_error, delay
        What the sampled loop is to bear: s; ``{"q": 1e-3}``, of measured states and of inputs, in
        their units; whether u is applied one sample late.
    fmu, mex
        Also an FMI unit; also a MEX source.

    Examples
    --------
    >>> from necc_casadi import RunOptions, run
    >>> options: RunOptions = {"check": True}
    >>> run("pendulum.py", target="pi/4", **options).status
    'assignable'
    """

    check: bool
    param: Mapping[str, Any]
    compare: bool
    integral: float | bool
    uncertain: str
    disturbance: str
    settle: float
    rate: float
    peak_u: _Numbers
    polish: bool
    method: MethodWord
    structure: str
    paper: bool
    hidden_k: Sequence[int]
    hidden_h: Sequence[int]
    activation: Activation
    casimir_form: CasimirForm
    phi: PhiForm
    convex: bool
    learn_casimir: bool
    shape: Shape
    gamma: float
    a: float
    seed: int
    starts: int
    damping: _Numbers
    controller_damping: _Numbers
    plots: bool
    format: Format
    sweep_a: tuple[float, float, int]
    real: Precision
    integrator: Integrator
    sample_time: float
    min_sample_time: float
    noise: Mapping[str, float]
    input_error: Mapping[str, float]
    delay: bool
    prefix: str
    fmu: bool
    mex: bool


def request_of(
    model: str | Path | Plant | Model,
    target: Target | None,
    out: str | Path | None,
    options: Mapping[str, Any],
) -> Request:
    """The request of one call.

    Raises
    ------
    OptionError
        For an option that does not exist, or a value that is of the wrong kind.
    """
    hints = get_type_hints(RunOptions)
    for name in options:
        if name not in hints:
            near = get_close_matches(name, hints, n=1)
            remedy = f"Did you mean {near[0]}?" if near else f"Options: {', '.join(hints)}."
            raise OptionError("usage", f"run has no option {name}", remedy)
    given = {name: _read(name, hints[name], value) for name, value in options.items()}
    said: dict[str, Any] = {
        **given,
        **{name: _listed(given[name]) for name in ("noise", "input_error") if name in given},
        "param": tuple(f"{k}={_text(v)}" for k, v in given.get("param", {}).items()),
        "target": None if target is None else _target_text(target),
        "model": Path(model) if isinstance(model, str) else model,
        "out": None if out is None else Path(out),
        "command": _call(model, target, options),
    }

    def chosen(kind: type[Choices] | type[Request]) -> dict[str, Any]:
        return {field.name: said[field.name] for field in fields(kind) if field.name in said}

    return Request(chosen=Choices(**chosen(Choices)), **chosen(Request))


def _call(model: object, target: object, options: Mapping[str, Any]) -> str:
    """The call, as it makes the same again elsewhere."""
    shown = Path(model).name if isinstance(model, (str, Path)) else None
    first = "plant" if shown is None else repr(shown)
    said = [first, *([] if target is None else [f"target={_shown(target)}"])]
    said += [f"{name}={_shown(value)}" for name, value in options.items()]
    return f"necc_casadi.run({', '.join(said)})"


def _shown(value: Any) -> str:
    return repr(value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value)


def _listed(sizes: Mapping[str, Any]) -> str:
    return ",".join(f"{name}={_text(size)}" for name, size in sizes.items())


def _text(value: Any) -> str:
    """A number as the command line reads it."""
    if isinstance(value, (str, sp.Expr)):
        return str(value)
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    return repr(float(value))


def _target_text(target: Target) -> str:
    try:
        if isinstance(target, Mapping):
            return ",".join(f"{state}={_text(value)}" for state, value in target.items())
        if isinstance(target, (Sequence, np.ndarray)) and not isinstance(target, str):
            return ",".join(map(_text, target))
        return _text(target)
    except (TypeError, ValueError):
        raise OptionError(
            "usage", f"target = {target!r} is no target", 'Try target="pi/4" or {"q": 0.8}.'
        ) from None


def _read(name: str, hint: Any, value: Any) -> Any:
    """A value of the kind that an option wants."""
    try:
        return _reader(hint)(value)
    except (TypeError, ValueError) as problem:
        raise OptionError("usage", f"{name} = {value!r} {_what(name, problem)}", _HELP) from None


_HELP = "See help(necc_casadi.RunOptions)."


def _what(name: str, problem: Exception) -> str:
    return str(problem) if isinstance(problem, _Unfit) else "is of the wrong kind"


class _Unfit(ValueError):
    """A value that is not what an option wants; says what it is not."""


@cache
def _reader(hint: Any) -> Callable[[Any], Any]:
    if get_origin(hint) is Literal:
        return lambda value: _word(value, get_args(hint))
    if hint is bool:
        return lambda value: _only(value, (bool, np.bool_), bool, "is not True or False")
    if hint is int:
        return _count
    if hint is float:
        return _positive
    if hint is str:
        return lambda value: _only(value, (str,), str, "is no text")
    if hint == _Numbers:
        return _numbers
    if hint == float | bool:
        return lambda value: value if isinstance(value, bool) else _positive(value)
    if hint == Sequence[int]:
        return lambda value: tuple(_count(width, 1) for width in np.atleast_1d(value).tolist())
    if get_origin(hint) is tuple:
        return _range
    return dict


def _only(value: Any, kinds: tuple[type, ...], make: Callable[[Any], Any], fault: str) -> Any:
    if not isinstance(value, kinds):
        raise _Unfit(fault)
    return make(value)


def _word(value: Any, known: Sequence[str]) -> str:
    if value not in known:
        raise _Unfit(f"is none of {', '.join(known)}")
    return str(value)


def _count(value: Any, least: int = 0) -> int:
    if isinstance(value, bool) or int(value) != value or value < least:
        raise _Unfit(f"is no whole number from {least} on")
    return int(value)


def _positive(value: Any) -> float:
    number = float(value)
    if isinstance(value, bool) or not 0 < number < math.inf:
        raise _Unfit("is no positive number")
    return number


def _numbers(value: Any) -> tuple[float, ...]:
    return tuple(float(number) for number in np.atleast_1d(value).tolist())


def _range(value: Any) -> tuple[float, float, int]:
    low, high, count = value
    found = (_positive(low), _positive(high), _count(count, 2))
    if not found[0] < found[1]:
        raise _Unfit("needs lo < hi")
    return found
