"""The words of a certificate: each held claim as a function of the data that is proved.

Maker and checker both word a claim with these, each from what it proved itself; a statement in
certificate.json that reads otherwise is not what was proved. Numbers are shown rounded to the
safe side.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from typing import Literal, get_args

from necc_casadi.certificate.claims.disturbed import DisturbedRegion
from necc_casadi.certificate.claims.motions import Follows
from necc_casadi.certificate.claims.regions import MOST_KEPT, Obstacle, ObstacleKind
from necc_casadi.certificate.claims.rounding import LIBRARY
from necc_casadi.certificate.claims.sampled import Method, SampledRegion
from necc_casadi.certificate.claims.units import Units
from necc_casadi.texts import velocity_names

__all__ = [
    "DAMPING",
    "DECREASE",
    "GLOBAL",
    "INTEGRAL_IS_NOT_COVERED",
    "INTEGRAL_IS_TOO_SMALL",
    "MATCHING",
    "MEASURED_OF_ANY_MASS",
    "MEASURED_OF_THIS_MASS",
    "NOT_MEASURED",
    "NO_FAMILY",
    "NO_INTEGRAL",
    "NO_LOCAL_INTEGRAL",
    "NO_MEMBERS",
    "NO_MOMENTA",
    "NO_NEIGHBOURHOOD",
    "NO_REGION",
    "NO_SETPOINTS",
    "ONLY_STABLE",
    "SETPOINTS_ARE_NOT_COVERED",
    "SHAPED_STRUCTURE",
    "STRUCTURE",
    "TOO_MANY",
    "Missing",
    "NotDisturbed",
    "NotEverywhere",
    "NotSampled",
    "attraction",
    "casimir",
    "clipped_everywhere",
    "clipping",
    "conserved",
    "disturbed",
    "disturbed_is_not_covered",
    "down",
    "equilibrium",
    "input_limits",
    "integral",
    "limited_by",
    "local_integral",
    "momenta",
    "no_clipping",
    "no_limits",
    "not_everywhere",
    "not_global",
    "ranges",
    "region",
    "sampled",
    "sampled_is_not_covered",
    "setpoints",
    "slope",
    "unproved",
    "up",
]


STRUCTURE = "J = −Jᵀ, R = Rᵀ ⪰ 0, Jc = −Jcᵀ, Rc = Rcᵀ ⪰ 0 hold exactly for all states"


#: Of power shaping: u = −α∇Hc(ξ) + v, ξ̇ = ∇γᵀẋ + v_c make the loop [I; ∇γᵀ](J − R)[I, ∇γ].
SHAPED_STRUCTURE = "J = −Jᵀ, R = Rᵀ ⪰ 0, (J − R)∇γ = −Gα hold exactly for all states"


#: Of feedback ahead of the loop, u = u₀(x) + B(x)ũ of a plant ẋ = f + g u.
MATCHING = (
    "f + g u₀ = (J − R)∇H and g B = G hold exactly for all states: under u = u₀ + Bũ the plant "
    "ẋ = f + g u is the structure that the proofs are about"
)


DAMPING = "the symmetric part of the damping is ≻ 0, in exact arithmetic on the stored numbers"


DECREASE = (
    "V never increases along the continuous-time, unsaturated loop, wherever the model is "
    "defined and for every damping with a symmetric part ≻ 0"
)


#: Of a controller that takes q̇ in place of the momenta.
MEASURED_OF_ANY_MASS = (
    "the controller takes (q, q̇), and neither inertia nor potential nor friction stands in it: "
    "with any others, the inertia ≻ 0 and the friction ⪰ 0 in the momenta, the V made of their "
    "energy decreases as well"
)


MEASURED_OF_THIS_MASS = (
    "the controller takes (q, q̇) and p = M q̇ with the inertia of the model: what is claimed of "
    "(q, p) holds for that inertia"
)


NOT_MEASURED = "q̇ is not proved to be what the controller takes for the momenta"


INTEGRAL_IS_NOT_COVERED = (
    "nothing is proved of the integral action: the plant, its loop or its damping is not of the "
    "kind that is covered"
)


INTEGRAL_IS_TOO_SMALL = (
    "nothing is proved of the integral action: its limits, or those of u, are not proved to leave "
    "room for every disturbance and parameter in their ranges"
)


NO_MOMENTA = (
    "a controller that is fed the plant's own momenta is not proved to make V decrease for every "
    "uncertain parameter: feed it the model's inertia times a measured velocity"
)


SETPOINTS_ARE_NOT_COVERED = (
    "nothing is proved of set-points that move: the plant or its loop is not of the kind that is "
    "covered"
)


NO_SETPOINTS = "no box is proved that holds solutions at every set-point"


NO_LOCAL_INTEGRAL = (
    "nothing is proved of the integral action: the linearisation at rest is not proved to be "
    "Hurwitz for every parameter"
)


NO_INTEGRAL = "no box around the target is proved in which the integral action makes W fall"


#: Of z̄ where the exact verdict at the target, which is no part of the proof, expects no more.
ONLY_STABLE = "z̄ is stable; that motions converge to it is not claimed"


_BOUNDED = (
    "V is radially unbounded and z̄ its only critical point: every solution is bounded, and V never "
    "rises along it"
)


#: What follows for solutions from anywhere.
GLOBAL: dict[Follows, str] = {
    "converges": "z̄ is globally asymptotically stable: every solution converges to it",
    "invariant": f"{_BOUNDED}; z̄ is locally asymptotically stable",
    "stable": f"{_BOUNDED}; z̄ is stable",
}


#: What follows for solutions from a region.
_FOLLOWS: dict[Follows, str] = {
    "converges": "; every solution from Ω converges to z̄",
    "invariant": "; Ω is invariant, and z̄ locally asymptotically stable",
    "stable": "; Ω is invariant, and z̄ stable",
}


#: What a region ends at.
_OBSTACLES: dict[ObstacleKind, str] = {
    "critical_point": "another critical point of V",
    "singularity": "a pole or kink of the model",
    "domain": "a bound that the model names",
    "input_limits": "the input limits",
    "arithmetic": "the arithmetic of the proof, below what was met",
}


#: What may be missing for a global claim.
Missing = Literal[
    "only Φ = H + Hc + C with C = K(c) is covered",
    "energy, structure and Casimirs are not proved to be smooth for all states",
    "J, R or G depend on the state",
    "the inertia is not proved positive definite for every state",
    "V is not proved to be radially unbounded",
    "V is not proved to have no other critical point",
]


#: What may be missing for a claim about all states and all of a family.
NotEverywhere = Literal[
    "a condition of V falling is open for some of it",
    "only Φ = H + Hc + C with C = K(c) is covered",
    "J, R or G depend on the state",
    "energy, structure and Casimirs are not proved to be smooth for all states",
    "the inertia is not proved positive definite for every state",
    "V is not proved to be convex for every parameter, the momenta at rest",
]


#: What may be missing for a claim about the sampled loop.
NotSampled = Literal[
    "V is not proved to decrease around a proved minimum",
    "only Φ = H + Hc + C is covered",
    "only the published loop is covered",
    "only Euler's and Heun's methods are covered",
    "the structure of the controller depends on its states",
    "no region is proved for the sample time asked for",
]


#: What may be missing for a claim about it under rounding, noise and delay.
NotDisturbed = Literal[
    "velocities are measured, and p = M(q)q̇ is not proved",
    "set-points or parameters at run time are not covered",
    "the law that the C code computes is not of the kind that is covered",
    "the law has an operation whose rounding is not known",
    "with a delay of one sample no function is found that falls",
    "near the minimum the disturbances are as large as what they are to leave",
    "no region is proved from which solutions come near the minimum",
]


#: How ξ is advanced, in words.
_ADVANCED: dict[Method, str] = {"euler": "Euler's method", "heun": "Heun's method"}


NO_REGION = "no region without a proof of stability"


NO_NEIGHBOURHOOD = (
    "no region is proved: no neighbourhood of z̄ is proved free of other critical points"
)


#: More states that are not minimised out than a region may keep.
TOO_MANY = f"{NO_NEIGHBOURHOOD}, with at most {MOST_KEPT} states that are not minimised out"


#: Coordinates of a place that are told at most.
_TOLD = 6


def equilibrium(radius: float, mu: float, bound: float) -> str:
    """Of the ball around z*, ∇²V ⪰ μI on it and the distance of z̄, all in natural units."""
    return (
        f"in natural units V has exactly one critical point z̄ within {radius:.17g} of z*, ∇²V ⪰ "
        f"{down(mu, 3)} I there, and ‖z̄ − z*‖ ≤ {up(bound, 3)}"
    )


def casimir(functions: Sequence[str]) -> str:
    """Of closed forms, as design.json writes them."""
    return f"∇Cᵀ(Jcl − Rcl) = 0 holds exactly for C built from {', '.join(functions)}"


def slope(delta: float | None) -> str:
    """Of Φ₁; None for the sum."""
    if delta is None:
        return "Φ = H + Hc + C, so Φ₁ = 1"
    return f"Φ₁ ≥ {down(delta, 6)} everywhere, by construction of the neural Φ"


def integral(
    level: float,
    box: Mapping[str, float],
    limits: Sequence[float],
    ranges: Mapping[str, Sequence[str]],
    disturbance: Sequence[Sequence[str]] = (),
) -> str:
    """Of the level of W, the box of (q, ξ) by half widths, the limits of ζ and what is unknown.

    Without a range of disturbances: of all for which the limits of ζ are enough.
    """
    bounds = ", ".join((_at_most(v) if disturbance else down(v, 6)) for v in limits)
    pushes = ", ".join(f"[{lo}, {hi}]" for lo, hi in disturbance)
    sides = ", ".join(f"{name} ± {down(width, 6)}" for name, width in box.items())
    known = "".join(f", {name} in [{lo}, {hi}]" for name, (lo, hi) in ranges.items())
    enough = f" whose ζ* is within ±({bounds})"
    if pushes:
        known, enough = f" in {pushes}{known}", f", ζ* within ±({bounds})"
    return (
        f"with integral action every solution that starts with W ≤ {down(level, 6)} and {sides} "
        "about its place at rest stays there, and q → q* without offset, for every constant "
        f"disturbance{known}{enough}; what else is claimed of solutions is of the loop with ζ = 0"
    )


def local_integral(
    limits: Sequence[float],
    uncertain: Mapping[str, Sequence[str]],
    disturbance: Sequence[Sequence[str]] = (),
    inputs: Sequence[Sequence[float]] = (),
) -> str:
    """Of the limits of ζ and u and what is unknown; fewer inputs than coordinates.

    Without a range of disturbances: of all for which the limits are enough.
    """
    bounds = ", ".join((_at_most(v) if disturbance else down(v, 6)) for v in limits)
    pushes = ", ".join(f"[{lo}, {hi}]" for lo, hi in disturbance)
    known = "".join(f", {name} in [{lo}, {hi}]" for name, (lo, hi) in uncertain.items())
    kept = f" and u at rest strictly within {ranges(inputs)}" if inputs else ""
    enough = f" with ζ* strictly within ±({bounds}){kept}"
    if pushes:
        known, enough = f" in {pushes}{known}", f", ζ* strictly within ±({bounds}){kept}"
    return (
        "locally, with integral action: the loop rests at q* and is exponentially stable there, so "
        "that q → q* without offset from near enough, for every constant "
        f"disturbance of the inputs{known}{enough}; no region is claimed of it, and what else is "
        "claimed of solutions is of the loop with ζ = 0"
    )


def momenta(ranges: Mapping[str, Sequence[str]]) -> str:
    """Of a controller that is fed the plant's own momenta, and the parameters that vary."""
    known = ", ".join(f"{name} in [{lo}, {hi}]" for name, (lo, hi) in ranges.items())
    return (
        f"with {known} the V made of the plant's own energy decreases, too, where the controller "
        "is fed the plant's momenta, though the law has the inertia of the model"
    )


