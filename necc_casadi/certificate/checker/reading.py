"""Files of unknown origin: bounded before they are read, and read strictly.

A folder may come from anybody. What is checked here costs little whatever the files hold; it is
done before anything is parsed, allocated or evaluated.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from necc_casadi.certificate.claims.claim import CERTIFICATE_FILE, DESIGN_FILE, PLANT_FILE
from necc_casadi.certificate.claims.fields import Fields, without_twins
from necc_casadi.errors import OutputError
from necc_casadi.files import read_text, refuse_unfinished
from necc_casadi.texts import escaped

__all__ = ["check_design", "model_hash", "read_folder", "read_plant", "unreadable"]


#: Bytes of a file, nested lists and objects in it, and entries of them.
_LARGEST, _MOST_LISTS, _MOST_ENTRIES = 1 << 26, 100_000, 4_000_000


#: Depth of lists in one another: regions and matrices need six.
_DEEPEST = 30


#: States, inputs or Casimirs, and letters of a name.
_MOST_STATES, _LONGEST_NAME = 100, 100


#: Letters of an expression, and of all of them.
_LONGEST, _LONGEST_TOGETHER = 20_000, 1_000_000


#: Layers of a network, and neurons of a layer.
_MOST_LAYERS, _WIDEST = 16, 1 << 16


#: Letters of a fault that are shown.
_SHOWN = 200


def read_folder(folder: Path) -> tuple[str, Fields, Mapping[str, Any]]:
    """Text of design.json, and the entries of certificate.json and of design.json.

    Raises
    ------
    OutputError
        When one is missing, no regular file, too large, or no JSON object without twins.
    """
    refuse_unfinished(folder)
    design = _read(folder / DESIGN_FILE)
    return design, Fields(_parsed(_read(folder / CERTIFICATE_FILE))), _parsed(design)


def read_plant(folder: Path, design_text: str) -> str | None:
    """plant.json of a folder, where it has one that is of this design and as bounded as it is.

    Raises
    ------
    OutputError
        When it is no regular file, or too large.
    KeyError, TypeError, ValueError
        When it holds something else than a plant of this design.
    """
    if not (folder / PLANT_FILE).exists():
        return None
    text = _read(folder / PLANT_FILE)
    data = _parsed(text)
    rows = [row for key in ("J", "R", "G") for row in data[key]]
    written = _texts([data["H"], *dict(data["parameters"]).values()])
    _check_expressions([*written, *(entry for row in rows for entry in _texts(row))])
    names = [*_texts(data["names"]), *_texts(data["symbols"])]
    if len(names) > 4 * _MOST_STATES or any(len(name) > _LONGEST_NAME for name in names):
        raise ValueError("plant.json names more than a plant has")
    if any(escaped(name) != name for name in names):
        raise ValueError("plant.json has a name that holds characters that cannot be shown")
    if data["design"] != hashlib.sha256(design_text.encode()).hexdigest():
        return None  # of another design: nothing is proved from it
    return text


def unreadable(folder: Path, problem: BaseException) -> OutputError:
    """The folder holds something else than a design with its certificate."""
    text = escaped(f"{type(problem).__name__}: {problem}")
    shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
    return OutputError(
        "output", f"{folder} holds no readable certificate: {shown}", "Run necc-design again."
    )


def _read(path: Path) -> str:
    try:
        text = read_text(path, _LARGEST)
    except (OSError, UnicodeDecodeError) as problem:
        fault = f"{path} cannot be read: {problem}"
        raise OutputError("output", fault, "Name a folder of necc-design.") from None
    if text.count("[") + text.count("{") > _MOST_LISTS or text.count(",") > _MOST_ENTRIES:
        fault = f"{path} cannot be read: more entries than a design has"
        raise OutputError("output", fault, "Name a folder of necc-design.")
    return text


def _parsed(text: str) -> dict[str, Any]:
    """A JSON object of finite numbers in which no name stands twice.

    Raises
    ------
    ValueError
        When it is something else.
    """
    try:
        data = json.loads(
            text, object_pairs_hook=without_twins, parse_constant=_refuse, parse_float=_finite
        )
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(data, dict):
        raise ValueError("not a JSON object")
    if _depth(data) > _DEEPEST:
        raise ValueError("nested too deeply")
    return data


def _depth(data: Any) -> int:
    level, depth = [data], 0
    while level and depth <= _DEEPEST:
        inner = [v.values() if isinstance(v, dict) else v for v in level]
        level = [v for values in inner for v in values if isinstance(v, (dict, list))]
        depth += 1
    return depth


def _refuse(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text[:20]} is too large for a double")
    return number


def check_design(data: Mapping[str, Any]) -> None:
    """Whether a design has sizes that a design can have, and no more weights than it names.

    Raises
    ------
    KeyError, TypeError, ValueError
        When it has not.
    """
    model, form = data["model"], data["form"]
    casimirs = _texts(data["casimirs"]["functions"])
    _check_names(model, len(casimirs), len(data["D"]))
    points = [text for side in dict(data.get("setpoints", {})).values() for text in _texts(side)]
    told = _told(data["told"]) if "told" in data else []
    _check_expressions([*_written(model), *casimirs, *_texts(data["target"]), *points, *told])
    inner, betas = len(model["controller_states"]), form["betas"]
    inputs = [inner, *([1] * (1 + len(casimirs)) if betas else [len(casimirs)])]
    networks = [form["hc"], form["k"], *betas]
    if [network["inputs"] for network in networks] != inputs:
        raise ValueError("the networks do not fit the controller and its Casimirs")
    count = sum(map(_weights, networks)) + _outer_weights(form["phi"])
    if count != len(_texts(data["weights"])):
        raise ValueError(f"{len(data['weights'])} weights for networks that have {count}")


def _check_names(model: Mapping[str, Any], casimirs: int, inputs: int) -> None:
    names = [*_texts(model["states"]), *_texts(model["controller_states"])]
    symbols = _texts(model["symbols"])
    if not len(names) == len(symbols) == len(set(names)) == len(set(symbols)):
        raise ValueError("each state needs a name and a symbol of its own")
    own = _texts(model.get("inputs", []))
    if len(own) not in (0, inputs) or len({*names, *own}) != len(names) + len(own):
        raise ValueError("each input needs a name of its own")
    if max(len(names), inputs, casimirs) > _MOST_STATES:
        raise ValueError(f"more than {_MOST_STATES} states, inputs or Casimirs")
    if any(escaped(name) != name or len(name) > _LONGEST_NAME for name in (*names, *own, *symbols)):
        raise ValueError("a name that is too long or holds characters that cannot be shown")


def _written(model: Mapping[str, Any]) -> list[str]:
    """The expressions of a model."""
    own = ("alpha",) if "gamma" in model else ("Jc", "Rc", "Gc")
    matrices = [model[key] for key in ("J", "R", "G", *own)]
    gamma = _texts(model["gamma"]) if "gamma" in model else []
    matrices += dict(model["preliminary"]).values() if "preliminary" in model else []
    matrices += [model["inertia"]] if "inertia" in model else []
    rows = [row for matrix in matrices for row in matrix] + list(dict(model["domain"]).values())
    return _texts([model["H"], *gamma, *(entry for row in rows for entry in _texts(row))])


def _told(data: Mapping[str, Any]) -> list[str]:
    """The expressions of a plant with parameters that are told."""
    plant, sides = data["plant"], dict(data["ranges"]).values()
    if len(_texts(plant["names"])) > _MOST_STATES + len(sides) or len(sides) > _MOST_STATES:
        raise ValueError(f"more than {_MOST_STATES} parameters")
    rows = [row for key in ("J", "R", "G") for row in plant[key]]
    values = list(dict(plant["parameters"]).values())
    words = [*plant["names"], *_texts(plant["symbols"]), *dict(data["ranges"])]
    return [
        *words,
        *_texts([plant["H"], *values]),
        *(v for row in (*rows, *sides) for v in _texts(row)),
    ]


def _check_expressions(texts: list[str]) -> None:
    if max(map(len, texts)) > _LONGEST or sum(map(len, texts)) > _LONGEST_TOGETHER:
        raise ValueError(f"expressions of more than {_LONGEST} characters")
    if any(escaped(text) != text for text in texts):
        raise ValueError("an expression holds characters that cannot be shown")


def _outer_weights(phi: Mapping[str, Any] | None) -> int:
    """Number of weights of a neural Φ."""
    if phi is None:
        return 0
    delta = phi["delta"]
    if not isinstance(delta, float) or delta <= 0:
        raise ValueError("δ of a neural Φ must be positive")
    return 4 * _whole(phi["hidden"], _WIDEST)


def _weights(network: Mapping[str, Any]) -> int:
    """Number of weights of a network; its layers are looked at one by one, and not made."""
    hidden = network["hidden"]
    if not isinstance(hidden, list) or len(hidden) > _MOST_LAYERS:
        raise ValueError("too many layers")
    widths = [network["inputs"], *(_whole(width, _WIDEST) for width in hidden), 1]
    dense = sum((before + 1) * after for before, after in pairwise(widths))
    return int(dense + (2 * widths[0] if network["quadratic"] is True else 0))


def _whole(value: Any, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise ValueError(f"a width of {value!r:.20}")
    return value


def _texts(values: Any) -> list[str]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise ValueError("a list of texts is missing")
    return values


def model_hash(data: Mapping[str, Any]) -> str:
    """SHA-256 of the model in design.json, as it was written."""
    return hashlib.sha256(json.dumps(data["model"], sort_keys=True).encode()).hexdigest()
