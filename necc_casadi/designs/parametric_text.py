"""A plant with its parameters as symbols, as design.json and plant.json hold it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp

from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.expressions import parse, to_text
from necc_casadi.symbolic.identifiers import identifiers
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_plants", "parametric_of", "parametric_text", "plants_of", "plants_text"]


def parametric_text(states: Sequence[str], plant: Parametric) -> dict[str, Any]:
    """Names, plain symbols, values and expressions; `states` are those of the plant."""
    names = (*states, *map(str, plant.symbols))
    plain = identifiers(names)
    rename = {
        sp.Symbol(name, real=True): sp.Symbol(letter, real=True)
        for name, letter in zip(names, plain, strict=True)
    }

    def text(value: Any) -> Any:
        if isinstance(value, sp.MatrixBase):
            return [[text(entry) for entry in row] for row in value.tolist()]
        return to_text(value.xreplace(rename))

    return {
        "names": list(names),
        "symbols": plain,
        "parameters": {str(s): to_text(plant.values[str(s)]) for s in plant.symbols},
        **{name: text(getattr(plant, name)) for name in ("J", "R", "G", "H")},
    }


def parametric_of(data: Mapping[str, Any]) -> Parametric:
    """The plant of these entries; what they cannot be read by raises as :func:`parse` does."""
    symbols = {
        plain: sp.Symbol(name, real=True)
        for plain, name in zip(data["symbols"], data["names"], strict=True)
    }

    def matrix(name: str) -> sp.ImmutableMatrix:
        return sp.ImmutableMatrix([[parse(entry, symbols) for entry in row] for row in data[name]])

    return Parametric(
        matrix("J"),
        matrix("R"),
        matrix("G"),
        parse(data["H"], symbols),
        {name: parse(value) for name, value in data["parameters"].items()},
    )


def plants_text(states: Sequence[str], plants: Plants) -> dict[str, Any]:
    """Ranges, and the plant with these parameters alone as symbols."""
    ranges = {name: [to_text(v) for v in side] for name, side in plants.ranges.items()}
    return {"ranges": ranges, "plant": parametric_text(states, plants.parametric)}


def plants_of(data: Mapping[str, Any]) -> Plants:
    """The plants of these entries.

    Raises
    ------
    ValueError
        Where ranges are not those of the plant's parameters around their values.
    """
    plant = parametric_of(data["plant"])
    ranges = {name: (parse(lo), parse(hi)) for name, (lo, hi) in data["ranges"].items()}
    if set(ranges) != set(plant.values):
        raise ValueError("parameters that are told need a range each")
    for name, (lo, hi) in ranges.items():
        if not (
            bool(lo < hi) and bool(lo <= plant.values[name]) and bool(plant.values[name] <= hi)
        ):
            raise ValueError("a parameter that is told has a range around its value")
    return Plants(plant, ranges)


def check_plants(plants: Plants, plant: Plant) -> None:
    """Raise ValueError unless the plant at the parameters' values is this one."""
    own = plants.parametric.at(plants.parametric.values)
    if any(not name.isidentifier() or name in plant.states for name in plants.ranges):
        raise ValueError("a parameter that is told needs a word of its own")
    pairs = [(getattr(own, name), getattr(plant, name)) for name in "JRG"]
    if any(a.shape != b.shape for a, b in pairs):
        raise ValueError("the plant that is told has another shape")
    left = [own.H - plant.H, *(v for a, b in pairs for v in a - b)]
    if any(is_zero(v) is not True for v in left):
        raise ValueError("the plant that is told is not that of the model")
