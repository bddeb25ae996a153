"""Sampled plants beside the proof, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from necc_casadi.certificate.claims.family import outward
from necc_casadi.performance.beside_proof import BesideProof

__all__ = ["proved_and_sampled", "shown_states"]


#: States that are shown at most.
_MOST = 4


#: An error at rest of less than this share of the largest in time is nothing.
_NOTHING = 1e-9


def shown_states(found: BesideProof, states: tuple[str, ...]) -> list[int]:
    """Those that rest off the target, of most first; with integral action the coordinates."""
    if found.proved.claim == "integral":
        return list(range(len(states) // 2))[:_MOST]
    scale = np.max([np.abs(e).max(axis=0) for e in found.errors], axis=0)
    size = [max(-found.proved.error[name][0], found.proved.error[name][1]) for name in states]
    moving = [i for i in range(len(states)) if size[i] > _NOTHING * scale[i]]
    return moving[:_MOST]


def proved_and_sampled(
    found: BesideProof, states: tuple[str, ...], units: Mapping[str, str]
) -> str:
    """One line: what is proved of the error at rest, and what plants that were drawn have."""
    rests, total = found.at_rest, len(found.rests)
    lost = total - len(rests)
    tail = f"; {lost} of {total} plants do not rest nearby" if lost else ""
    if found.proved.claim == "integral":
        worst = float(np.abs(rests[:, : len(states) // 2]).max()) if len(rests) else np.nan
        return f"error at rest proved 0 / sampled at most {worst:.2g}, {total} plants{tail}"
    parts = []
    for i in shown_states(found, states):
        lo, hi = found.proved.error[states[i]]
        seen = rests[:, i] if len(rests) else np.array([np.nan])
        band, drawn = " … ".join(outward((lo, hi))), f"{seen.min():.4g} … {seen.max():.4g}"
        text = f"{states[i]} proved {band} / sampled {drawn} {units.get(states[i], '')}"
        parts.append(text.rstrip())
    return f"{', '.join(parts) or 'no error but rounding'}, {total} plants{tail}"
