"""A design and its responses, as rows of a page of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from necc_casadi.report.findings import Findings
from necc_casadi.report.values import MANY, tied

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.choice.judged import Judged
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.measures import Measures
    from necc_casadi.designs.outcome import Residual
    from necc_casadi.export.sampled_loop import SampledLoop

__all__ = [
    "design_rows",
    "learned_text",
    "responses_text",
    "sampled_text",
    "sizes_text",
    "starts_text",
]


#: Where ξ starts, in words.
_BEGINS = {
    "target": "ξ*",
    "linear": "ξ* + T(x(0) − x*)",
    "minimum": "the minimum of V(x(0), ·)",
}


#: Coordinates of z̄ smaller than this share of their size are shown as 0.
_NOTHING = 1e-20


def sizes_text(design: Design) -> str:
    """What a large value of each state and input is taken to be."""
    units = design.loop.plant.units
    parts = [
        tied(f"{name} {size:.2g} {units.get(name, '')}".rstrip())
        for name, size in design.named_sizes.items()
    ]
    shown = parts if len(parts) <= MANY else [*parts[: MANY // 2], "…", parts[-1]]
    return ", ".join(shown)


def design_rows(
    design: Design, measures: Measures, certificate: Certificate | None
) -> list[tuple[str, str]]:
    """What was designed, its minimum and its loop."""
    names = design.loop.controller.states
    xi = ", ".join(f"{n}* = {v:.6g}" for n, v in zip(names, design.xi_star, strict=True))
    best = min(design.starts, key=lambda s: s.loss)
    starts = f" in the best of {len(design.starts)} starts" if len(design.starts) > 1 else ""
    paper = measures.bound_paper
    rigorous = None if certificate is None else certificate.bound_rigorous
    bounds = (
        f"ε/(a − ε) = {paper:.2g}" if paper is not None else "ε/(a − ε) is no bound (ε ≥ a)"
    ) + (f", proved ≤ {rigorous:.2g}" if rigorous is not None else ", no proved bound")
    shown = zip(design.z_bar[:MANY], _NOTHING * design.sizes.state, strict=False)
    z_bar = ", ".join(f"{v:.6g}" if abs(v) > nothing else "0" for v, nothing in shown)
    z_bar += ", …" if len(design.z_bar) > MANY else ""
    begins = _BEGINS[design.initial_xi]
    return [
        (
            "design",
            f"{xi}; ξ(0) = {begins}; loss ε = {measures.loss:.2g} at a = {design.a:.4g}; IPOPT: "
            f"{best.explained.meaning}, {best.iterations} iterations{starts}",
        ),
        ("minimum", f"z̄ = ({z_bar}); ‖z̄ − z*‖ = {measures.distance:.2g}; {bounds}"),
        (
            "loop",
            f"{_damping(design)}; spectral abscissa {design.abscissa:.4g} 1/s; least eigenvalue of "
            f"∇²V(z̄) {measures.curvatures[0]:.4g}",
        ),
    ]


def sampled_text(design: Design, sampling: SampledLoop, certificate: Certificate | None) -> str:
    """The sampled loop: what is proved, and what is linearised."""
    limit = (
        "no largest stable sample time was found"
        if sampling.largest_stable is None
        else f"stable up to {sampling.largest_stable:.3g} s"
    )
    local = (
        f"at {sampling.sample_time:g} s the sampled loop has spectral radius "
        f"{sampling.spectral_radius:.4f} at z̄; {limit} (linearised, near z̄ only)"
    )
    region = None if certificate is None else certificate.sampled
    if certificate is None or region is None:
        return f"{local}; from no region it is proved to converge"
    units = certificate.units
    from necc_casadi.certificate.claims.statements import down

    longest = down(region.period * units.time, 4)
    limited = ", with u kept within its limits" if region.clipped else ""
    return (
        f"proved to converge from a region for all periods up to {longest} s{limited}"
        f"{_disturbed(design, certificate)}; {local}"
    )


def _disturbed(design: Design, certificate: Certificate) -> str:
    """How near it stays under what it was asked to bear."""
    from necc_casadi.certificate.claims.statements import down, up

    found, units = certificate.disturbed, certificate.units
    if found is None:
        return ""
    borne = [f"rounding in {found.precision}"]
    borne += ["noise"] if any(found.noise) else []
    borne += ["errors of u"] if any(found.input_error) else []
    borne += ["a delay of one sample"] if found.delay is not None else []
    names, states = design.loop.states, design.loop.plant.units
    radii = ", ".join(
        tied(f"{name} ± {up(radius * unit, 2)} {states.get(name, '')}".rstrip())
        for name, radius, unit in zip(names, found.radius, units.state, strict=True)
    )
    shortest, longest = up(found.shortest * units.time, 4), down(found.period * units.time, 4)
    return (
        f", and with {', '.join(borne)} and periods from {shortest} to {longest} s to come within "
        f"{radii} of z̄ and stay there"
    )


def learned_text(residual: Residual) -> str:
    """How nearly a learned Casimir is one."""
    return (
        "the Casimir is a network and holds only approximately: on "
        f"{residual.points} points that it was not trained on, ‖∇Cᵀ(Jcl − Rcl)‖ relative to "
        f"‖∇C‖‖Jcl − Rcl‖ is {residual.mean:.2g} on average, {residual.worst:.2g} at worst; "
        "no decrease of V follows, so nothing is certified"
    )


def _damping(design: Design) -> str:
    m = len(design.D)
    if design.damping[:m, m:].any() or design.damping[m:, :m].any():
        return f"damping {_matrix(design.damping)}"
    return f"D = {_matrix(design.D)}, Dc = {_matrix(design.Dc)}"


def _matrix(D: np.ndarray) -> str:
    diagonal = np.diag(np.diag(D))
    if np.array_equal(D, diagonal):
        values = [f"{v:.4g}" for v in np.diag(D)]
        return values[0] if len(values) == 1 else f"diag({', '.join(values)})"
    rows = (", ".join(f"{v:.4g}" for v in row) for row in D)
    return f"[{'; '.join(rows)}]"


def responses_text(found: Findings) -> str:
    """What the simulated starts did."""
    settled = [r for r in found.responses if r.converged]
    text = f"{len(settled)} of {len(found.responses)} random starts settle within 2 %"
    certificate = found.certificate
    if certificate is not None and certificate.attracts_at_no_rate:
        text += f" in {found.responses[0].t[-1]:.3g} s"
    if settled:
        slowest = max(r.settling_time for r in settled)
        text += f", the slowest in {slowest:.3g} s"
    peak = max(r.peak_input for r in found.responses)
    limited = sum(r.saturated for r in found.responses)
    text += f"; peak |u| {peak:.3g}" + (f", at a limit in {limited}" if limited else "")
    return f"{text} (simulated)"


def starts_text(kept: Judged) -> str:
    """What becomes of starts that fill the domain, with inputs that are clipped to their limits."""
    response = kept.response
    text = f"{kept.arrivals} of {len(response.arrived)} that fill the domain arrive"
    if kept.certificate.stability != "asymptotic":
        return f"{len(response.arrived)} that fill the domain: none need arrive"
    limited = kept.design.loop.plant.u_limits is not None
    clipped = ", inputs within their limits" if limited else ""
    dear = "" if kept.cost_to_lqr is None else f"; cost {kept.cost_to_lqr:.3g} × LQR"
    unknown = len(response.arrived) - kept.arrivals - len(response.strayed)
    way = (
        f", {unknown} {'was' if unknown == 1 else 'were'} not followed to an end" if unknown else ""
    )
    return f"{text}{clipped}{way}{dear} (simulated)"
