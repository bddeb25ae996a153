"""What a run found, as the JSON of docs/contract.md#json."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.files import finite
from necc_casadi.methods.method import Method
from necc_casadi.model.family_loop import Kind
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.report.asked import asked_text
from necc_casadi.report.findings import Findings, held_claim
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.floats import to_float, to_floats
from necc_casadi.verdict.verdict import Verdict

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.choice.choose import Choice
    from necc_casadi.choice.judged import Judged
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.measures import Measures
    from necc_casadi.designs.outcome import Start
    from necc_casadi.performance.measure import Performance, Rating
    from necc_casadi.simulation.responses import Trajectory
    from necc_casadi.synthesis.asked import Asked

__all__ = ["to_json"]


def to_json(found: Findings) -> dict[str, Any]:
    """The object of docs/contract.md#json; blocks that were not made are None."""
    system, published, method = found.system, found.found.published, found.method
    held = method or published
    data: dict[str, Any] = {
        "status": found.status,
        "plant": {"states": list(system.states), "inputs": system.m},
        "controller": None if held is None else {"states": list(held.loop.controller.states)},
        "target": {str(s): to_float(found.x_star[s]) for s in system.x},
        "verdict": None if published is None else _verdict(published.verdict, published.casimirs),
        "method": None if method is None else _method(method, found),
        "methods_refused": [vars(refusal) for refusal in found.found.refusals] or None,
        "design": None
        if found.design is None or found.measures is None
        else _design(found.design, found.measures, found.certificate),
        "certificate": None
        if found.certificate is None
        else _certificate(found.certificate, found),
        "choice": None if found.choice is None else _choice(found.choice),
        "arrivals": None if found.choice is None else _arrivals(found.choice),
        "faults": found.faults,
        "warnings": found.warnings,
        "sizes": None if found.design is None else found.design.named_sizes,
        "responses": [_response(r) for r in found.responses] or None,
        "sampling": None
        if found.sampling is None or found.design is None
        else {
            **vars(found.sampling),
            "proved": _sampled_region(found.design, found.certificate),
            "disturbed": _disturbed_region(found.design, found.certificate),
        },
        "asked": None if found.asked is None else _asked(found.asked),
        "performance": None
        if found.performance is None
        else _performance(found.performance, list(system.states)),
        "family": _family(found),
        "sweep": [vars(p) for p in found.sweep] or None,
        "notes": found.notes,
        "files": found.files,
        "timings": dict(found.timings),
    }
    result: dict[str, Any] = finite(data)
    return result


def _design(design: Design, measures: Measures, certificate: Certificate | None) -> dict[str, Any]:
    curvatures, spectrum = measures.curvatures.tolist(), measures.spectrum.tolist()
    return {
        "measured": list(design.measurement.names),
        "xi_star": design.xi_star.tolist(),
        "initial_xi": design.initial_xi,
        "initial_gain": None if design.initial_gain is None else design.initial_gain.tolist(),
        "a": design.a,
        "a_requested": design.a_requested,
        "loss": measures.loss,
        "gradient_norm": measures.gradient_norm,
        "hessian_min_eig": curvatures[0],
        "hessian_eigenvalues": curvatures,
        "z_bar": design.z_bar.tolist(),
        "distance": measures.distance,
        "bound_paper": measures.bound_paper,
        "bound_rigorous": None if certificate is None else certificate.bound_rigorous,
        "spectral_abscissa": design.abscissa,
        "spectrum": [[value.real, value.imag] for value in spectrum],
        "stability": None if certificate is None else certificate.stability,
        "casimir_residual": None
        if design.learned is None
        else {"mean": design.learned.mean, "worst": design.learned.worst},
        "D": design.D.tolist(),
        "Dc": design.Dc.tolist(),
        "damping": design.damping.tolist(),
        "integral": _integral(design, certificate),
        "seed": design.seed,
        "starts": [_start(start) for start in design.starts],
    }


def _family(found: Findings) -> dict[str, Any] | None:
    """The family that the design is one of, and how far from the set-point its members rest."""
    family = found.family
    if family is None:
        return None
    from necc_casadi.certificate.claims.family import off_target, proved_share

    claim, everywhere, regions = (
        held_claim(found.certificate, name) for name in ("family", "everywhere", "members")
    )
    data = None if claim is None else claim.data

    def ranges(kind: Kind) -> dict[str, list[float]]:
        return {p.name: [to_float(v) for v in p.range] for p in family.moved.of(kind)}

    return {
        "setpoints": ranges("setpoint"),
        "uncertain": ranges("uncertain"),
        "disturbance": list(ranges("disturbance").values()),
        "exact_equilibrium": None
        if data is None
        else not off_target(data["error"], family.state_units),
        "error": None if data is None else {k: list(v) for k, v in data["error"].items()},
        "boxes": None if data is None else len(data["boxes"]),
        "proved_share": 0.0 if data is None else proved_share(data),
        "left": None if data is None else [[list(v) for v in box] for box in data["left"]],
        "common_share": None if regions is None else regions.data["share"],
        "step": None if regions is None else dict(regions.data["step"]),
        "global": None if everywhere is None else everywhere.data["follows"],
    }


