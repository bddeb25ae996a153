"""The domain around z* as a shaping samples it: momenta at rest, their energy added."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass

import casadi as ca
import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.lyapunov.lyapunov import Terms
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.domain import Domain, domain_of
from necc_casadi.model.samples import quasi_random

__all__ = ["SampleBox", "sample_box"]

#: Points of the domain at which the inertia of the momenta is looked at.
_CEILING_SAMPLES = 256
#: Share of the ceiling over samples that is used: there are states between them.
_BELOW_SAMPLES = 0.999999


@dataclass(frozen=True, eq=False)
class SampleBox:
    """The part of the domain that is sampled, seen from z*."""

    lo: Vector  # (n + nc,) domain − z*
    hi: Vector  # (n + nc,)
    active: tuple[int, ...]  # the states that are sampled; the others rest
    shaped: tuple[int, ...]  # those of them that the networks act on
    ceiling: float  # V − V(z*) below which the resting states stay in the domain; may be ∞
    excess: Callable[[Vector], Vector]  # offsets (S, n + nc) -> energy that no network takes away


def sample_box(
    loop: ClosedLoop,
    casimirs: Casimirs,
    terms: Terms,
    z: Vector,
    size: Vector,
    momenta: Sequence[int],
) -> SampleBox:
    """The domain around z = (x*, ξ*), states of these sizes."""
    domain = domain_of(loop, z, size)
    used = set().union(*(c.free_symbols for c in casimirs.functions))
    return SampleBox(
        lo=domain.lo - z,
        hi=domain.hi - z,
        active=tuple(i for i in range(loop.n) if i not in momenta),
        shaped=tuple(i for i, s in enumerate(loop.z) if s in used or i >= loop.plant.n),
        ceiling=_momentum_ceiling(terms, domain, momenta),
        excess=lambda offsets: _excess(loop, terms, z[: terms.n], used, offsets),
    )


def _momentum_ceiling(terms: Terms, domain: Domain, momenta: Sequence[int]) -> float:
    """How far V may rise before a momentum can leave the domain, over samples of it; +∞: any.

    With H = ½ sᵀA(y)s + U(y), s_i reaches r first where ½ r²/(A⁻¹)ᵢᵢ is least.
    """
    rest = list(momenta)
    reach = np.minimum(-domain.lo[rest], domain.hi[rest])
    if not rest or (reach <= 0).any():
        return np.inf
    lo, hi = domain.lo[: terms.n], domain.hi[: terms.n]
    x = lo + quasi_random(_CEILING_SAMPLES, terms.n, 0) * (hi - lo)
    x[:, rest] = 0.0
    s = ca.MX.sym("x", terms.n)
    hessian = ca.Function("A", [s], [ca.hessian(terms.H(s), s)[0]])
    least = np.inf
    for point in x:
        A = np.asarray(hessian(point), float)[np.ix_(rest, rest)]
        if np.isfinite(A).all() and np.linalg.eigvalsh(A)[0] > 0:
            inverse = np.diag(np.linalg.inv(A))
            least = min(least, float((0.5 * reach**2 / inverse).min()))
    return _BELOW_SAMPLES * least


def _excess(
    loop: ClosedLoop, terms: Terms, x_star: Vector, used: Set[sp.Symbol], offsets: Vector
) -> Vector:
    """H above its value with the states that no Casimir contains at the target, (S,).

    With Φ = H + Hc + C, V has this energy beyond what the networks give it; not finite where the
    model is not.
    """
    shaped = [i for i, s in enumerate(loop.plant.x) if s in used]
    x = offsets[:, : terms.n].T + x_star[:, None]
    still = np.repeat(x_star[:, None], x.shape[1], axis=1)
    still[shaped] = x[shaped]
    H = terms.H.map(x.shape[1])
    return np.asarray(H(x) - H(still), float).ravel()