def setpoints(
    level: float, box: Mapping[str, float], away: float, ranges: Mapping[str, Sequence[str]]
) -> str:
    """Of one level of V and one box (q, ξ) about every set-point; `away` in natural units.

    Ranges are of set-points and of parameters that the controller is told.
    """
    sides = ", ".join(f"{name} ± {down(width, 6)}" for name, width in box.items())
    known = ", ".join(f"{name} in [{lo}, {hi}]" for name, (lo, hi) in ranges.items())
    return (
        f"for every set-point with {known}: every solution that starts with V at most "
        f"{down(level, 6)} above its value at the set-point, and {sides} about it, stays so and "
        f"comes to rest within {up(away, 3)} of it, in natural units"
    )


def attraction(rate: float | None) -> str:
    """Of a proved rate of decay of the linearisation; None where it has none."""
    if rate is None:
        return (
            "z̄ is locally asymptotically stable: no motion near it but rest keeps V constant, "
            "whichever factors of the dissipation vanish along it; no rate is claimed"
        )
    below = f"-{down(rate, 3)}" if rate > 0 else "0"
    return (
        "z̄ is locally asymptotically stable: every eigenvalue of the linearisation has a real "
        f"part below {below}, by a Lyapunov inequality"
    )


def conserved(function: str) -> str:
    """Of a Casimir that damping cannot move."""
    return f"z̄ is stable, but cannot attract: the damped loop conserves {function}"


