"""What a user might do next, in one line each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import sympy as sp

from necc_casadi.methods.method import Method
from necc_casadi.model.model_file import Model
from necc_casadi.model.piece import loop_piece
from necc_casadi.model.sizes import Sizes
from necc_casadi.model.target import nearest_equilibrium
from necc_casadi.pipeline.request import option_word
from necc_casadi.synthesis.options import Options
from necc_casadi.verdict.controller_structures import suggest_controllers

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.designs.design import Design
    from necc_casadi.simulation.responses import Trajectory

__all__ = [
    "design_notes",
    "loop_notes",
    "nearest_note",
    "region_notes",
    "response_notes",
    "structure_offers",
]


#: A design whose ε, in natural units, is above this gets a note: IPOPT's status, what to try.
_NOTED_LOSS = 1e-9


#: A proved region that holds less of the domain gets a note on how it may grow.
_SMALL_SHARE = 0.1


#: Longer lists of names are shortened.
_FEW_NAMES = 6


def structure_offers(model: Model, x_star: Mapping[sp.Symbol, sp.Expr]) -> list[str]:
    """What `--structure` would change, one note per structure."""
    notes = []
    for label, _, verdict in suggest_controllers(model.loop.plant, x_star):
        reach = "assignable" if verdict.assignable else "undecided"
        stability = f", {verdict.stability}" if verdict.stability else ""
        notes.append(
            f"with a {label} the target is {reach}{stability}: add --structure {option_word(label)}"
        )
    return notes


def nearest_note(model: Model, x_star: dict[sp.Symbol, sp.Expr]) -> list[str]:
    """An equilibrium near a target that is none."""
    plant = model.system
    nearest = nearest_equilibrium(plant, x_star)
    if nearest is None:
        return []
    values = ",".join(f"{s}={v:.6g}" for s, v in zip(plant.states, nearest, strict=True))
    return [f"the nearest equilibrium that was found: {values}"]


def loop_notes(published: Method, x_star: Mapping[sp.Symbol, sp.Expr]) -> list[str]:
    """What of the model was not proved, where it was looked at, and which Casimirs are missing."""
    loop, casimirs = published.loop, published.casimirs
    notes = [
        f"{p.name} held at sampled points only: what rests on it is not proved"
        for p in loop.properties
        if not p.proved
    ]
    where = loop_piece(loop, x_star).note
    return [*notes, *(note for note in (where, casimirs.note) if note)]


def design_notes(made: Design, options: Options) -> list[str]:
    """What was guessed for a design, and where it fell short of what was asked."""
    notes = _size_notes(made.sizes)
    if made.a < made.a_requested:
        notes.append(
            f"a = {made.a_requested:.4g} was asked for, but no network can exceed "
            f"a_max = {made.verdict.a_max:.4g}: a = {made.a:.4g} is used"
        )
    best = min(made.starts, key=lambda s: s.loss)
    if best.loss > _NOTED_LOSS:
        notes.append(f"IPOPT: {best.explained.meaning}. {best.explained.remedy}")
    if options.shaping is not None and best.mode != "shaped":
        notes.append(
            f"--shape {options.shape} was not reached: V meets the conditions at z* only. "
            "Try another --seed, more --starts or wider networks"
        )
    return notes


def _size_notes(sizes: Sizes) -> list[str]:
    """A warning where natural sizes were guessed."""
    if not sizes.guessed:
        return []
    names = sizes.guessed
    listed = ", ".join(names if len(names) <= _FEW_NAMES else [names[0], "…", names[-1]])
    return [
        f"sizes of {listed} were guessed; where they are far off, add "
        "sizes = {name: a large value} to the model file"
    ]


def region_notes(certificate: Certificate, share: float | None, options: Options) -> list[str]:
    """How a region that ends at a pass of V may grow: V can be shaped for it.

    `share` is that of the domain which was found in the region.
    """
    plain = options.shaping is None and not (options.convex or options.learn_casimir)
    obstacle = certificate.obstacle
    at_a_pass = obstacle is not None and obstacle.kind == "critical_point"
    if plain and at_a_pass and share is not None and share < _SMALL_SHARE and options.phi == "sum":
        return ["the proved region is small: --shape level shapes V for a larger one"]
    return []


def response_notes(responses: Sequence[Trajectory], patience: float) -> list[str]:
    """How many responses were cut when the time for computing them, in s, was over."""
    cut = sum(response.cut for response in responses)
    if not cut:
        return []
    return [
        f"{cut} of {len(responses)} responses were cut after {patience:g} s of computing: "
        "the loop is stiff or very slow"
    ]
