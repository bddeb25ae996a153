"""Findings with one thing changed."""

from dataclasses import replace

from necc_casadi.report.findings import Findings


def with_claim(found, **changes) -> Findings:
    """The findings with another region claim."""
    claims = tuple(
        replace(claim, **changes) if claim.name == "region" else claim
        for claim in found.certificate.claims
    )
    return replace(found, certificate=replace(found.certificate, claims=claims))
