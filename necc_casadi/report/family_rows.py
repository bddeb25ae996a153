"""Families, sampled plants and integral action, as rows of a page of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from necc_casadi.report.findings import Findings, attracts, held_claim
from necc_casadi.report.values import rounded_down

__all__ = ["family_rows", "integral_rows", "plants_rows"]


def family_rows(found: Findings) -> list[tuple[str, str]]:
    """How far from the set-point every member of the family rests; none without a proof."""
    if found.family is None:
        return []
    from necc_casadi.certificate.claims.family import proved_share

    names = ", ".join(p.name for p in found.family.parameters)
    everywhere, near = (held_claim(found.certificate, name) for name in ("everywhere", "family"))
    rows = []
    if near is not None:
        share = proved_share(near.data)
        part = "" if share == 1 else f", proved on {100 * share:.3g} % of the ranges"
        rows.append(f"{names}: {_at_rest(found, near.data['error'])}{part}")
    elif everywhere is not None:
        sides = {name: (-most, most) for name, most in everywhere.data["error"].items()}
        rows.append(f"{names}: {_at_rest(found, sides)}")
    if everywhere is not None and attracts(everywhere):
        rows.append(f"{names}: from everywhere every solution converges to its place at rest")
    return [("family", row) for row in rows]


def _at_rest(found: Findings, error: Mapping[str, Sequence[float]]) -> str:
    """The errors of the plant's states, outward."""
    from necc_casadi.certificate.claims.family import off_target, outward

    sides = {name: (lo, hi) for name, (lo, hi) in error.items()}
    natural = {} if found.family is None else found.family.state_units
    moving, units = off_target(sides, natural), found.system.units
    if not moving:
        return "no error at rest but rounding"
    shown = {name: " … ".join(outward(sides[name])) for name in moving}
    parts = [f"{name} {side} {units.get(name, '')}".rstrip() for name, side in shown.items()]
    return f"error at rest {', '.join(parts)}"


def plants_rows(found: Findings) -> list[tuple[str, str]]:
    """Plants of the ranges that are proved, simulated; none without a proof."""
    if found.beside is None:
        return []
    from necc_casadi.report.beside import proved_and_sampled

    plant = found.finished[0].loop.plant
    text = proved_and_sampled(found.beside, plant.states, plant.units)
    return [("plants", f"{text} (simulated)")]


def integral_rows(found: Findings) -> list[tuple[str, str]]:
    """Integral action, and what is proved of it; none without."""
    design, certificate = found.design, found.certificate
    if design is None or design.integral is None or certificate is None:
        return []
    integral = design.integral
    gains, limits = (", ".join(f"{v:.4g}" for v in a) for a in (integral.gain, integral.limit))
    head = f"τ = {integral.tau:.4g} s, Kᵢ = {gains}, |ζ| ≤ {limits}"
    claim = next((c for c in certificate.claims if c.name == "integral" and c.holds), None)
    if any(c.name == "local_integral" and c.holds for c in certificate.claims):
        return [("integral", f"{head}; no offset from near enough (local: no region is proved)")]
    if claim is None:
        return [("integral", f"{head}; nothing is proved of it")]
    level = rounded_down(claim.data["level"] * design.units.energy, 4)
    return [("integral", f"{head}; no offset from W ≤ {level} in the box that is proved")]
