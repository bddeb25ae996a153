"""Which loop is to hold a target: the published one where it can, else the first that can."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import sympy as sp

from necc_casadi.cases import MethodWord
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.methods.method import Method, Refusal
from necc_casadi.methods.modulated import at_its_minimum, shifted_plant
from necc_casadi.methods.shaping import power_shaping
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.model_file import Model
from necc_casadi.model.modulated import Modulated
from necc_casadi.model.plant import Plant
from necc_casadi.verdict.judge import judge

__all__ = ["Found", "find_method"]


@dataclass(frozen=True, eq=False)
class Found:
    """What was found about a target by the methods that were asked."""

    published: Method | None  # the published loop, whatever its verdict; None: no such loop
    chosen: Method | None  # what holds the target
    refusals: tuple[Refusal, ...] = ()  # of the methods that do not

    @property
    def learnable(self) -> Method | None:
        """The published loop where it is not refused: a Casimir that closed forms lack may help."""
        published = self.published
        return None if published is None or published.verdict.assignable is False else published

    @property
    def refused(self) -> bool:
        """Whether the target is refused: the published loop with proof, or each method with one."""
        if self.chosen is not None:
            return False
        if self.published is not None and self.published.verdict.assignable is False:
            return True
        return bool(self.refusals) and all(refusal.proved for refusal in self.refusals)


def find_method(
    model: Model,
    x_star: Mapping[sp.Symbol, sp.Expr],
    wanted: MethodWord = "auto",
    say: Callable[[str], None] = lambda _: None,
) -> Found:
    """The loop that holds a target.

    Parameters
    ----------
    model
        What a model file says.
    x_star
        Exact value of every plant state.
    wanted
        The one method to be tried; auto: each in turn, the published loop first.
    say
        Called with what is done next.
    """
    system = model.system
    if isinstance(system, Plant):
        say("finding Casimirs")
        published = _published(model, x_star, say)
        if wanted in ("auto", "interconnection") and published.verdict.assignable:
            return Found(published, published)
        plant = system
    elif isinstance(system, Modulated):
        say("looking for the shift of the energy")
        shifted = shifted_plant(system, x_star)
        if isinstance(shifted, str):
            return Found(None, None, (Refusal("modulated", shifted, False),))
        published, plant = _of_plant(shifted, x_star), shifted
        damped = at_its_minimum(shifted, x_star)
        if wanted in ("auto", "modulated") and damped is not None:
            return Found(published, damped)
        if wanted in ("auto", "modulated") and published.verdict.assignable:
            return Found(published, replace(published, name="modulated"))
    else:
        published = None
    refusals: list[Refusal] = []
    if published is not None and wanted != "interconnection":
        for answer in _others(plant, x_star, wanted, say):
            if isinstance(answer, Method):
                return Found(published, answer, tuple(refusals))
            refusals.append(answer)
    return Found(published, None, tuple(refusals))


def _published(
    model: Model, x_star: Mapping[sp.Symbol, sp.Expr], say: Callable[[str], None]
) -> Method:
    """The published loop with the controller and the Casimirs that the model names."""
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    say("judging the target")
    verdict = judge(model.loop, casimirs, x_star)
    return Method("interconnection", model.loop, casimirs, verdict)


def _of_plant(plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr]) -> Method:
    """The published loop with one integrator per input."""
    loop = interconnect(plant, default_controller(plant))
    casimirs = find_casimirs(loop, (), x_star)
    return Method("interconnection", loop, casimirs, judge(loop, casimirs, x_star))


def _others(
    plant: Plant,
    x_star: Mapping[sp.Symbol, sp.Expr],
    wanted: MethodWord,
    say: Callable[[str], None],
) -> Iterator[Method | Refusal]:
    """What can be done in place of the published loop, in order."""
    if wanted in ("auto", "shaping", "modulated"):
        say("looking for power-shaping outputs")
        answer = power_shaping(plant, x_star)
        if isinstance(answer, Method) and plant.preliminary is not None:
            answer = replace(answer, name="modulated")
        yield answer
