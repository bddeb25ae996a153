"""The region of attraction, as rows of a page of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from necc_casadi.report.findings import Findings, attracts, global_claim, region_claim
from necc_casadi.report.values import (
    MANY,
    SUB,
    percent,
    rounded_down,
    tied,
)

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate

__all__ = ["region_rows"]


def region_rows(found: Findings, certificate: Certificate) -> list[tuple[str, str]]:
    """The proved region beside what was sampled and simulated."""
    rows = _regions(found, certificate)
    if found.design is None or found.design.integral is None:
        return rows
    return [(label, f"with ζ = 0: {text}") for label, text in rows[:1]]


def _regions(found: Findings, certificate: Certificate) -> list[tuple[str, str]]:
    claim, whole = region_claim(certificate), global_claim(certificate)
    proved = claim is not None and claim.holds
    if whole is not None and whole.holds:
        what = "converges to z̄" if attracts(whole) else "is bounded, z̄ V's only critical point"
        head = f"the whole space is proved: every solution {what}"
        return _block(head, _ends(found, certificate) if proved else [])
    if claim is None or not proved:
        where = "of the domain, momenta at rest,"
        return [] if claim is None else _block("none is proved", _simulated(found, where))
    what = "every solution converges" if attracts(claim) else "solutions stay in it"
    height = rounded_down(certificate.level_above_minimum or 0.0, 4)
    head = f"Ω = {{V − V(z̄) ≤ {height}}} around z̄: {what}"
    rows = _ends(found, certificate)
    if found.domain_share is not None:
        sampled = f"{100 * found.domain_share:.3g} % of the domain, momenta at rest, is in it"
        rows.append(("sampled", sampled))
    return _block(head, rows + _simulated(found, "of the domain, momenta at rest,"))


def _ends(found: Findings, certificate: Certificate) -> list[tuple[str, str]]:
    """What the region stays below, and how far it reaches."""
    rows, share = [("limited by", certificate.limited_by or "")], certificate.obstacle_share
    if share is not None:
        rows.append(("proved", f"up to {percent(share, 3)} of that height"))
    reach = _reach(found, certificate)
    return rows + ([("reach", reach)] if reach else [])


def _simulated(found: Findings, where: str) -> list[tuple[str, str]]:
    """The simulated share; where nothing is to converge there is none."""
    if found.certificate is None or found.certificate.stability != "asymptotic":
        return []
    if found.simulated_share is None:
        return [("simulated", "not known: some random states take too long")]
    return [("simulated", f"{100 * found.simulated_share:.3g} % of random states {where} converge")]


def _block(head: str, rows: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Rows of a label and a text under one heading."""
    return [("region", head), *(("", f"{label:<{SUB}}{text}") for label, text in rows)]


def _reach(found: Findings, certificate: Certificate) -> str:
    """Between which values every state stays on Ω."""
    units, reach = found.system.units, certificate.reach or {}
    parts = [
        tied(f"{name} any" if side is None else _side(name, side, units.get(name, "")))
        for name, side in reach.items()
    ]
    more = ["…"] if len(parts) > MANY else []
    return ", ".join(parts[:MANY] + more)


def _side(name: str, side: tuple[float, float], unit: str) -> str:
    return f"{name} {side[0]:.3g} … {side[1]:.3g} {unit}".rstrip()
