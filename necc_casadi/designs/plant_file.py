"""plant.json: the plant of a design with its parameters as symbols, for studies on other plants.

It names the hash of its design.json, which alone holds the plant that was designed for.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from necc_casadi.designs.design import Design
from necc_casadi.designs.layout import BROKEN
from necc_casadi.designs.parametric_text import parametric_of, parametric_text
from necc_casadi.errors import OutputError
from necc_casadi.files import read_text, refuse_unfinished
from necc_casadi.model.parametric import Parametric
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.zero import is_zero

__all__ = ["PLANT_FILE", "parse_plant", "plant_text", "read_plant"]


PLANT_FILE = "plant.json"


_PLANT_FORMAT = 1


_LARGEST = 1 << 26  # bytes


def plant_text(design: Design, plant: Parametric) -> str:
    """The content of plant.json."""
    data = {
        "format": _PLANT_FORMAT,
        "design": design.hash,
        **parametric_text(design.loop.plant.states, plant),
    }
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def read_plant(out: Path, design: Design) -> tuple[Parametric, str]:
    """The plant of OUT/plant.json, which belongs to the design of OUT, and the file's content.

    Raises
    ------
    OutputError
        When there is none, as for a model without parameters, when it is not readable, or when it
        is of another design.
    """
    refuse_unfinished(out)
    path = out / PLANT_FILE
    try:
        text = read_text(path, _LARGEST)
        plant = parse_plant(text)
        belongs = json.loads(text)["design"] == design.hash
        fits = belongs and _same(plant.at(plant.values), design)
    except FileNotFoundError:
        raise OutputError(
            "output",
            f"{path} is missing: the model of this design names no parameters",
            "Write numbers of the model as params = {symbol: number} and design again.",
        ) from None
    except (*BROKEN, OSError) as problem:
        raise OutputError(
            "output", f"{path} cannot be read: {problem!r}", "Design again with necc-design."
        ) from None
    if not fits:
        raise OutputError(
            "output", f"{path} is of another design", "Design again with necc-design."
        )
    return plant, text


def parse_plant(text: str) -> Parametric:
    """The plant of a plant.json; raises one of BROKEN where the text holds none."""
    data: Mapping[str, Any] = json.loads(text)
    if data["format"] != _PLANT_FORMAT:
        raise ValueError(f"format {data['format']!r}")
    return parametric_of(data)


def _same(plant: Parametric, design: Design) -> bool:
    """Whether nothing but the parameters' values tells it from the plant of the design."""
    own = design.loop.plant
    if own.preliminary is not None:
        flow = (plant.J - plant.R) * gradient(plant.H, own.x)
        moved = [*(flow - own.drift), *(plant.G - own.directions)]
        return all(is_zero(entry) is True for entry in moved)
    pairs = [(plant.H, own.H), *zip((*plant.J, *plant.R, *plant.G), (*own.J, *own.R, *own.G),
                                    strict=True)]  # fmt: skip
    return all(one == other or is_zero(one - other) is True for one, other in pairs)
