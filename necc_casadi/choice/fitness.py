"""What is wrong with a response, in words: against what is claimed, or beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from necc_casadi.choice.choose import Choice
from necc_casadi.choice.judged import Judged
from necc_casadi.designs.design import Design
from necc_casadi.performance.saturated import Elsewhere
from necc_casadi.performance.shares import holds

__all__ = ["place", "response_faults", "response_warnings"]


#: Longer lists of coordinates are shortened; coordinates this close to the target, in sizes, are
#: left out.
_FEW, _OTHER = 6, 0.05


def response_faults(kept: Judged) -> tuple[str, ...]:
    """What a response has against what is claimed.

    An input beyond its limits, where no region is proved that keeps it within, and starts of the
    proved region that do not arrive once inputs are clipped.
    """
    faults = []
    if not kept.fits_limits:
        faults.append(_beyond_limits(kept))
    inside = _claimed(kept)
    if inside:
        faults.append(_gone(kept, inside, "starts of the proved region"))
    return tuple(faults)


def response_warnings(choice: Choice) -> tuple[str, ...]:
    """What a response has beyond what is claimed, and a minimum of V below that at the target."""
    kept, warnings = choice.kept, []
    if not kept.response.keeps_limits and kept.fits_limits and not kept.clips_freely:
        warnings.append(f"{_beyond_limits(kept)}; it is proved from where they are kept")
    outside = tuple(i for i in _strayed(kept) if i not in _claimed(kept))
    if outside:
        warnings.append(_gone(kept, outside, "random starts"))
    if choice.lower is not None:
        at = place(choice.lower.at, kept.design)
        warnings.append(f"V has a lower minimum at {at}")
    return tuple(warnings)


def _strayed(kept: Judged) -> tuple[int, ...]:
    """The starts that do not arrive, where any should."""
    return kept.response.strayed if kept.certificate.stability == "asymptotic" else ()


def _claimed(kept: Judged) -> tuple[int, ...]:
    """Those of them that lie where something is claimed."""
    strayed = list(_strayed(kept))
    if not strayed or not kept.proved:
        return ()
    starts = kept.response.starts[strayed]
    xi = np.array([kept.design.xi_at_state(row) for row in starts])
    inside = holds(kept.design, kept.certificate, np.concatenate([starts, xi], axis=1))
    return tuple(np.array(strayed)[inside].tolist())


def _gone(kept: Judged, strayed: Sequence[int], what: str) -> str:
    """How many starts do not arrive, and where most of them are found instead."""
    count, number = len(kept.response.arrived), len(set(strayed))
    at_rest = [(e, len(set(e.starts) & set(strayed))) for e in kept.response.elsewhere]
    at_rest = sorted((pair for pair in at_rest if pair[1]), key=lambda pair: -pair[1])
    astray = set(strayed) - {i for e, _ in at_rest for i in e.starts}
    undefined = sum(not _is_defined(kept, i) for i in sorted(astray))
    away = len(astray) - undefined
    head = f"{number} of {count} {what} {'do' if number > 1 else 'does'} not arrive"
    parts = []
    if at_rest:
        parts.append(_resting(at_rest, kept.design))
    if away:
        parts.append(f"{away} run away" if away > 1 else "1 runs away")
    if undefined:
        parts.append(f"{undefined} start{'' if undefined > 1 else 's'} where the law is undefined")
    return f"{head}: {' and '.join(parts)}"


def _is_defined(kept: Judged, index: int) -> bool:
    """Whether the law has a value at a start."""
    start = kept.response.starts[index]
    with np.errstate(all="ignore"):
        u, _ = kept.design.lyapunov.control_law(start, kept.design.xi_at_state(start))
    return bool(np.isfinite(u).all())


def _resting(places: Sequence[tuple[Elsewhere, int]], design: Design) -> str:
    first, number = places[0]
    rest = sum(count for _, count in places[1:])
    more = f", {rest} in {len(places) - 1} other places" if rest else ""
    return f"{number} settle{'' if number > 1 else 's'} at {place(first.at, design)}{more}"


def _beyond_limits(kept: Judged) -> str:
    """Which inputs are asked for more than their limits allow."""
    response, plant = kept.response, kept.design.loop.plant
    limits = plant.u_limits or ()
    worst = np.asarray(response.exceeded.any(axis=0)).tolist()
    starts = response.beyond
    parts = [
        f"|{name}| up to {peak:.3g}, limits {float(lo):.4g} … {float(hi):.4g}"
        for name, peak, (lo, hi), over in zip(
            plant.input_names, response.peak_u.max(axis=0), limits, worst, strict=True
        )
        if over
    ]
    asks = "start asks" if starts == 1 else "starts ask"
    return f"{starts} of {len(response.exceeded)} {asks} for {'; '.join(parts)}"


def place(at: Mapping[str, float], design: Design) -> str:
    """Where a state is, by the coordinates in which it is not at the target."""
    units, states = design.loop.plant.units, design.loop.states
    sizes = dict(zip(states, design.sizes.state.tolist(), strict=True))
    target = dict(zip(states, design.z_star.tolist(), strict=True))
    parts = [
        f"{name} = {value:.4g} {units.get(name, '')}".rstrip()
        for name, value in at.items()
        if abs(value - target[name]) > _OTHER * sizes[name]
    ]
    return ", ".join([*parts[:_FEW], *(["…"] if len(parts) > _FEW else [])])