def _integral(design: Design, certificate: Certificate | None) -> dict[str, Any] | None:
    """Integral action, and what is proved of it in the units of the model."""
    integral = design.integral
    if integral is None:
        return None
    claims = () if certificate is None else certificate.claims
    claim = next((c for c in claims if c.name == "integral" and c.holds), None)
    near = any(c.name == "local_integral" and c.holds for c in claims)
    found: dict[str, Any] = {"level": None, "box": None, "local": near}
    if claim is not None:
        n, k, units = design.loop.plant.n, design.loop.plant.n // 2, design.units
        kept = [*range(k), *range(n, design.loop.n)]
        widths = zip(kept, claim.data["half_widths"], strict=True)
        found["level"] = claim.data["level"] * units.energy
        found["box"] = {design.loop.states[i]: w * float(units.state[i]) for i, w in widths}
    return {
        "tau": integral.tau,
        "gain": integral.gain.tolist(),
        "limit": integral.limit.tolist(),
        **found,
    }


def _sampled_region(made: Design, certificate: Certificate | None) -> dict[str, Any] | None:
    """From where the sampled loop is proved to converge, in the units of the model."""
    region = None if certificate is None else certificate.sampled
    if certificate is None or region is None:
        return None
    units = certificate.units
    pairs = zip(region.metric, units.state, strict=True)
    sides = zip(made.loop.states, region.box, units.state, strict=True)
    return {
        "longest_period": region.period * units.time,
        "level_above_minimum": region.height * units.energy,
        "metric": [
            [q * a * b / units.energy for q, b in zip(row, units.state, strict=True)]
            for row, a in pairs
        ],
        "box": {name: [lo * unit, hi * unit] for name, (lo, hi), unit in sides},
        "clipped": region.clipped,
    }


def _disturbed_region(made: Design, certificate: Certificate | None) -> dict[str, Any] | None:
    """Where the sampled loop stays under rounding, noise and delay, in the units of the model."""
    found = None if certificate is None else certificate.disturbed
    if certificate is None or found is None:
        return None
    units, plant, measured = certificate.units, made.loop.plant, made.measurement
    sizes_of_noise = units.measured(plant.n, measured.of_velocities)

    def by_name(names: Sequence[object], sizes: Sequence[float], scale: Iterable[float]) -> Any:
        triples = zip(names, sizes, scale, strict=False)
        return {str(name): size * float(unit) for name, size, unit in triples}

    return {
        "periods": [found.shortest * units.time, found.period * units.time],
        "real": found.precision,
        "noise": by_name(measured.names, found.noise, sizes_of_noise),
        "input_error": by_name(plant.input_names, found.input_error, made.units.input),
        "delayed": found.delay is not None,
        "level_above_minimum": found.height * units.energy,
        "limit_above_minimum": found.above * units.energy,
        "radius": by_name(made.loop.states, found.radius, units.state),
    }


def _asked(asked: Asked) -> dict[str, Any]:
    return {
        "rate": asked.rate,
        "rate_reached": asked.rate_reached,
        "limits": None if asked.limits is None else asked.limits.tolist(),
        "peaks": None if asked.peaks is None else asked.peaks.tolist(),
        "met": asked.met,
        "stopped_by": asked.stopped_by,
        "explanation": asked_text(asked),
    }


def _performance(found: Performance, states: list[str]) -> dict[str, Any]:
    others = {"lqr": found.lqr, "optimum": found.optimum}
    return {
        **_rating(found.design),
        "cost_to_lqr": found.cost_to_lqr,
        "starts": found.starts,
        "beside": {name: None if r is None else _rating(r) for name, r in others.items()},
        "errors": {
            "disturbance": _at_rest(found.errors.disturbance, states),
            "parameters": {k: _at_rest(v, states) for k, v in found.errors.parameters.items()},
        },
    }


def _at_rest(error: Vector | None, states: Sequence[str]) -> dict[str, float] | None:
    """An error by state."""
    return None if error is None else dict(zip(states, error.tolist(), strict=True))


def _rating(rating: Rating) -> dict[str, Any]:
    def listed(values: Vector | None) -> list[float] | None:
        return None if values is None else [float(v) for v in values]

    return {
        "settling_time": rating.settling_time,
        "overshoot": rating.overshoot,
        "peak_u": listed(rating.peak_u),
        "peak_demand": listed(rating.peak_demand),
        "converging_share": rating.converging_share,
        "cost_to_optimum": rating.cost_to_optimum,
        "worst_to_optimum": rating.worst_to_optimum,
        "margins": None if rating.margins is None else vars(rating.margins),
    }


