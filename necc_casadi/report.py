"""What a run found, as the JSON of the contract and as a page of plain text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.artifact import Design
from necc_casadi.assignability import Verdict
from necc_casadi.casimirs import Casimirs
from necc_casadi.certificate import Certificate
from necc_casadi.export import Sampling
from necc_casadi.expressions import to_text
from necc_casadi.figures import SweepPoint
from necc_casadi.learned import Residual
from necc_casadi.loop import ClosedLoop
from necc_casadi.simulation import Trajectory

__all__ = ["Findings", "design_block", "summary", "to_json"]

#: A design whose ε is above this fell short, whatever else is proved.
ACCEPTED_LOSS = 1e-6
#: Claims that no exit code rests on.
_OPTIONAL_CLAIMS = ("global", "input_limits")
#: Lists of more states than this are shortened in the text, never in the JSON.
_MANY = 12


@dataclass
class Findings:
    """Everything one run has found so far; what was not reached is None."""

    loop: ClosedLoop
    x_star: Mapping[sp.Symbol, sp.Expr]
    casimirs: Casimirs | None = None
    verdict: Verdict | None = None
    design: Design | None = None
    certificate: Certificate | None = None
    responses: Sequence[Trajectory] = ()
    simulated_share: float | None = None  # of the domain, momenta at rest
    sampling: Sampling | None = None
    sweep: Sequence[SweepPoint] = ()
    notes: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def status(self) -> str:
        """The contract's word for the outcome."""
        if self.verdict is not None and self.verdict.assignable is False:
            return "refused"
        if self.design is None:
            known = self.verdict is not None and self.verdict.assignable
            return "assignable" if known else "undecided"
        certified = self.certificate is not None and self.certificate.certified
        return "certified" if certified and loss(self.design) <= ACCEPTED_LOSS else "fell_short"

    @property
    def exit_code(self) -> int:
        """The contract's exit code for the outcome."""
        return {"certified": 0, "assignable": 0, "refused": 3}.get(self.status, 4)


def loss(design: Design) -> float:
    """ε of eq. Loss, recomputed from the stored weights."""
    g, hessian = _local(design)
    return float(np.linalg.norm(g) + max(0.0, design.a - np.linalg.eigvalsh(hessian)[0]))


def _local(design: Design) -> tuple[np.ndarray, np.ndarray]:
    V, z = design.lyapunov, design.z_star
    return np.asarray(V.gradient(z), float).ravel(), np.asarray(V.hessian(z), float)


def design_block(design: Design, certificate: Certificate | None) -> dict[str, Any]:
    """The ``design`` block of the JSON."""
    g, _ = _local(design)
    at_bar = np.asarray(design.lyapunov.hessian(design.z_bar), float)
    epsilon = loss(design)
    spectrum = np.linalg.eigvals(design.lyapunov.linearisation(design.z_bar))
    return {
        "xi_star": design.xi_star.tolist(),
        "a": design.a,
        "a_requested": design.a_requested,
        "loss": epsilon,
        "gradient_norm": float(np.linalg.norm(g)),
        "hessian_min_eig": float(np.linalg.eigvalsh(at_bar)[0]),
        "hessian_eigenvalues": np.linalg.eigvalsh(at_bar).tolist(),
        "z_bar": design.z_bar.tolist(),
        "distance": float(np.linalg.norm(design.z_bar - design.z_star)),
        "bound_paper": epsilon / (design.a - epsilon) if design.a > epsilon else None,
        "bound_rigorous": None if certificate is None else certificate.bound_rigorous,
        "spectral_abscissa": float(spectrum.real.max()),
        "spectrum": [
            [float(v.real), float(v.imag)] for v in sorted(spectrum, key=lambda v: -v.real)
        ],
        "stability": None if certificate is None else certificate.stability,
        "casimir_residual": None
        if design.learned is None
        else {"mean": design.learned.mean, "worst": design.learned.worst},
        "D": design.D.tolist(),
        "Dc": design.Dc.tolist(),
        "seed": design.seed,
        "starts": [
            {
                "seed": s.seed,
                "form": s.mode,
                "status": s.status,
                "iterations": s.iterations,
                "seconds": s.seconds,
                "loss": s.loss,
            }
            for s in design.starts
        ],
    }


