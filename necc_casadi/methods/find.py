"""Which loop is to hold a target: the published one where it can, else the first that can."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.cases import MethodName, MethodWord
from necc_casadi.casimirs.condition import is_casimir
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.methods.ahead import plant_with_feedback
from necc_casadi.methods.constant import constant_structure
from necc_casadi.methods.linear_target import Weigh, linear_target
from necc_casadi.methods.mechanical import mechanical_structures
from necc_casadi.methods.method import Method, PassedStructure, Refusal
from necc_casadi.methods.modulated import at_its_minimum, shifted_plant
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.methods.shaping import power_shaping
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.cost import bryson
from necc_casadi.model.model_file import Model
from necc_casadi.model.modulated import Modulated, System
from necc_casadi.model.plant import Plant
from necc_casadi.model.sizes import natural_sizes
from necc_casadi.symbolic.zero import Undecided
from necc_casadi.verdict.judge import judge

__all__ = ["Found", "find_method"]


@dataclass(frozen=True, eq=False)
class Found:
    """What was found about a target by the methods that were asked."""

    published: Method | None  # the published loop, whatever its verdict; None: no such loop
    chosen: Method | None  # what holds the target
    refusals: tuple[Refusal, ...] = ()  # of the methods that do not
    alternatives: tuple[Method, ...] = ()  # other structures that hold it
    passed: tuple[PassedStructure, ...] = ()  # those of them that were compared and are not kept
    asked: bool = True  # whether the published loop is one of the methods that were asked

    @property
    def learnable(self) -> Method | None:
        """The published loop where it is not refused: a Casimir that closed forms lack may help."""
        published = self.published
        return None if published is None or published.verdict.assignable is False else published

    @property
    def refused(self) -> bool:
        """Whether the target is refused: the published loop with proof, or each method with one.

        A target that is no equilibrium is refused by every method.
        """
        if self.chosen is not None:
            return False
        verdict = None if self.published is None else self.published.verdict
        if (
            verdict is not None
            and verdict.assignable is False
            and (self.asked or verdict.reason == "not_an_equilibrium")
        ):
            return True
        return bool(self.refusals) and all(refusal.proved for refusal in self.refusals)


def find_method(
    model: Model,
    x_star: Mapping[sp.Symbol, sp.Expr],
    wanted: MethodWord = "auto",
    say: Callable[[str], None] = lambda _: None,
    most: int = 1,
    weigh: Weigh = bryson,
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
    most
        Structures that hold the target, of this and of later methods, one of which is to be kept.
    weigh
        What responses cost: it chooses the numbers that a structure leaves free.
    """
    system = model.system
    published = _published(model, x_star, say) if isinstance(system, Plant) else None
    asked = published is not None and wanted in ("auto", "interconnection")
    if published is not None and asked and published.verdict.assignable:
        return Found(published, published)
    question = _Question(system, x_star, wanted, say, weigh)
    if isinstance(system, Modulated):
        published = question.shifted_loop
    refusals: list[Refusal] = []
    held: list[Method] = []
    for answers in question.families():
        for answer in answers:
            if isinstance(answer, Method):
                held.append(answer)
            elif not held:
                refusals.append(answer)
            if len(held) == most:
                break
        if len(held) == most:
            break
    chosen = held[0] if held else None
    return Found(published, chosen, tuple(refusals), tuple(held[1:]), asked=asked)


def _published(
    model: Model, x_star: Mapping[sp.Symbol, sp.Expr], say: Callable[[str], None]
) -> Method:
    """The published loop with the controller and the Casimirs that the model names."""
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    say("judging the target")
    verdict = judge(model.loop, casimirs, x_star)
    return Method("interconnection", model.loop, casimirs, verdict)


def _of_plant(
    plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr], gammas: Sequence[sp.Expr] = ()
) -> Method:
    """The published loop with one integrator per input, whose Casimirs γ − ξ may be known."""
    loop = interconnect(plant, default_controller(plant))
    known = [g - s for g, s in zip(gammas, loop.controller.xi, strict=False)]
    supplied = [c for c in known if is_casimir(c, loop)]
    casimirs = find_casimirs(loop, supplied, x_star)
    return Method("interconnection", loop, casimirs, judge(loop, casimirs, x_star))


def _of_family(found: NoStructure) -> str:
    """Why there is no structure, and in which family where the method has more than one."""
    return found.reason if found.family == "mechanical" else f"{found.family}: {found.reason}"