def _start(start: Start) -> dict[str, Any]:
    return {
        "seed": start.seed,
        "form": start.mode,
        "status": start.status,
        "iterations": start.iterations,
        "seconds": start.seconds,
        "loss": start.loss,
    }


def _verdict(verdict: Verdict, casimirs: Casimirs) -> dict[str, Any]:
    return {
        "assignable": verdict.assignable,
        "reason": verdict.reason,
        "explanation": verdict.explanation,
        "stability": verdict.stability,
        "witness": verdict.witness,
        "a_max": verdict.a_max,
        "casimirs": [to_text(c) for c in casimirs.functions],
        "casimir_count": len(casimirs.functions),
        "casimir_count_generic": None if casimirs.undecided else casimirs.generic_count,
        "kernel_rank": None if casimirs.undecided else casimirs.kernel_rank,
        "lambda": None if verdict.lam is None else to_floats(verdict.lam).tolist(),
        "invisible": [to_floats(row).tolist() for row in verdict.invisible.tolist()],
    }


def _method(method: Method, found: Findings) -> dict[str, Any]:
    """How the target is held, with formulas as text."""
    loop = method.loop
    ahead, shaped = loop.plant.preliminary, isinstance(loop, ShapedLoop)
    return {
        "name": method.name,
        "instead_of": [vars(other) for other in found.found.passed],
        "parameter_errors": {
            name: _at_rest(error, found.system.states)
            for name, error in found.parameter_errors.items()
        },
        "shaping": [to_text(g) for g in loop.gamma] if shaped else None,
        "alpha": matrix_text(loop.feedback) if shaped else None,
        "structure": None
        if ahead is None
        else {
            "J": matrix_text(loop.plant.J),
            "R": matrix_text(loop.plant.R),
            "H": to_text(loop.plant.H),
        },
        "input": None
        if ahead is None
        else {"u0": matrix_text(ahead.u0), "gain": matrix_text(ahead.gain)},
        "verdict": _verdict(method.verdict, method.casimirs),
    }


def matrix_text(matrix: sp.MatrixBase) -> list[list[str]]:
    """Formulas, row by row."""
    return [[to_text(entry) for entry in row] for row in matrix.tolist()]


def _certificate(certificate: Certificate, found: Findings) -> dict[str, Any]:
    obstacle, reach = certificate.obstacle, certificate.reach
    return {
        "claims": [
            {"name": c.name, "holds": c.holds, "statement": c.statement} for c in certificate.claims
        ],
        "level": certificate.level,
        "level_above_minimum": certificate.level_above_minimum,
        "level_u": certificate.level_u,
        "level_clipped": certificate.level_clipped,
        "limited_by": certificate.limited_by,
        "obstacle": None
        if obstacle is None
        else {
            "kind": obstacle.kind,
            "at": dict(obstacle.at),
            "level_above_minimum": obstacle.level_above_minimum,
        },
        "reach": None if reach is None else {k: v and list(v) for k, v in reach.items()},
        "domain_share": found.domain_share,
        "simulated_share": found.simulated_share,
        "global": certificate.is_global,
    }


def _choice(choice: Choice) -> dict[str, Any]:
    return {
        "kept": choice.kept.name,
        "reason": choice.reason,
        "made": [_judged(judged) for judged in (choice.kept, *choice.others)],
        "instead_of": [{"name": p.name, "because": p.because} for p in choice.passed],
    }


def _judged(judged: Judged) -> dict[str, Any]:
    return {
        "name": judged.name,
        "certified": judged.proved,
        "global": judged.whole,
        "plant_share": judged.plant_share,
        "unclipped_share": judged.unclipped_share,
        "arrived": judged.arrivals,
        "cost_to_lqr": judged.cost_to_lqr,
        "peak_u": judged.response.peak_u.max(axis=0).tolist(),
    }


def _arrivals(choice: Choice) -> dict[str, Any]:
    response, lower = choice.kept.response, choice.lower
    return {
        "starts": len(response.arrived),
        "arrived": choice.kept.arrivals,
        "elsewhere": [{"at": dict(e.at), "starts": len(e.starts)} for e in response.elsewhere],
        "lost": int(response.lost.sum()),
        "peak_u": response.peak_u.max(axis=0).tolist(),
        "beyond_limits": response.beyond,
        "lower_minimum": None if lower is None else {"at": dict(lower.at), "below": lower.below},
    }


def _response(response: Trajectory) -> dict[str, Any]:
    return {
        "z0": response.z[0].tolist(),
        "settling_time": response.settling_time,
        "peak_input": response.peak_input,
        "saturated": response.saturated,
    }