def to_json(found: Findings) -> dict[str, Any]:
    """The JSON object of the contract; blocks that were not made are None."""
    loop, casimirs, verdict = found.loop, found.casimirs, found.verdict
    data: dict[str, Any] = {
        "status": found.status,
        "plant": {"states": list(loop.plant.states), "inputs": loop.plant.m},
        "controller": {"states": list(loop.controller.states)},
        "target": {str(s): float(sp.N(found.x_star[s])) for s in loop.plant.x},
        "verdict": None if verdict is None or casimirs is None else _verdict(verdict, casimirs),
        "design": None if found.design is None else design_block(found.design, found.certificate),
        "certificate": None
        if found.certificate is None
        else _certificate(found.certificate, found.simulated_share),
        "responses": [_response(r) for r in found.responses] or None,
        "sampling": None if found.sampling is None else vars(found.sampling),
        "sweep": [vars(p) for p in found.sweep] or None,
        "notes": found.notes,
        "files": found.files,
        "timings": found.timings,
    }
    result: dict[str, Any] = _finite(data)
    return result


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
        "casimir_count_generic": casimirs.generic_count,
        "kernel_rank": casimirs.kernel_rank,
        "lambda": None if verdict.lam is None else [float(sp.N(v)) for v in verdict.lam],
        "invisible": [[float(sp.N(v)) for v in row] for row in verdict.invisible.tolist()],
    }


def _certificate(certificate: Certificate, simulated_share: float | None) -> dict[str, Any]:
    return {
        "claims": [
            {"name": c.name, "holds": c.holds, "statement": c.statement} for c in certificate.claims
        ],
        "level": certificate.level,
        "level_u": certificate.level_u,
        "limited_by": certificate.limited_by,
        "domain_share": certificate.domain_share,
        "simulated_share": simulated_share,
        "global": certificate.is_global,
    }


def _response(response: Trajectory) -> dict[str, Any]:
    return {
        "z0": response.z[0].tolist(),
        "settling_time": response.settling_time,
        "peak_input": response.peak_input,
    }


