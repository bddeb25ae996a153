"""A design as one of a family: what that asks of its training, what is proved of all members."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import sympy as sp

from necc_casadi.methods.method import Method
from necc_casadi.model.build_family import family_loop
from necc_casadi.model.family_loop import FamilyLoop, NoFamily
from necc_casadi.model.model_file import Model
from necc_casadi.synthesis.options import Options

if TYPE_CHECKING:  # what --check does not need is loaded when it is reached
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.family import Family

__all__ = ["family_notes", "family_of", "refused_by_all", "with_family"]


def refused_by_all(
    model: Model, methods: Sequence[Method], x_star: Mapping[sp.Symbol, sp.Expr], options: Options
) -> NoFamily | None:
    """Why no loop that may be taken holds the target for all of the ranges; None without proof."""
    found: NoFamily | None = None
    for method in methods if model.ranges else ():
        lifted = _lifted(model, method, x_star, options)
        if not (isinstance(lifted, NoFamily) and lifted.reason == "refused"):
            return None
        found = found or lifted
    return found


def family_of(
    model: Model, method: Method, x_star: Mapping[sp.Symbol, sp.Expr], options: Options
) -> FamilyLoop | None:
    """The loop of a method for all of the ranges, for which its V is to be designed."""
    if not model.ranges or options.learn_casimir:
        return None
    lifted = _lifted(model, method, x_star, options)
    return None if isinstance(lifted, NoFamily) else lifted


def _lifted(
    model: Model, method: Method, x_star: Mapping[sp.Symbol, sp.Expr], options: Options
) -> FamilyLoop | NoFamily:
    star = tuple(x_star[s] for s in model.system.x)
    functions, sums = method.casimirs.functions, options.phi == "sum"
    return family_loop(
        method.loop, functions, star, model.ranges, model.parametric, phi_is_sum=sums
    )


def family_notes(made: Design, model: Model, family: Family | None) -> list[str]:
    """What a user of set-points that move would miss."""
    if family is None or not model.ranges.setpoints or made.setpoints:
        return []
    return [
        "the C code holds the target alone: necc_set_target needs a fully actuated mechanical "
        "plant that measures velocities; for other set-points see Family.control in Python"
    ]


def with_family(
    made: Design, certificate: Certificate, model: Model
) -> tuple[Certificate, Family | None, str | None]:
    """The certificate with what is proved of the family, the family, and what is missing."""
    from necc_casadi.certificate.claims.claim import Claim
    from necc_casadi.certificate.claims.family import proved_share
    from necc_casadi.certificate.claims.statements import NO_FAMILY
    from necc_casadi.certificate.prover.everywhere import prove_everywhere
    from necc_casadi.certificate.prover.family import prove_family
    from necc_casadi.certificate.prover.members import prove_members
    from necc_casadi.designs.family import lift

    lifted = lift(made, model.ranges, model.parametric)
    if isinstance(lifted, NoFamily):
        claim = Claim("family", False, NO_FAMILY[lifted.reason])
        return certificate.having(claim), None, lifted.sentence
    claim, because = prove_family(lifted), None
    if not claim.holds:
        claim, because = Claim("family", False, NO_FAMILY["open"]), claim.statement
    elif claim.data["left"]:
        share = proved_share(claim.data)
        because = f"proved on {100 * share:.3g} % of the ranges; the claim names what is left out"
    everywhere = prove_everywhere(lifted)
    certificate = certificate.having(claim, everywhere)
    if everywhere.data.get("follows") != "converges" or made.loop.plant.domain:
        certificate = certificate.having(prove_members(lifted, claim))
    return certificate, lifted, because
