"""Plants that a proof is about, drawn from its ranges and simulated: sampled beside proved.

Proved is how far from the target every one of them rests: within the bounds of the claim `family`,
or not at all with integral action, by the claim `integral`. Sampled plants are at the corners of
the ranges first, then anywhere in them; the set-point is the target.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice, product
from typing import Literal

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.designs.design import Design
from necc_casadi.designs.family import Family
from necc_casadi.model.parametric import Parametric
from necc_casadi.simulation.perturbed import OtherPlants, disturbance_names
from necc_casadi.simulation.responses import random_states
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.floats import to_float

__all__ = ["BesideProof", "Proved", "beside_proof", "nominal_plant", "proved"]


#: Plants that are drawn, of them at corners at most, and states that they start from in turn.
_PLANTS, _CORNERS, _STARTS = 40, 16, 8


#: Least and greatest.
_Side = tuple[float, float]


@dataclass(frozen=True)
class Proved:
    """Where every plant of some ranges comes to rest, proved; in the units of the model."""

    claim: Literal["family", "integral"]
    ranges: Mapping[str, _Side]  # parameter, or d_<input> -> least and greatest
    error: Mapping[str, _Side]  # plant state less its set-point, at rest

    def covers(self, values: Mapping[str, _Side]) -> bool:
        """Whether what varies, and no more, is within the ranges."""
        return all(
            name in self.ranges and self.ranges[name][0] <= lo and hi <= self.ranges[name][1]
            for name, (lo, hi) in values.items()
        )


@dataclass(frozen=True, eq=False)
class BesideProof:
    """Sampled plants beside what is proved of them; in the units of the model."""

    proved: Proved
    times: Vector  # (T,) s
    errors: tuple[Vector, ...]  # each (≤ T, n): plant states less their target
    rests: tuple[Vector | None, ...]  # (n,) each, at rest; None: not at rest nearby

    @property
    def at_rest(self) -> Vector:
        """Errors at rest, (plants, n), of those that rest nearby."""
        known = [rest for rest in self.rests if rest is not None]
        return np.array(known).reshape(len(known), -1)


def proved(
    design: Design, certificate: Certificate | None, family: Family | None = None
) -> Proved | None:
    """What is proved of a design's place at rest on plants with ranges; None where nothing is.

    Parameters
    ----------
    family
        Of family.json, where there is one.
    """
    claims = () if certificate is None else certificate.claims
    held = {claim.name: claim for claim in claims if claim.holds}
    if design.integral is not None and "integral" in held:
        return _of_integral(design, held["integral"])
    if family is None or "family" not in held:
        return None
    known = {p.name: p for p in family.parameters if p.kind != "setpoint"}
    ranges = {name: (to_float(p.range[0]), to_float(p.range[1])) for name, p in known.items()}
    sides = held["family"].data["error"].items()
    error = {name: (float(lo), float(hi)) for name, (lo, hi) in sides}
    return Proved("family", ranges, error) if ranges else None


def _of_integral(design: Design, claim: Claim) -> Proved | None:
    sides = dict(claim.data.get("uncertain", {}))
    pushes = disturbance_names(design.loop.plant)
    sides |= zip(pushes, claim.data.get("disturbance", []), strict=False)
    ranges = {k: (to_float(parse(a, {})), to_float(parse(b, {}))) for k, (a, b) in sides.items()}
    error = dict.fromkeys(design.loop.plant.states, (0.0, 0.0))
    return Proved("integral", ranges, error) if ranges else None


def nominal_plant(design: Design) -> Parametric:
    """The plant of a design without parameters."""
    plant = design.loop.plant
    return Parametric(plant.J, plant.R, plant.G, plant.H, {})


def beside_proof(
    design: Design, found: Proved, parametric: Parametric | None, seed: int = 0
) -> BesideProof:
    """Plants drawn from the ranges of a proof, each followed from one state of the domain.

    Parameters
    ----------
    parametric
        The plant with its parameters as symbols; None where disturbances alone have a range.
    """
    plants = OtherPlants(design, parametric or nominal_plant(design))
    names, starts = list(found.ranges), random_states(design, _STARTS, seed)
    low, high = np.array([found.ranges[name] for name in names]).T
    places = [plants.names.index(name) for name in names]
    rng = np.random.default_rng(seed)
    shares = [np.array(c) for c in islice(product((0.0, 1.0), repeat=len(names)), _CORNERS)]
    shares += [rng.uniform(size=len(names)) for _ in range(_PLANTS - len(shares))]
    errors, rests = [], []
    for index, share in enumerate(shares):
        theta = plants.nominal.copy()
        theta[places] = low + share * (high - low)
        errors.append(plants.error_from(theta, starts[index % len(starts)]))
        rests.append(plants.rest_error(theta))
    return BesideProof(found, plants.grid, tuple(errors), tuple(rests))
