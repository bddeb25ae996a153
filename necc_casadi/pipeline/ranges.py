"""Ranges on the command line: a target that moves, uncertain parameters, disturbances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import sympy as sp

from necc_casadi.errors import InputError, ModelError, OptionError, TargetError
from necc_casadi.model.model_file import Model
from necc_casadi.model.ranges import Range, Ranges
from necc_casadi.symbolic.expressions import parse_number

__all__ = ["middle_of_target", "with_ranges"]


_UNCERTAIN = "Write --uncertain m=10%,g=0.95:1.05, the nominal value within."


_DISTURBANCE = "Write --disturbance 0.2 for [-0.2, 0.2]; one number, or one per input."


def middle_of_target(text: str | None) -> str | None:
    """``q=-2:3`` of --target as ``q=((-2)+(3))/2``; what is no range stays as it is."""
    if text is None or ":" not in text:
        return text
    return ",".join(_middle(entry) for entry in text.split(","))


def _middle(entry: str) -> str:
    name, _, value = entry.partition("=")
    lo, colon, hi = value.partition(":")
    return f"{name}=(({lo})+({hi}))/2" if colon else entry


def with_ranges(
    model: Model, target: str | None, uncertain: str | None, disturbance: str | None
) -> Model:
    """The model with the ranges of the options in place of its own.

    Raises
    ------
    InputError
        For a range that is none, or of something that the model does not have.
    """
    own = model.ranges
    moving = _setpoints(model, target)
    return replace(
        model,
        ranges=Ranges(
            own.setpoints if target is None or not moving else moving,
            own.uncertain if uncertain is None else _uncertain(model, uncertain),
            own.disturbance if disturbance is None else _disturbance(model, disturbance),
        ),
    )


def _setpoints(model: Model, text: str | None) -> dict[str, Range]:
    found: dict[str, Range] = {}
    if text is None or ":" not in text:
        return found
    for entry in text.split(","):
        name, equals, value = (part.strip() for part in entry.partition("="))
        if ":" not in entry:
            continue
        if not equals or name not in model.system.states:
            raise TargetError(
                "target_value",
                f"--target {entry.strip()}: a range needs the name of a state",
                f"Write q=-1:1; states: {', '.join(model.system.states)}.",
            )
        found[name] = _range(
            value,
            f"--target {name}",
            "target_value",
            TargetError,
            f"Write {name}=LO:HI with LO < HI.",
        )
    return found


def _range(
    text: str, label: str, code: str, error: Callable[..., InputError], remedy: str
) -> Range:
    parts = text.split(":")
    kind = TargetError if error is TargetError else ModelError
    if len(parts) == 2:
        lo, hi = (parse_number(part, label, code, kind) for part in parts)
        if bool(lo < hi):
            return lo, hi
    raise error(code, f"{label}: {text.strip()} is no range LO:HI with LO < HI", remedy)


def _uncertain(model: Model, text: str) -> dict[str, Range]:
    found: dict[str, Range] = {}
    for entry in text.split(","):
        name, equals, value = (part.strip() for part in entry.partition("="))
        label = f"--uncertain {entry.strip()}"
        if not equals or name in found:
            raise OptionError("param", f"{label} is no range of one more parameter", _UNCERTAIN)
        nominal = model.params.get(name)
        if nominal is None or model.parametric is None:
            known = ", ".join(model.params) or "none; write params = {m: 1}"
            raise ModelError(
                "param",
                f"{label}: the model has no parameter {name}",
                f"Its parameters: {known}.",
            )
        if value.endswith("%"):
            share = parse_number(value[:-1], label, "param", ModelError) / 100
            side = (nominal - share * abs(nominal), nominal + share * abs(nominal))
        else:
            side = _range(value, label, "param", ModelError, _UNCERTAIN)
        if not bool(side[0] <= nominal <= side[1]) or side[0] == side[1]:
            raise ModelError("param", f"{label} is no range around {nominal}", _UNCERTAIN)
        found[name] = side
    return found


def _disturbance(model: Model, text: str) -> tuple[Range, ...]:
    parts: Sequence[str] = text.split(",")
    m = model.system.m
    sizes = [parse_number(part, "--disturbance", "usage", OptionError) for part in parts]
    if len(sizes) not in (1, m) or not all(bool(size >= 0) for size in sizes) or not any(sizes):
        raise OptionError(
            "usage",
            f"--disturbance {text} is not a size for each of {m} input(s)",
            _DISTURBANCE,
        )
    sizes = sizes * m if len(sizes) == 1 else sizes
    return tuple((sp.sympify(-size), sp.sympify(size)) for size in sizes)
