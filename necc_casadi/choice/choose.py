"""From a judged target to the design that is kept, of those that the plant allows.

1. *whole space*: quadratic parts of least stiffness for which V has one critical point, then the
   least quadratic cost with no less stiffness;
2. *least cost*: the least quadratic cost alone;
3. *damping alone*: where that gives up region, the same with V as it is by default;
4. *default*: neither.

Where a level is asked for, *shaped* is kept if it makes something better than the default.

Where it is asked for, the one that is kept is improved on responses; that stays out where it gives
up anything that is proved. A candidate is made only while one before it may be beaten. Effort is
counted in iterations and steps, never in seconds: what is kept is a function of the input.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import MOST_KEPT
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.input_limits import holds_everywhere
from necc_casadi.choice.decide import NEAR, Passed, decide, gives_up
from necc_casadi.choice.judged import Judged, Name, Trial, cost_ratio
from necc_casadi.designs.design import Design
from necc_casadi.designs.outcome import Start, solver_seconds
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.performance.other_minima import LowerMinimum, lower_minimum
from necc_casadi.performance.saturated import lqr_costs, saturated
from necc_casadi.performance.shares import plant_share, unclipped_share
from necc_casadi.synthesis.options import Level, Options, check_options
from necc_casadi.synthesis.plan import make_plan, whole_space_stiffness
from necc_casadi.synthesis.synthesis import answered
from necc_casadi.verdict.verdict import Verdict

__all__ = ["Choice", "choose", "default_trial", "may_hold_everywhere"]


#: A whole-space design that costs no more than this multiple of LQR's cost leaves too little to win
#: for the time that another takes.
_NEAR_LQR = 1.15


#: Loops of more states are not trained for least cost: its program grows with their square.
_MOST_STATES = 12


#: What the output layers cost to move when a design is polished, in the order in which it is tried.
_HOLDS = (1e2, 3e3, 1e5)


#: Hears what is being done.
_Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Choice:
    """The design that is kept, with its certificate, and why it is."""

    kept: Judged
    others: tuple[Judged, ...]  # that were made
    passed: tuple[Passed, ...]  # why not these
    lower: LowerMinimum | None  # a minimum of the kept V below V(z̄)
    seconds: Mapping[str, float]  # of all candidates, by stage

    @property
    def design(self) -> Design:
        """The design that is kept."""
        return self.kept.design

    @property
    def certificate(self) -> Certificate:
        """What is proved of it."""
        return self.kept.certificate

    @property
    def was_made(self) -> bool:
        """Whether there was a choice; otherwise the options say what to make."""
        return bool(self.passed)

    @property
    def reason(self) -> str:
        """The trade, in one line."""
        reasons: dict[str, list[str]] = {}
        for passed in self.passed:
            reasons.setdefault(passed.because, []).append(passed.name)
        others = [f"{' and '.join(names)}, because {why}" for why, names in reasons.items()]
        return "; instead of ".join([f"kept: {self.kept.name} ({_worth(self.kept)})", *others])


def choose(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options | None = None,
    say: _Say | None = None,
    family: FamilyLoop | None = None,
) -> Choice:
    """Make the designs that the plant allows, and keep one.

    Options that say how V is made (`convex`, the regulariser, `least_cost`, a Casimir or Φ of
    another form) leave nothing to choose: that design is made and judged.

    Parameters
    ----------
    loop, casimirs, verdict, x_star, options, family
        As for :func:`design`.
    say
        Hears what is being done.

    Returns
    -------
    Choice
        The design, its certificate, its response and the trade in one line.

    Raises
    ------
    OptionError
        ``usage``, where a shape is asked of the form K(Σ βᵢ(cᵢ)).

    References
    ----------
    docs/contract.md, Choice and response.

    Examples
    --------
    >>> from necc_casadi import choose, find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> choice = choose(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> choice.kept.name, choice.certificate.is_global
    ('whole space', True)
    """
    options = options or Options()
    check_options(options)
    plain = replace(options, polish=False)
    maker = _Maker(loop, casimirs, verdict, x_star, plain, say or (lambda text: None), family)
    found = _chosen(maker)
    kept, others, passed = _polished(maker, found) if options.polish else found
    lower = None
    if not kept.whole:
        with maker.stage("choice", kept.name, "other minima of V"):
            lower = lower_minimum(kept.design)
    return Choice(kept, others, passed, lower, dict(maker.seconds))


def may_hold_everywhere(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options,
) -> bool:
    """Whether some V of this loop has one critical point; parameters are those of `choose`."""
    plan = make_plan(loop, casimirs, verdict, x_star, options)
    return whole_space_stiffness(plan) is not None


def default_trial(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options,
    say: _Say,
) -> tuple[Trial, Mapping[str, float]]:
    """The default alone, nothing proved of it, with the seconds that it took, by stage."""
    maker = _Maker(loop, casimirs, verdict, x_star, replace(options, polish=False), say)
    return maker.made("default", maker.options), maker.seconds


_Chosen = tuple[Judged, tuple[Judged, ...], tuple[Passed, ...]]


def _chosen(maker: _Maker) -> _Chosen:
    """What is kept, the others that were made, and why those are not kept."""
    if isinstance(maker.options.shaping, Level):
        return _shaped(maker)
    if not _is_open(maker.verdict, maker.options):
        name: Name = "as asked" if _asks(maker.options) else "default"
        return maker.proved(maker.made(name, maker.options)), (), ()
    passed = list[Passed]()
    limited = maker.loop.plant.u_limits is not None
    default = maker.made("default", maker.options) if limited else None
    trial = _whole_space(maker)
    whole = None
    if trial is not None and not _is_passed(_overreaches(trial, default), trial, passed):
        whole = maker.proved(trial)
    if whole is not None and _is_sound(whole):
        return _beside_the_whole_space(maker, whole, default, passed)
    usual = maker.proved(default or maker.made("default", maker.options))
    made = [usual] if whole is None else [whole, usual]
    least = _least_cost(maker)
    if least is not None and not _is_passed(_cannot_win(least, usual), least, passed):
        made.insert(-1, maker.proved(least))
        if gives_up(made[-2], usual, "the default") is not None:
            made[-1:-1] = _damping_alone(maker, usual, passed)
    return _decided(made, passed)


def _damping_alone(maker: _Maker, usual: Judged, passed: list[Passed]) -> list[Judged]:
    """The default's V, so its region, with the damping of least cost; none where it cannot win."""
    trial = _least_cost(maker, damping_alone=True)
    if trial is None or _is_passed(_cannot_win(trial, usual), trial, passed):
        return []
    return [maker.proved(trial)]


def _shaped(maker: _Maker) -> _Chosen:
    """The design that is shaped for a higher level, unless the default is no worse."""
    trial = maker.made("shaped", maker.options)
    usual = maker.made("default", replace(maker.options, shape="none"))
    if np.array_equal(trial.design.weights, usual.design.weights):
        return maker.proved(usual), (), (Passed("shaped", _nothing_shaped(trial)),)
    shaped = maker.proved(trial)
    if shaped.whole and shaped.proved and shaped.arrivals >= usual.arrivals:
        return shaped, (), (Passed("default", "one critical point of V leaves no obstacle"),)
    other = maker.proved(usual)
    why = _no_better_shaped(shaped, other)
    if why is not None:
        return other, (shaped,), (Passed("shaped", why),)
    return shaped, (other,), (Passed("default", _worth_of_shape(shaped, other)),)


def _nothing_shaped(trial: Trial) -> str:
    if any(start.mode == "shaped" for start in trial.design.starts):
        return "its program found nothing that meets the conditions at z*"
    return (
        "V bends in no state that a Casimir contains, or in more of them than the "
        f"{MOST_KEPT} that a region may keep"
    )


def _no_better_shaped(shaped: Judged, default: Judged) -> str | None:
    """Why a shaped design is not worth its shape."""
    if shaped.arrivals < default.arrivals:
        count = len(default.response.arrived)
        return f"{shaped.arrivals} of {count} starts arrive with it, not {default.arrivals}"
    why = _is_less_proved(shaped, default)
    higher, larger = _rise(shaped, default) > 1, shaped.plant_share > default.plant_share
    return why if why is not None or higher or larger else "its region is no larger and no higher"


def _worth_of_shape(shaped: Judged, default: Judged) -> str:
    """What the default falls short of."""
    own, others = (100 * judged.plant_share for judged in (default, shaped))
    text = f"its region holds {own:.3g} %, not {others:.3g} %, of the plant's states at rest"
    rise = _rise(shaped, default)
    return f"{text}, and what ends it is {rise:.3g} times lower" if 1 < rise < np.inf else text


def _rise(shaped: Judged, default: Judged) -> float:
    """By which factor what ends a region is higher above V(z̄); ∞ where nothing ends it."""
    ends = [judged.certificate.obstacle for judged in (shaped, default)]
    heights = [np.inf if end is None else end.level_above_minimum for end in ends]
    proved = [judged.certificate.region is not None or judged.whole for judged in (shaped, default)]
    own, other = (h if ok else 0.0 for h, ok in zip(heights, proved, strict=True))
    if own == other:
        return 1.0
    return own / other if other > 0 else np.inf


def _beside_the_whole_space(
    maker: _Maker, whole: Judged, default: Trial | None, passed: list[Passed]
) -> _Chosen:
    """What is kept where a candidate is proved everywhere and every start arrives with it."""
    if whole.cost_to_lqr is None or whole.cost_to_lqr <= _NEAR_LQR:
        dear = "" if whole.cost_to_lqr is None else f" at {whole.cost_to_lqr:.3g} × LQR's cost"
        why = f"the whole space is proved{dear}"
        return whole, (), (*passed, Passed("least cost", why), Passed("default", why))
    least = _least_cost(maker)
    if least is not None and _is_passed(_saves_nothing(least, whole), least, passed):
        why = "the whole space is proved without it, and no start goes elsewhere"
        return whole, (), (*passed, Passed("default", why))
    usual = maker.proved(default or maker.made("default", maker.options))
    others = [whole] if least is None else [whole, maker.proved(least)]
    return _decided([*others, usual], passed)


def _polished(maker: _Maker, found: _Chosen) -> _Chosen:
    """With the candidate that is kept improved on responses, where nothing proved is given up."""
    kept, others, passed = found
    why = ""
    for hold in _HOLDS:
        trial = maker.made("polished", replace(kept.options, polish=True, hold=hold))
        if not any(start.mode == "polished" for start in trial.design.starts):
            return kept, others, (*passed, Passed("polished", "no response was improved"))
        reason = _no_better(trial, kept)
        if reason is None:
            better = maker.proved(trial)
            reason = _is_less_proved(better, kept)
            if reason is None:
                times = cost_ratio(kept.response.cost, better.response.cost) or 1.0
                paid = Passed(kept.name, f"it costs {times:.3g} times as much")
                return better, (*others, kept), (*passed, paid)
        why = why or reason
    return kept, others, (*passed, Passed("polished", why))


def _no_better(trial: Trial, kept: Judged) -> str | None:
    """Why responses are no better than those of the candidate that is kept."""
    count = len(trial.response.arrived)
    if trial.arrivals < kept.arrivals:
        return f"{trial.arrivals} of {count} starts arrive with it, not {kept.arrivals}"
    ratio = cost_ratio(trial.response.cost, kept.response.cost)
    if trial.arrivals == kept.arrivals and (ratio is None or ratio >= 1):
        return "it costs no less"
    return None


def _is_less_proved(better: Judged, kept: Judged) -> str | None:
    """What is no longer proved, or asked of the inputs, of a candidate that costs less."""
    if kept.proved and not better.proved:
        return "not every claim about it is proved"
    if kept.fits_limits and not better.fits_limits:
        return "it asks for more than the inputs' limits"
    return gives_up(better, kept, f"the {kept.name} design")


def _decided(made: list[Judged], passed: list[Passed]) -> _Chosen:
    kept, others = decide(made)
    return kept, tuple(c for c in made if c is not kept), (*passed, *others)


def _is_passed(why: str | None, trial: Trial, passed: list[Passed]) -> bool:
    """Whether there is a reason not to prove a candidate; it joins the others that are not kept."""
    if why is not None:
        passed.append(Passed(trial.name, why))
    return why is not None


def _overreaches(trial: Trial, default: Trial | None) -> str | None:
    """Why a candidate asks too much of the inputs, where as many starts arrive by default.

    Nothing is too much where clipped inputs are proved to do no harm, whatever the state.
    """
    if default is None or default.arrivals < trial.arrivals or holds_everywhere(trial.design):
        return None
    beyond, usual = trial.response.beyond, default.response.beyond
    if beyond <= usual:
        return None
    count = len(trial.response.arrived)
    return f"{beyond} of {count} starts ask for more than the inputs' limits, not {usual}"


def _cannot_win(trial: Trial, default: Judged) -> str | None:
    """Why nothing that may be proved of a candidate lets it win against a default that is."""
    if not default.proved or trial.arrivals > default.arrivals:
        return None
    if trial.arrivals < default.arrivals:
        count = len(trial.response.arrived)
        return f"{trial.arrivals} of {count} starts arrive with it, not {default.arrivals}"
    ratio = cost_ratio(trial.response.cost, default.response.cost)
    if ratio is not None and ratio > 1 + NEAR:
        return f"it costs {ratio:.3g} times as much"
    return _overreaches(trial, default)


def _saves_nothing(trial: Trial, whole: Judged) -> str | None:
    """Why a candidate cannot win against one that is proved everywhere and arrives."""
    count = len(trial.response.arrived)
    if trial.arrivals < whole.arrivals:
        return f"{trial.arrivals} of {count} starts arrive with it, not {whole.arrivals}"
    ratio = cost_ratio(trial.response.cost, whole.response.cost)
    if ratio is not None and ratio < 1 - NEAR:
        return None
    times = "about as much" if ratio is None else f"{ratio:.3g} times as much"
    return f"it costs {times}, and no more can be proved of it"


def _is_open(verdict: Verdict, options: Options) -> bool:
    """Whether the options leave it to the tool how V is made, and responses can be judged.

    What decays more slowly than exponentially costs more than a linearisation can tell.
    """
    return not _asks(options) and verdict.exponential


def _asks(options: Options) -> bool:
    """Whether the options say how V is made."""
    plain = options.quadratic and options.phi == "sum" and options.casimir_form == "joint"
    said = (options.convex, options.whole, options.least_cost, options.learn_casimir)
    asked = (options.rate, options.peak_u)
    if any(value is not None for value in asked):
        return True
    return not plain or any(said) or options.shape != "none"


def _is_sound(candidate: Judged) -> bool:
    """Whether the whole space is proved, and no start says otherwise."""
    against = candidate.response.strayed or not candidate.fits_limits
    return candidate.proved and candidate.whole and not against


def _takes_cost(maker: _Maker) -> bool:
    """Whether damping is free, as the least cost needs it, and the loop small enough for it."""
    free = maker.options.D is None and maker.options.Dc is None
    return free and maker.loop.n <= _MOST_STATES


def _whole_space(maker: _Maker) -> Trial | None:
    """The candidate with one critical point; None where no stiffness is enough."""
    with maker.stage("design", "whole space", "stiffness"):
        loop, casimirs, verdict = maker.loop, maker.casimirs, maker.verdict
        plan = make_plan(loop, casimirs, verdict, maker.x_star, maker.options, maker.family)
        stiffness = whole_space_stiffness(plan)
    if stiffness is None:
        return None
    options = replace(maker.options, whole=True, least_cost=_takes_cost(maker))
    return maker.made("whole space", options)


def _least_cost(maker: _Maker, damping_alone: bool = False) -> Trial | None:
    """The candidate of least cost; None where nothing was found that costs less."""
    if not _takes_cost(maker):
        return None
    options = replace(maker.options, least_cost=True, damping_alone=damping_alone)
    trial = maker.made("damping alone" if damping_alone else "least cost", options)
    found = any(start.mode == "cost" for start in trial.design.starts)
    return trial if found else None


@dataclass(frozen=True, eq=False)
class _Maker:
    """Makes, follows and proves candidates at one target."""

    loop: ClosedLoop
    casimirs: Casimirs
    verdict: Verdict
    x_star: Mapping[sp.Symbol, sp.Expr]
    options: Options
    say: _Say
    family: FamilyLoop | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    _lqr: list[Vector | None] = field(default_factory=list)  # what LQR costs, once it is known

    @contextmanager
    def stage(self, stage: str, name: Name, text: str) -> Iterator[None]:
        """A block that takes its time."""
        self.say(text if name == "as asked" else f"{name}: {text}")
        began = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - began

    def made(self, name: Name, options: Options) -> Trial:
        """A candidate, trained and followed from even starts."""
        outcomes: list[Start] = []

        def report(start: Start) -> None:
            outcomes.append(start)
            head = "" if name == "as asked" else f"{name}: "
            count = f"start {len(outcomes)} of {options.starts}"
            self.say(f"{head}training: {count}, loss {start.loss:.1e}")

        with self.stage("design", name, "training"):
            as_it_is = name == "as asked" or options.least_cost or options.shaping is not None
            made_by = options if as_it_is else _unweighted(options)
            parts = (self.loop, self.casimirs, self.verdict, self.x_star)
            found = answered(*parts, made_by, report, self.family)
        made = found.design
        self.seconds["solve"] = self.seconds.get("solve", 0.0) + solver_seconds(made.starts)
        with self.stage("choice", name, "following starts"):
            cost = options.cost(made.sizes, made.loop.plant.n)
            response = saturated(made, cost)
            if not self._lqr:
                self._lqr.append(lqr_costs(made, cost, response.starts))
        ratio = cost_ratio(response.cost, self._lqr[0])
        return Trial(name, options, made, found.asked, response, ratio)

    def proved(self, trial: Trial) -> Judged:
        """The candidate with its certificate."""
        made, head = trial.design, "" if trial.name == "as asked" else f"{trial.name}: "
        with self.stage("certify", trial.name, "proving"):
            certificate = certify(made, report=lambda text, _: self.say(f"{head}proving: {text}"))
        with self.stage("choice", trial.name, "comparing regions"):
            share = plant_share(made, certificate)
            within = unclipped_share(made, certificate)
        return Judged(
            **vars(trial), certificate=certificate, plant_share=share, unclipped_share=within
        )


def _unweighted(options: Options) -> Options:
    """Weights judge a candidate; by themselves they do not make it one of least cost."""
    return replace(options, state_cost=None, input_cost=None)


def _worth(kept: Judged) -> str:
    """What a candidate is kept for."""
    share = f"{100 * kept.plant_share:.3g} % of the plant's states at rest are in its region"
    parts = ["one critical point of V is proved" if kept.whole else share]
    parts.append(f"{kept.arrivals} of {len(kept.response.arrived)} starts arrive")
    if kept.cost_to_lqr is not None:
        parts.append(f"cost {kept.cost_to_lqr:.3g} × LQR")
    return ", ".join(parts)
