"""One finished design on many plants, parameters drawn uniformly from bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from necc_casadi.designs.design import Design
from necc_casadi.designs.plant_file import parse_plant
from necc_casadi.simulation.perturbed import OtherPlants
from necc_casadi.simulation.responses import random_states
from necc_casadi.study.rows import Row
from necc_casadi.study.vary import Band

__all__ = ["MonteCarlo"]


@dataclass(frozen=True)
class MonteCarlo:
    """Plants are numbered: the same number and seed give the same plant, whoever computes it."""

    design: str  # content of design.json
    plant: str  # content of plant.json
    bands: tuple[Band, ...]
    starts: int
    seed: int

    @property
    def _tools(self) -> tuple[OtherPlants, list[Any]]:
        return _tools(self.design, self.plant, self.starts, self.seed)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the values in a row."""
        made = _design(self.design)
        return (
            *(band.name for band in self.bands),
            "settled",
            "converging_share",
            "settling_time",
            *(f"offset_{name}" for name in made.loop.plant.states),
            *(f"peak_{name}" for name in made.loop.plant.input_names),
        )

    @property
    def study(self) -> Mapping[str, Any]:
        """What tells this study from others."""
        return {
            "study": "montecarlo",
            "format": 1,
            "design": _design(self.design).hash,
            "vary": {band.name: [band.lo, band.hi] for band in self.bands},
            "starts": self.starts,
            "seed": self.seed,
        }

    def drawn(self, index: int) -> list[float]:
        """Parameters of one plant, in the order of the bands."""
        rng = np.random.default_rng([self.seed, index])
        return [float(rng.uniform(band.lo, band.hi)) for band in self.bands]

    def row(self, index: int) -> Row:
        """The plant of this number: where it comes to rest, from how many starts, how fast."""
        plants, starts = self._tools
        values = self.drawn(index)
        theta = plants.nominal.copy()
        for band, value in zip(self.bands, values, strict=True):
            theta[plants.names.index(band.name)] = value
        found = plants.follow(theta, starts)
        arrived = found.settling_times[np.isfinite(found.settling_times)]
        n = plants.design.loop.plant.n
        offset = [None] * n if found.offset is None else found.offset.tolist()
        return [
            *values,
            found.share == 1.0,
            found.share,
            float(arrived.max()) if arrived.size else None,
            *offset,
            *found.peak_input.tolist(),
        ]


@lru_cache(maxsize=2)
def _design(text: str) -> Design:
    return Design.from_text(text)


@lru_cache(maxsize=2)
def _tools(design: str, plant: str, starts: int, seed: int) -> tuple[OtherPlants, list[Any]]:
    """Prepared once in each process."""
    made = _design(design)
    return OtherPlants(made, parse_plant(plant)), random_states(made, starts, seed)
