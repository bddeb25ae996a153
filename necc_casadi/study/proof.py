"""What a Monte Carlo study is about: a design, its plants, and what is proved of these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import CERTIFICATE_FILE
from necc_casadi.designs.design import Design
from necc_casadi.designs.family import FAMILY_FILE, Family
from necc_casadi.designs.plant_file import PLANT_FILE, parse_plant, plant_text, read_plant
from necc_casadi.errors import OptionError, OutputError
from necc_casadi.files import read_text
from necc_casadi.performance.beside_proof import BesideProof, Proved, nominal_plant, proved
from necc_casadi.report.beside import proved_and_sampled
from necc_casadi.simulation.perturbed import OtherPlants, disturbance_names
from necc_casadi.simulation.responses import random_states
from necc_casadi.study.tables import Table
from necc_casadi.study.vary import Band, read_bands

__all__ = ["Subject", "subject"]


#: Plants whose responses are drawn, and states that they start from in turn.
_DRAWN, _STARTS = 40, 8


#: Bytes of a certificate at most.
_LARGEST = 1 << 28


@dataclass(frozen=True, eq=False)
class Subject:
    """A design on plants with other parameters and disturbances."""

    design: Design
    plant: str  # content of plant.json
    bands: tuple[Band, ...]
    proved: Proved | None  # of some ranges

    @property
    def is_covered(self) -> bool:
        """Whether the proof is about every plant of the bands."""
        sides = {band.name: (band.lo, band.hi) for band in self.bands}
        return self.proved is not None and self.proved.covers(sides)

    def beside(self, table: Table, seed: int) -> BesideProof | None:
        """The finished rows beside the proof, some of them followed again; None without one."""
        if self.proved is None or not self.is_covered:
            return None
        plants = OtherPlants(self.design, parse_plant(self.plant))
        starts = random_states(self.design, _STARTS, seed)
        values = {band.name: table.numbers(band.name) for band in self.bands}
        errors = []
        for row in range(min(_DRAWN, len(table))):
            theta = plants.nominal.copy()
            for name, column in values.items():
                theta[plants.names.index(name)] = column[row]
            errors.append(plants.error_from(theta, starts[row % len(starts)]))
        states = self.design.loop.plant.states
        offsets = np.stack([table.numbers(f"offset_{name}") for name in states], axis=1)
        rests = tuple(row if np.isfinite(row).all() else None for row in offsets)
        return BesideProof(self.proved, plants.grid, tuple(errors), rests)

    def rows(self, beside: BesideProof | None) -> list[str]:
        """What the answer says of the proof."""
        if self.proved is None:
            return []
        if beside is None:
            sides = self.proved.ranges.items()
            ranges = ", ".join(f"{name} {lo:.6g} … {hi:.6g}" for name, (lo, hi) in sides)
            return [f"  proof       is about {ranges}: not about all of these plants"]
        plant = self.design.loop.plant
        return [f"  proof       {proved_and_sampled(beside, plant.states, plant.units)}"]

    def in_json(self, beside: BesideProof | None) -> dict[str, Any] | None:
        """The same for programs; None where the proof is not about these plants."""
        if self.proved is None or beside is None:
            return None
        rests, states = beside.at_rest, self.design.loop.plant.states
        seen = {
            name: [float(rests[:, i].min()), float(rests[:, i].max())] if len(rests) else None
            for i, name in enumerate(states)
        }
        return {
            "claim": self.proved.claim,
            "error": {name: list(side) for name, side in self.proved.error.items()},
            "sampled_error": seen,
        }


def subject(folder: Path, vary: str | None) -> Subject:
    """The design in a folder, with the plants that are asked for, or else those that are proved.

    Raises
    ------
    OptionError
        Where nothing is asked for and nothing is proved of ranges, or a band is none.
    OutputError
        Where something in the folder is missing or cannot be read.
    """
    made = Design.load(folder)
    found = _proved(folder, made)
    pushes = disturbance_names(made.loop.plant)
    named = _names(vary) if vary is not None else list(found.ranges if found is not None else ())
    if not named:
        raise OptionError(
            "usage",
            "--vary is missing, and nothing is proved of ranges that it could be taken from",
            "Write --vary m=10%, or design with --uncertain or --disturbance.",
        )
    pushed_alone = set(named) <= set(pushes) and not (folder / PLANT_FILE).exists()
    if pushed_alone:
        plant = nominal_plant(made)
        text = plant_text(made, plant)
    else:
        plant, text = read_plant(folder, made)
    if vary is None and found is not None:
        bands = tuple(Band(name, lo, hi) for name, (lo, hi) in found.ranges.items() if lo < hi)
        return Subject(made, text, bands, found)
    known: Mapping[str, sp.Expr] = {**dict.fromkeys(pushes, sp.Integer(0)), **plant.values}
    return Subject(made, text, read_bands(vary or "", known), found)


def _names(vary: str) -> list[str]:
    return [part.partition("=")[0].strip() for part in vary.split(",")]


def _proved(folder: Path, made: Design) -> Proved | None:
    """What the files of a folder say is proved of ranges; None where they have no certificate."""
    path = folder / CERTIFICATE_FILE
    if not path.is_file():
        return None
    try:
        certificate = Certificate.from_json(read_text(path, _LARGEST))
    except OSError as problem:
        raise OutputError(
            "output", f"{path} cannot be read: {problem.strerror}", "Design again with necc-design."
        ) from None
    if certificate.design_hash != made.hash:
        return None
    family = Family.load(folder) if (folder / FAMILY_FILE).is_file() else None
    return proved(made, certificate, family)
