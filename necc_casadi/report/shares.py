"""How much of the domain a proved region holds: sampled, never proved."""

from __future__ import annotations

import numpy as np

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import Region
from necc_casadi.designs.design import Design
from necc_casadi.model.samples import quasi_random
from necc_casadi.report.findings import global_claim

__all__ = ["sampled_share"]


#: States that a share rests on.
_SAMPLES = 4096


def sampled_share(design: Design, certificate: Certificate) -> float | None:
    """The share of quasi-random states of the domain, momenta at rest, that lie in Ω.

    None where no region is proved, or one of which angles of any number of turns are a part.
    """
    whole, region = global_claim(certificate), certificate.region
    if whole is not None and whole.holds:
        return 1.0
    if not isinstance(region, Region):
        return None
    V, lo, hi = design.lyapunov.V, design.domain.lo, design.domain.hi
    z = lo + quasi_random(_SAMPLES, design.loop.n, design.seed) * (hi - lo)
    z[:, list(design.momenta)] = 0.0
    kept = [region.active[i] for i in region.kept]
    over = region.covers(z[:, kept] / design.units.state[kept])
    inside = over & (V(z) / design.units.energy <= region.level)
    return float(np.mean(inside))