def no_limits(limits: Sequence[Sequence[float]]) -> str:
    """Where u is not proved to stay within the limits of the model."""
    return f"no neighbourhood of z̄ is proved to keep u within {ranges(limits)}"


def not_global(missing: Missing) -> str:
    """Where the whole space is not proved."""
    return f"no global claim: {missing}"


NO_MEMBERS = "no regions are proved for the members of the family"


def not_everywhere(missing: NotEverywhere) -> str:
    """Where not all states are proved for all of a family."""
    return f"no global claim of the family: {missing}"


#: Of a family of which nothing is proved, by what became of it.
NO_FAMILY: Mapping[str, str] = {
    "refused": "nothing is claimed of the family: what it rests on provably fails for some of it",
    "undecided": "nothing is claimed of the family: an identity that it rests on is undecided",
    "not_covered": "nothing is claimed of the family: the loop is not one that it is proved for",
    "open": "nothing is claimed of the family: its minima are not enclosed, or a condition of "
    "V falling is open, for some of it",
}


def unproved(limits: Sequence[Sequence[float]]) -> Mapping[str, frozenset[str]]:
    """Everything that may be said of a claim that is made beside others, but not held."""
    return {
        "region": frozenset([NO_REGION, NO_NEIGHBOURHOOD, TOO_MANY]),
        "input_limits": frozenset([no_limits(limits)]),
        "clipping": frozenset([no_clipping(limits)]),
        "global": frozenset(map(not_global, get_args(Missing))),
        "measurement": frozenset([NOT_MEASURED]),
        "momenta": frozenset([NO_MOMENTA]),
        "setpoints": frozenset([NO_SETPOINTS, SETPOINTS_ARE_NOT_COVERED]),
        "family": frozenset(NO_FAMILY.values()),
        "members": frozenset([NO_MEMBERS]),
        "everywhere": frozenset(map(not_everywhere, get_args(NotEverywhere))),
        "local_integral": frozenset(
            [INTEGRAL_IS_NOT_COVERED, INTEGRAL_IS_TOO_SMALL, NO_LOCAL_INTEGRAL]
        ),
        "integral": frozenset([INTEGRAL_IS_NOT_COVERED, INTEGRAL_IS_TOO_SMALL, NO_INTEGRAL]),
        "sampled": frozenset(map(sampled_is_not_covered, get_args(NotSampled))),
        "disturbed": frozenset(map(disturbed_is_not_covered, get_args(NotDisturbed))),
    }