def _decided(
    name: MethodName, answers: Callable[[], Iterator[Method | Refusal]]
) -> Iterator[Method | Refusal]:
    """The answers of a method, as long as it can tell what is zero."""
    try:
        yield from answers()
    except Undecided as unknown:
        yield Refusal(name, f"no proof was found whether {unknown} is zero", False)


@dataclass(frozen=True, eq=False)
class _Question:
    """A target of a plant, and which methods may answer it."""

    system: System
    x_star: Mapping[sp.Symbol, sp.Expr]
    wanted: MethodWord
    say: Callable[[str], None]
    weigh: Weigh

    def families(self) -> Iterator[Iterator[Method | Refusal]]:
        """What each method other than the published loop says, in order."""
        families: dict[MethodName, Callable[[], Iterator[Method | Refusal]]] = {
            "modulated": self._modulated,
            "shaping": self._shaping,
            "mechanical": self._mechanical,
            "constant": self._constant,
        }
        for name, answers in families.items():
            if self.wanted in ("auto", name):
                yield _decided(name, answers)

    @cached_property
    def _shifted(self) -> Plant | str:
        """A plant with inputs in J or sources, as the input beside u* sees it."""
        if not isinstance(self.system, Modulated):
            return "no input stands in J or R, and there is no source"
        self.say("looking for the shift of the energy")
        return shifted_plant(self.system, self.x_star)

    @cached_property
    def shifted_loop(self) -> Method | None:
        """The published loop of that plant."""
        shifted = self._shifted
        return None if isinstance(shifted, str) else _of_plant(shifted, self.x_star)

    def _modulated(self) -> Iterator[Method | Refusal]:
        shifted, loop = self._shifted, self.shifted_loop
        if isinstance(shifted, str) or loop is None:
            if isinstance(self.system, Modulated):
                yield Refusal("modulated", str(shifted), False)
            return
        damped = at_its_minimum(shifted, self.x_star)
        if damped is not None:
            yield damped
            return
        if loop.verdict.assignable:
            yield replace(loop, name="modulated")
            return
        self.say("looking for power-shaping outputs")
        yield replace(power_shaping(shifted, self.x_star), name="modulated")

    def _shaping(self) -> Iterator[Method | Refusal]:
        if isinstance(self.system, Plant):
            self.say("looking for power-shaping outputs")
            yield power_shaping(self.system, self.x_star)

    def _mechanical(self) -> Iterator[Method | Refusal]:
        if not isinstance(self.system, Plant):
            return
        self.say("looking for a mechanical target structure")
        for found in mechanical_structures(self.system, self.x_star, self.weigh):
            if isinstance(found, NoStructure):
                yield Refusal("mechanical", _of_family(found), found.proved)
                continue
            plant, gammas = plant_with_feedback(found, self.x_star, self.system)
            method = _of_plant(plant, self.x_star, gammas)
            if method.verdict.assignable:
                yield replace(method, name="mechanical")
            else:
                reason = f"a structure matches, but its loop is refused: {method.verdict.reason}"
                yield Refusal("mechanical", reason, False)

    def _constant(self) -> Iterator[Method | Refusal]:
        system = self.system
        if system.directions.free_symbols:
            yield Refusal("constant", "the inputs do not act in constant directions", False)
            return
        self.say("looking for a constant target structure")
        found = constant_structure(
            system.drift,
            system.directions,
            system.x,
            self.x_star,
            sizes=self._sizes,
            cheap=self._cheap_gains,
            name=system.name,
            units=system.units,
            domain=system.domain,
        )
        if isinstance(found, NoStructure):
            yield Refusal("constant", found.reason, found.proved)
            return
        plant, _ = plant_with_feedback(found, self.x_star, system)
        answer = power_shaping(plant, self.x_star)
        if isinstance(answer, Refusal):
            answer = at_its_minimum(plant, self.x_star) or answer
        yield replace(answer, name="constant")

    @property
    def _cheap_gains(self) -> Vector | None:
        """Gains of LQR in the units of the model; None where the plant's sizes are not known."""
        if not isinstance(self.system, Plant):
            return None
        loop = interconnect(self.system, default_controller(self.system))
        sizes = natural_sizes(loop, (), self.x_star)
        target = linear_target(self.system, self.x_star, sizes, self.weigh)
        if target is None:
            return None
        units, n = sizes.units, self.system.n
        return np.asarray(target.best.K * units.input[:, None] / units.state[:n], float)

    @property
    def _sizes(self) -> dict[sp.Symbol, float] | None:
        """Sizes that the model names."""
        given = {str(s): s for s in self.system.x}
        sizes = {given[k]: float(v) for k, v in self.system.sizes.items() if k in given}
        return sizes if len(sizes) == self.system.n else None
