"""What a study varies: bands of parameters, and axes of a grid, as texts say them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod

import sympy as sp

from necc_casadi.errors import OptionError
from necc_casadi.symbolic.expressions import parse_number
from necc_casadi.symbolic.floats import to_float

__all__ = ["Axis", "Band", "grid", "read_axes", "read_bands"]


#: Points of a grid at most.
_MOST = 1_000_000


@dataclass(frozen=True)
class Band:
    """A parameter that is known to lie between two values."""

    name: str
    lo: float
    hi: float


@dataclass(frozen=True)
class Axis:
    """Values that one thing takes in turn, exact, as texts."""

    name: str
    values: tuple[str, ...]


def read_bands(text: str, nominal: Mapping[str, sp.Expr]) -> tuple[Band, ...]:
    """``m=10%,g=9:10`` for parameters with these values.

    Raises
    ------
    OptionError
        For a parameter that the model does not have, or a band that is none.
    """
    bands = []
    for part in text.split(","):
        name, separator, value = (piece.strip() for piece in part.partition("="))
        if not separator or not value:
            raise _unreadable(part, "m=10% or m=0.9:1.1")
        if name not in nominal:
            known = ", ".join(nominal) or "none"
            raise OptionError(
                "param",
                f"--vary {name}: the model of this design has no parameter {name}",
                f"Its parameters: {known}.",
            )
        bands.append(_band(name, value, to_float(nominal[name])))
    names = [band.name for band in bands]
    _refuse_twice(names)
    return tuple(bands)


def _band(name: str, text: str, nominal: float) -> Band:
    if text.endswith("%"):
        share = abs(_number(text[:-1], name)) / 100
        lo, hi = sorted((nominal * (1 - share), nominal * (1 + share)))
    else:
        low, separator, high = text.partition(":")
        if not separator:
            raise _unreadable(f"{name}={text}", "m=10% or m=0.9:1.1")
        lo, hi = _number(low, name), _number(high, name)
    if not lo < hi:
        raise OptionError(
            "usage",
            f"--vary {name}={text} is no band: from {lo:g} to {hi:g}",
            f"The model has {name} = {nominal:g}; write {name}=10% or {name}=LO:HI with LO < HI.",
        )
    return Band(name, lo, hi)


def _number(text: str, name: str) -> float:
    return to_float(parse_number(text, f"--vary {name}", "usage", OptionError))


def read_axes(texts: Sequence[str], known: Sequence[str], seeds: str | None) -> tuple[Axis, ...]:
    """Axes of a grid: ``m=0.9:1.1:3`` or ``m=0.9,1`` each, and ``0:5`` of seeds, 0 to 4.

    Raises
    ------
    OptionError
        For a name that is not known, values that cannot be read, or a grid that is too large.
    """
    _refuse_many(prod(map(_size, texts)))  # before any values are made
    axes = [_axis(text, known) for text in texts]
    if seeds is not None:
        axes.append(Axis("seed", _seeds(seeds)))
    _refuse_twice([axis.name for axis in axes])
    _refuse_many(prod(len(axis.values) for axis in axes))
    return tuple(axes)


def _refuse_many(count: int) -> None:
    if count > _MOST:
        raise OptionError(
            "usage", f"--vary: the grid has {count} points", f"At most {_MOST} can be studied."
        )


def _size(text: str) -> int:
    """How many values an axis is going to have, if it can be read."""
    spaced = re.fullmatch(r"[^:]*:[^:]*:\s*(\d{1,7})\s*", text)
    return int(spaced[1]) if spaced else text.count(",") + 1


def grid(axes: Sequence[Axis], index: int) -> dict[str, str]:
    """The values at one point of the grid; the last axis changes fastest."""
    found = {}
    for axis in reversed(axes):
        index, place = divmod(index, len(axis.values))
        found[axis.name] = axis.values[place]
    return {axis.name: found[axis.name] for axis in axes}


def _axis(text: str, known: Sequence[str]) -> Axis:
    name, separator, values = (piece.strip() for piece in text.partition("="))
    if not separator or not values:
        raise _unreadable(text, "target=0:3:13 or m=0.9,1,1.1")
    if name not in known:
        raise OptionError(
            "usage", f"--vary {name}: there is no {name} to vary", f"Known: {', '.join(known)}."
        )
    label = f"--vary {name}"
    if ":" not in values:
        exact = [parse_number(part, label, "usage", OptionError) for part in values.split(",")]
        return Axis(name, tuple(map(str, exact)))
    parts = values.split(":")
    if len(parts) != 3 or not re.fullmatch(r"\s*\d{1,7}\s*", parts[2]) or int(parts[2]) < 2:
        raise _unreadable(text, f"{name}=LO:HI:N with N from 2 on")
    lo, hi = (parse_number(part, label, "usage", OptionError) for part in parts[:2])
    last = int(parts[2]) - 1
    return Axis(name, tuple(str(lo + (hi - lo) * k / last) for k in range(last + 1)))


def _seeds(text: str) -> tuple[str, ...]:
    found = re.fullmatch(r"(\d{1,9}):(\d{1,9})", text)
    if found is None or not int(found[1]) < int(found[2]):
        raise OptionError(
            "usage", f"--seeds {text} is not FROM:TO", "--seeds 0:5 stands for seeds 0, 1, 2, 3, 4."
        )
    first, last = int(found[1]), int(found[2])
    _refuse_many(last - first)
    return tuple(map(str, range(first, last)))


def _refuse_twice(names: Sequence[str]) -> None:
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise OptionError("usage", f"--vary names {twice[0]} twice", "Name each once.")


def _unreadable(text: str, example: str) -> OptionError:
    return OptionError("usage", f"--vary {text} cannot be read", f"Write --vary {example}.")