def _finite(value: Any) -> Any:
    """Non-finite numbers become None, numpy scalars plain."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value


# --- plain text -----------------------------------------------------------------------------


def summary(found: Findings) -> str:
    """A page that says what was found, proved and written."""
    loop, verdict, casimirs = found.loop, found.verdict, found.casimirs
    lines = [f"{loop.plant.name}: {_outcome(found)}", ""]
    rows = [("target", _target(found))]
    if casimirs is not None:
        rows.append(("Casimirs", _casimirs(casimirs)))
    if verdict is not None:
        rows.append(("verdict", _verdict_text(verdict)))
    if found.design is not None:
        rows += _design_rows(found.design, found.certificate)
    if found.design is not None and found.design.learned is not None:
        rows.append(("learned", _learned(found.design.learned)))
    if found.responses:
        rows.append(("responses", _responses(found)))
    if found.sampling is not None:
        rows.append(("sampled", _sampled(found.sampling)))
    if found.certificate is not None:
        for claim in found.certificate.claims:
            missing = "open" if claim.name in _OPTIONAL_CLAIMS else "NOT proved"
            mark = "proved" if claim.holds else missing
            rows.append((mark, f"{claim.name}: {claim.statement}"))
    rows += [("note", note) for note in found.notes]
    if found.files:
        rows.append(("written", ", ".join(found.files)))
    if found.timings:
        rows.append(("seconds", ", ".join(f"{k} {v:.2g}" for k, v in found.timings.items())))
    return "\n".join(lines + [_wrapped(label, text) for label, text in rows])


def _wrapped(label: str, text: str, width: int = 98, indent: int = 14) -> str:
    import textwrap

    return textwrap.fill(
        text,
        width=width,
        initial_indent=f"  {label:<{indent - 2}}",
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _outcome(found: Findings) -> str:
    certificate = found.certificate
    if found.status == "certified" and certificate is not None:
        kind = "asymptotically stable" if certificate.stability == "asymptotic" else "only stable"
        return f"certified, {kind}"
    return {
        "assignable": "the target is assignable",
        "refused": "refused, with proof",
        "undecided": "undecided",
        "fell_short": "fell short: not every claim is proved",
    }[found.status]


def _target(found: Findings) -> str:
    parts = []
    many = found.loop.plant.n > _MANY
    for symbol in found.loop.plant.x:
        value = found.x_star[symbol]
        if many and value == 0:
            continue
        unit = found.loop.plant.units.get(str(symbol), "")
        decimal = "" if value.is_Integer else f" = {float(sp.N(value)):.6g}"
        parts.append(f"{symbol} = {sp.sstr(value)}{decimal}{' ' + unit if unit else ''}")
    if many:
        return f"{', '.join(parts[:_MANY])}{', …' if len(parts) > _MANY else ''}; zeros not listed"
    return ", ".join(parts)


def _casimirs(casimirs: Casimirs) -> str:
    listed = "; ".join(to_text(c) for c in casimirs.functions) or "none"
    return (
        f"{listed}   ({len(casimirs.functions)} found of {casimirs.generic_count} that exist; "
        f"kernel rank {casimirs.kernel_rank})"
    )


def _verdict_text(verdict: Verdict) -> str:
    ceiling = "no ceiling on a" if verdict.a_max is None else f"a_max = {verdict.a_max:.4g}"
    if verdict.assignable:
        parts = [f"assignable; {ceiling}"]
        if verdict.stability:
            parts.append(f"best stability class: {verdict.stability}")
        if verdict.witness:
            parts.append(verdict.witness)
        return "; ".join(parts)
    return f"{verdict.reason}: {verdict.explanation}"


def _design_rows(design: Design, certificate: Certificate | None) -> list[tuple[str, str]]:
    block = design_block(design, certificate)
    names = design.loop.controller.states
    xi = ", ".join(f"{n}* = {v:.6g}" for n, v in zip(names, design.xi_star, strict=True))
    best = min(design.starts, key=lambda s: s.loss)
    paper, rigorous = block["bound_paper"], block["bound_rigorous"]
    bounds = (
        f"ε/(a − ε) = {paper:.2g}" if paper is not None else "ε/(a − ε) is no bound (ε ≥ a)"
    ) + (f", proved ≤ {rigorous:.2g}" if rigorous is not None else ", no proved bound")
    z_bar = ", ".join(f"{v:.6g}" for v in design.z_bar[:_MANY])
    z_bar += ", …" if len(design.z_bar) > _MANY else ""
    return [
        (
            "design",
            f"{xi}; loss ε = {block['loss']:.2g} at a = {design.a:.4g}; IPOPT: "
            f"{best.explained.meaning}, {best.iterations} iterations, "
            f"{sum(s.seconds for s in design.starts):.3f} s in {len(design.starts)} start(s)",
        ),
        ("minimum", f"z̄ = ({z_bar}); ‖z̄ − z*‖ = {block['distance']:.2g}; {bounds}"),
        (
            "loop",
            f"D = {_matrix(design.D)}, Dc = {_matrix(design.Dc)}; spectral abscissa "
            f"{block['spectral_abscissa']:.4g} 1/s; least eigenvalue of ∇²V(z̄) "
            f"{block['hessian_min_eig']:.4g}",
        ),
    ]


def _sampled(sampling: Sampling) -> str:
    limit = (
        "no largest stable sample time was found"
        if sampling.largest_stable is None
        else f"stable up to {sampling.largest_stable:.3g} s"
    )
    return (
        f"at {sampling.sample_time:g} s the sampled loop has spectral radius "
        f"{sampling.spectral_radius:.4f} at z̄; {limit} (linearised)"
    )


def _learned(residual: Residual) -> str:
    return (
        "the Casimir is a network and holds only approximately: on "
        f"{residual.points} points that it was not trained on, ‖∇Cᵀ(Jcl − Rcl)‖ relative to "
        f"‖∇C‖‖Jcl − Rcl‖ is {residual.mean:.2g} on average, {residual.worst:.2g} at worst; "
        "no decrease of V follows, so nothing is certified"
    )


def _matrix(D: np.ndarray) -> str:
    diagonal = np.diag(np.diag(D))
    if np.array_equal(D, diagonal):
        values = [f"{v:.4g}" for v in np.diag(D)]
        return values[0] if len(values) == 1 else f"diag({', '.join(values)})"
    return str(np.round(D, 4).tolist())


def _responses(found: Findings) -> str:
    settled = [r for r in found.responses if r.converged]
    text = f"{len(settled)} of {len(found.responses)} random starts settle within 2 %"
    if settled:
        slowest = max(r.settling_time for r in settled)
        text += f", the slowest in {slowest:.3g} s"
    peak = max(r.peak_input for r in found.responses)
    if found.simulated_share is not None:
        text += (
            f"; the loop converges from {found.simulated_share:.0%} of random states of the "
            "domain, momenta at rest"
        )
    return f"{text}; peak |u| {peak:.3g} (simulated)"