def region(height: float, obstacle: Obstacle, follows: Follows) -> str:
    """Of the component of {V ≤ V(z̄) + h}, and what follows for solutions from it."""
    return (
        f"the component Ω of {{V − V(z̄) ≤ {down(height, 6)}}} around z̄ is compact, and z̄ the only "
        f"critical point of V in it; limited by {limited_by(obstacle)}{_FOLLOWS[follows]}"
    )


def limited_by(obstacle: Obstacle) -> str:
    """What a region stays just below."""
    many = len(obstacle.at) > _TOLD
    told = {name: value for name, value in obstacle.at.items() if value or not many}
    parts = [f"{name} = {value:.4g}" for name, value in list(told.items())[:_TOLD]]
    place = f" at {', '.join(parts)}{', …' if len(told) > _TOLD else ''}" if parts else ""
    return (
        f"{_OBSTACLES[obstacle.kind]}{place}, {obstacle.level_above_minimum:.4g} above the minimum"
    )


def input_limits(limits: Sequence[Sequence[float]], height: float, whole: bool) -> str:
    """Of the height above V(z̄) up to which u stays within its limits, on the whole Ω or not."""
    where = "all of Ω" if whole else f"{{V − V(z̄) ≤ {down(height, 6)}}} in Ω"
    return (
        f"u stays within {ranges(limits)} on {where}, which is invariant: saturation never acts "
        "there"
    )


