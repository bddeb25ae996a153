"""How much of the domain a proved region holds: sampled, never proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import Region
from necc_casadi.certificate.prover.region.landscape import Landscape
from necc_casadi.designs.design import Design
from necc_casadi.model.samples import quasi_random

__all__ = ["holds", "plant_share", "sampled_share", "unclipped_share"]


#: States that a share rests on, and plant states, for each of which V is minimised over ξ.
_SAMPLES, _PLANT_SAMPLES = 4096, 512


def holds(design: Design, certificate: Certificate, z: Vector) -> Truth:
    """Which states (B, n + nc) lie where the certificate claims something, (B,)."""
    if certificate.of_the_whole_space:
        return np.ones(len(z), dtype=bool)
    region = certificate.region
    if region is None:
        return np.zeros(len(z), dtype=bool)
    if region.method == "curved":
        return np.array([certificate.contains(lambda v: float(design.V(v)), row) for row in z])
    return _inside(design, region, z)


def _inside(design: Design, region: Region, z: Vector) -> Truth:
    over = region.holds(z / design.units.state)
    below: Truth = design.lyapunov.V(z) / design.units.energy <= region.level
    return over & below


def sampled_share(design: Design, certificate: Certificate) -> float | None:
    """The share of quasi-random states of the domain, momenta at rest, that lie in Ω.

    None where no region is proved, or one of which angles of any number of turns are a part.
    """
    curved = certificate.region is not None and certificate.region.method == "curved"
    if not _claims(certificate) or curved:
        return None
    lo, hi = design.domain.lo, design.domain.hi
    z = lo + quasi_random(_SAMPLES, design.loop.n, design.seed) * (hi - lo)
    z[:, list(design.momenta)] = 0.0
    return float(np.mean(holds(design, certificate, z)))


def plant_share(design: Design, certificate: Certificate) -> float:
    """The share of plant states of the domain, momenta at rest, above which Ω has a state.

    ξ is the minimum of V(x, ·) near ξ*, as ``necc_init_at`` starts it. The same states for every
    design of a plant; 0 where no region is proved.
    """
    if not _claims(certificate):
        return 0.0
    return float(np.mean(holds(design, certificate, _plant_states(design))))


def unclipped_share(design: Design, certificate: Certificate) -> float | None:
    """The share of the same states from which clipping, if any, is proved to do no harm.

    None where the plant's inputs have none.
    """
    region, level = certificate.region, certificate.level_clipped or certificate.level_u
    if design.loop.plant.u_limits is None:
        return None
    if any(
        c.name == "clipping" and c.holds and c.data.get("everywhere") for c in certificate.claims
    ):
        return 1.0 if certificate.is_global else plant_share(design, certificate)
    if region is None or level is None or region.method == "curved":
        return 0.0
    within = replace(region, level=level / design.units.energy)
    return float(np.mean(_inside(design, within, _plant_states(design))))


def _plant_states(design: Design) -> Vector:
    """Plant states that fill the domain, momenta at rest, ξ where V is least, (B, n + nc)."""
    n, natural = design.loop.plant.n, design.natural
    lo, hi = natural.domain.lo[:n], natural.domain.hi[:n]
    active = tuple(i for i in range(design.loop.n) if i not in design.momenta)
    kept = tuple(k for k, i in enumerate(active) if i < n)
    gone = tuple(k for k, i in enumerate(active) if i >= n)
    x = (lo + quasi_random(_PLANT_SAMPLES, n, 0) * (hi - lo))[:, [active[k] for k in kept]]
    landscape = Landscape(natural.lyapunov, natural.z_star, active, kept, gone)
    return np.asarray(landscape.states(x, landscape.minima(x).e) * design.units.state)


def _claims(certificate: Certificate) -> bool:
    return certificate.of_the_whole_space or certificate.region is not None
