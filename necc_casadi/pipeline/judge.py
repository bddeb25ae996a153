"""What is asked of a design: the model, the judged target and the method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import sympy as sp

from necc_casadi.casimirs.outputs import integrated_outputs
from necc_casadi.files import check_writable
from necc_casadi.methods.find import Found, find_method
from necc_casadi.methods.method import Method
from necc_casadi.model.model_file import Model
from necc_casadi.model.plant import Plant
from necc_casadi.model.spot_checks import check_model_at
from necc_casadi.pipeline.advice import loop_notes, nearest_note, structure_offers
from necc_casadi.pipeline.clock import Say
from necc_casadi.pipeline.ranges import with_ranges
from necc_casadi.pipeline.request import (
    Request,
    read_method,
    read_model,
    read_options,
    read_target,
    with_structure,
)
from necc_casadi.synthesis.options import Options

if TYPE_CHECKING:  # what --check does not need is loaded when it is reached
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.outcome import Start

__all__ = ["Task", "judge", "train"]


#: Structures that may be designed for, to keep one; the third only if nothing else is proved.
_STRUCTURES = 3


@dataclass(frozen=True, eq=False)
class Task:
    """A judged target, and what the design is asked for."""

    model: Model
    x_star: dict[sp.Symbol, sp.Expr]
    found: Found
    options: Options
    notes: tuple[str, ...]

    @property
    def method(self) -> Method:
        """The loop that is to hold the target."""
        if self.found.chosen is None:
            raise ValueError("no method holds the target")
        return self.found.chosen


def judge(request: Request, say: Say) -> Task:
    """Read the model, find its Casimirs, judge the target."""
    if request.out is not None and not request.check:
        check_writable(request.out)
    model = with_ranges(read_model(request), request.target, request.uncertain, request.disturbance)
    options = read_options(request, model)
    x_star = read_target(model, request.target)
    is_plant = isinstance(model.system, Plant)
    notes = [*model.notes, *(check_model_at(model.loop, x_star) if is_plant else ())]
    if request.structure is not None:
        model = with_structure(model, request.structure, x_star)
    method = read_method(request, options)
    kept = request.integrator == "casimir"
    most = 1 if request.check or kept else _STRUCTURES
    found = find_method(model, x_star, method, say, most, options.cost)
    if options.learn_casimir and found.learnable is not None:
        found = replace(found, chosen=found.learnable)
    if request.integral is not False and found.chosen is not None:
        from necc_casadi.synthesis.integral import refuse_integral

        held = found.chosen
        refuse_integral(held.loop, held.casimirs.functions, options.phi == "sum")
    if kept and found.chosen is not None:
        integrated_outputs(found.chosen.loop, found.chosen.casimirs.functions)
    if found.chosen is not None and not is_plant:
        notes += check_model_at(found.chosen.loop, x_star)
    if found.published is not None:
        notes += loop_notes(found.published, x_star)
    verdict = None if found.published is None else found.published.verdict
    if verdict is not None and verdict.reason == "not_an_equilibrium":
        notes += nearest_note(model, x_star)
    if is_plant and request.structure is None and _wants_more(found):
        say("searching for a controller structure that helps")
        notes += structure_offers(model, x_star)
    return Task(model, x_star, found, options, tuple(notes))


def _wants_more(found: Found) -> bool:
    """Whether another controller structure of the published loop might hold more."""
    chosen = found.chosen
    return chosen is None or chosen.verdict.stability != "asymptotic"


def train(task: Task, options: Options, say: Say) -> Design:
    """One design at the target with these options."""
    from necc_casadi.synthesis.synthesis import answered

    outcomes: list[Start] = []

    def report(start: Start) -> None:
        outcomes.append(start)
        say(f"training: start {len(outcomes)} of {options.starts}, loss {start.loss:.1e}")

    method = task.method
    return answered(
        method.loop, method.casimirs, method.verdict, task.x_star, options, report
    ).design