#: How the controller keeps the limits of u, by whether it scales damping.
_LIMITED = {
    False: "every input clipped to {limits}",
    True: "u kept within {limits} by scaling all of its damping injection alike, as the code does,",
}


#: What is not said of the loop with limits, which other claims are about.
_NOT_MEANT = (
    "rates of decay, sampled loops, other set-points and plants, and integral action are not meant"
)


def clipping(limits: Sequence[Sequence[float]], height: float, whole: bool, scaled: bool) -> str:
    """Of the height above V(z̄) up to which limited inputs change nothing of what is said."""
    where = "Ω" if whole else f"{{V − V(z̄) ≤ {down(height, 6)}}} in Ω"
    return (
        f"with the damping of this design and {_LIMITED[scaled].format(limits=ranges(limits))} all "
        f"that is said of solutions holds on {where}: without damping u stays strictly within them "
        f"there; {_NOT_MEANT}"
    )


def clipped_everywhere(scaled: bool) -> str:
    """Where u is a constant beside its damping."""
    how = "its damping injection scaled to keep them" if scaled else "u clipped to its limits"
    why = "" if scaled else ", and D is diagonal"
    return (
        f"u without its damping is a constant strictly within the limits{why}: what is said of "
        f"solutions holds from the same states with {how}; {_NOT_MEANT}"
    )


def no_clipping(limits: Sequence[Sequence[float]]) -> str:
    """Where u without damping is not proved to stay within the limits of the model."""
    return f"no neighbourhood of z̄ is proved to keep u without its damping within {ranges(limits)}"


def sampled(
    region: SampledRegion,
    states: Sequence[str],
    units: Units,
    limits: Sequence[Sequence[float]],
    scaled: bool,
) -> str:
    """Of the sampled loop from {W < w₀}, for all periods up to the longest.

    `scaled`: limits scale damping, and do not clip.
    """
    period = down(region.period * units.time, 6)
    box = ", ".join(
        f"{name} in [{up(lo * unit, 6)}, {down(hi * unit, 6)}]"
        for name, (lo, hi), unit in list(zip(states, region.box, units.state, strict=True))[:_TOLD]
    )
    inputs = f"u stays within {ranges(limits)} there" if limits else "u is not clipped"
    if region.clipped:
        how = "kept within" if scaled else "clipped to"
        inputs = f"u is {how} {ranges(limits)}, as the code does"
        inputs += ", by scaling its damping injection" if scaled else ""
    limited = ", u so kept," if scaled else ", u clipped too,"
    too = limited if region.clipped else ""
    more = ", …" if len(states) > _TOLD else ""
    return (
        f"for every sequence of sampling periods in (0, {period}] s whose sum is infinite, every "
        "solution of the sampled loop that starts in Ω_T, the part of {W − V(z̄) < "
        f"{down(region.height * units.energy, 6)}}} in the box {box}{more}, is in it at every "
        "sample and converges to z̄, and between samples x stays where x of Ω_T is. W is V + "
        "½∇VᵀQ∇V with the Q of certificate.json; exact arithmetic, x measured without error, no "
        f"delay; at each sample {_ADVANCED[region.integrator]} advances ξ over the time since the "
        f"last one, with the x of that one, then u is computed and held; {inputs}. In continuous "
        f"time{too} every solution from Ω_T converges to z̄ as well, exponentially"
    )


