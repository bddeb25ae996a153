"""The natural units of design.json, and numbers in other units, exactly or not at all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import sympy as sp

from necc_casadi.certificate.claims.units import Units

__all__ = ["StoredUnits", "divided", "numbers", "rationals"]


class StoredUnits:
    """What 1 means in natural units; a file that names none is in the units of its model.

    Raises
    ------
    ValueError
        When the units are not positive powers of two, one for each quantity, or a neural Φ, whose
        logarithms would be rounded, has another unit of energy than 1.
    """

    def __init__(self, data: Mapping[str, Any], states: int) -> None:
        form, inputs, casimirs = data["form"], len(data["D"]), len(data["casimirs"]["functions"])
        self.state, self.input, self.casimir = [1.0] * states, [1.0] * inputs, [1.0] * casimirs
        self.energy = self.time = 1.0
        self.size = [1.0] * states  # (N,) how far a domain reaches, halved
        if "units" in data or "sizes" in data:
            self._read(data["units"], data["sizes"])
        counts = (len(self.state), len(self.input), len(self.casimir), len(self.size))
        if counts != (states, inputs, casimirs, states):
            raise ValueError("there must be one unit for each state, input and Casimir")
        units = Units((*self.state, *self.input, *self.casimir), self.energy, self.time)
        if not units.exact or (form["phi"] is not None and self.energy != 1):
            raise ValueError("units must be positive powers of two, 1 for the energy of a neural Φ")
        if not all(0 < size < math.inf for size in self.size):
            raise ValueError("sizes must be positive")
        self.weights = self._of_weights(form)

    def _read(self, units: Mapping[str, Any], sizes: Mapping[str, Any]) -> None:
        self.state, self.input, self.casimir = (
            numbers(units[key]) for key in ("state", "input", "casimir")
        )
        self.energy, self.time = numbers([units["energy"], units["time"]])
        self.size = divided(numbers(sizes["state"]), self.state)

    @property
    def proof(self) -> Units:
        """The units of what is proved."""
        return Units(tuple(self.state), self.energy, self.time)

    def _of_weights(self, form: Mapping[str, Any]) -> list[float]:
        """Units of all weights, in the order of the file."""
        betas, phi = form["betas"], form["phi"]
        inner = self.state[len(self.state) - form["hc"]["inputs"] :]
        result = _of_network(form["hc"], inner, self.energy)
        result += _of_network(form["k"], [1.0] if betas else self.casimir, self.energy)
        for beta, unit in zip(betas, self.casimir, strict=False):
            result += _of_network(beta, [unit], 1.0)
        return result + [1.0] * (0 if phi is None else 4 * phi["hidden"])


def _of_network(network: Mapping[str, Any], inputs: list[float], energy: float) -> list[float]:
    """Units of the weights of a network, layer by layer, then of κ and the centre."""
    widths = [network["inputs"], *network["hidden"], 1]
    result: list[float] = []
    for layer, (before, after) in enumerate(pairwise(widths)):
        out = energy if layer == len(widths) - 2 else 1.0
        row = [out / unit for unit in inputs] if layer == 0 else [out] * before
        result += row * after + [out] * after
    if network["quadratic"]:
        result += [energy / (unit * unit) for unit in inputs] + inputs
    return result


def numbers(texts: Sequence[str]) -> list[float]:
    """Hexadecimal floats.

    Raises
    ------
    ValueError
        When one is not finite.
    """
    values = [float.fromhex(text) for text in texts]
    if not all(map(math.isfinite, values)):
        raise ValueError("a number is not finite")
    return values


def rationals(values: Sequence[float]) -> list[sp.Rational]:
    """Floats as the rationals that they are."""
    return [sp.Rational(*value.as_integer_ratio()) for value in values]


def divided(values: Sequence[float], units: Sequence[float]) -> list[float]:
    """Numbers in other units, exactly.

    Raises
    ------
    ValueError
        Where a number would be rounded, since it is all but 0 or all but infinite.
    """
    result = [v / u for v, u in zip(values, units, strict=True)]
    if any(r * u != v for r, u, v in zip(result, units, values, strict=True)):
        raise ValueError("a number is too large or too small for its unit")
    return result