def disturbed(
    found: DisturbedRegion, states: Sequence[str], inputs: Sequence[str], units: Units,
    input_units: Sequence[float], velocities: bool,
) -> str:  # fmt: skip
    """Of where the sampled loop comes to and stays, under what is assumed of its disturbances.

    `velocities`: measured are (q, q̇), not the states (q, p).
    """
    periods = f"[{up(found.shortest * units.time, 6)}, {down(found.period * units.time, 6)}] s"
    n, k = len(found.noise), len(found.noise) // 2
    names = (*states[:k], *velocity_names(states[:k])) if velocities else states[:n]
    noise = _within(names, found.noise, units.measured(n, velocities))
    exactly = ", ".join(names) if velocities else "x"
    measured = (
        f"measured {noise}, then rounded"
        if noise
        else f"{exactly} measured without error but rounded"
    )
    momenta = f", states of the model: {', '.join(states[k:n])} = M(q)q̇ of the plant, without noise"
    momenta = momenta if velocities else ""
    applied = _within(inputs, found.input_error, input_units)
    applied = f"{applied} as it is applied" if applied else "u applied as it is computed"
    start = f"{{W − V(z̄) < {down(found.height * units.energy, 6)}}}"
    limit = up(found.above * units.energy, 3)
    late = ""
    if found.delay is not None:
        start = start.replace("W", "S", 1)
        late = (
            ", one sample after it was computed, where S = W + "
            f"{up(found.delay * found.period, 3)}|e|² in natural units, e what is applied over "
            "the first sample less the u of the law"
        )
    pairs = zip(states, found.radius, units.state, strict=False)
    radii = ", ".join(f"{name} ± {up(r * unit, 3)}" for name, r, unit in pairs)
    return (
        f"for every sequence of sampling periods in {periods}, in the C code's arithmetic in "
        f"{found.precision}, {measured}, {applied}{late}: every solution from {start} in Ω_T of "
        "the sampled loop is in Ω_T at every sample, after finitely many comes into {W − V(z̄) < "
        f"{limit}}} and stays there, within {radii} of z̄{momenta}. Assumed: IEEE arithmetic, "
        "rounded to nearest, without overflow; dt is the period rounded to its type; functions of "
        f"the C library err by at most {LIBRARY:g} units in the last place, the code's own "
        "activations by no more than was measured of them (docs/certificate-format.md)"
    )


def disturbed_is_not_covered(missing: NotDisturbed) -> str:
    """Where nothing is proved of the sampled loop under disturbances."""
    return f"nothing is claimed of rounding, noise and delay: {missing}"


def _within(names: Sequence[str], sizes: Sequence[float], units: Sequence[float]) -> str:
    """Errors other than 0, by name."""
    return ", ".join(
        f"{name} within ±{down(size * unit, 6)}"
        for name, size, unit in zip(names, sizes, units, strict=False)
        if size > 0
    )


def sampled_is_not_covered(missing: NotSampled) -> str:
    """Where nothing is proved of the sampled loop."""
    return f"nothing is claimed of the sampled loop: {missing}"


def ranges(limits: Sequence[Sequence[float]]) -> str:
    """The limits of the inputs."""
    return ", ".join(f"[{float(lo):.12g}, {float(hi):.12g}]" for lo, hi in limits)


def down(value: float, digits: int) -> str:
    """A number in words that is at most as large."""
    return _shown(value, digits, ROUND_FLOOR)


def up(value: float, digits: int) -> str:
    """A number in words that is at least as large."""
    return _shown(value, digits, ROUND_CEILING)


def _at_most(value: float) -> str:
    """A bound as it is where six digits are enough for the double, else rounded up."""
    text = f"{value:.6g}"
    return text if float(text) == value else up(value, 6)


def _shown(value: float, digits: int, rounding: str) -> str:
    """A number rounded to one side, to significant digits."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    exact = Decimal(value)
    last = Decimal(1).scaleb(exact.adjusted() - digits + 1)
    return f"{float(exact.quantize(last, rounding=rounding)):.{max(digits, 6)}g}"
