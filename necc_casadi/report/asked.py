"""What was asked of a response, and what was reached, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from necc_casadi.arrays import Vector

if TYPE_CHECKING:
    from necc_casadi.synthesis.asked import Asked

__all__ = ["asked_text", "missed"]


def missed(asked: Asked) -> str:
    """What is not met, in a few words."""
    if asked.rate is not None and asked.rate_reached < asked.rate:
        return f"rate {asked.rate:.3g} 1/s asked, {asked.rate_reached:.3g} 1/s reached"
    return "the peak that was asked of u is not kept"


def asked_text(asked: Asked) -> str:
    """What was asked, whether it is met, and if not, how far it goes and what stops it."""
    parts = []
    if asked.rate is not None:
        speed = f"rate {asked.rate:.3g} 1/s asked, {asked.rate_reached:.3g} 1/s reached"
        parts.append(f"{speed} by the slowest mode at z̄")
    if asked.limits is not None and asked.peaks is not None:
        taken, allowed = _ranges(asked.peaks), _ranges(asked.limits)
        parts.append(f"from random starts the law takes u {taken}, allowed is {allowed}")
    if asked.stopped_by is not None:
        parts.append(_why(asked))
    return "; ".join(parts)


def _ranges(values: Vector) -> str:
    return ", ".join(f"{low:.3g} … {high:.3g}" for low, high in values)


def _why(asked: Asked) -> str:
    if asked.stopped_by == "unmoved_mode" and asked.mode is not None:
        return f"the plant has a mode at {_mode(asked.mode)} 1/s that no input moves"
    if asked.stopped_by == "input_peak":
        if asked.held_outside:
            return f"holding the target takes u = {_values(asked.held)}"
        if asked.unlimited is None or _fast_enough(asked):
            return "no weight of the inputs that was tried keeps the peak"
        tried = "faster loops that were tried take more" if _kept(asked) else "no loop keeps it"
        free = f"with no limit {asked.unlimited:.3g} 1/s is reached"
        return f"the peak of u stops it: {tried}; {free}"
    if asked.stopped_by == "norm_bound":
        return "a faster loop needs modes more than 6 times as fast as those of LQR at this rate"
    return "no faster loop of this structure was found: u sees the plant through y and Casimirs"


def _fast_enough(asked: Asked) -> bool:
    return asked.rate is None or asked.rate_reached >= asked.rate


def _kept(asked: Asked) -> bool:
    """Whether the peak is kept."""
    if asked.peaks is None or asked.limits is None:
        return True
    low, high = (asked.peaks - asked.limits).T
    return bool(np.all(low >= 0) and np.all(high <= 0))


def _values(values: Vector) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


def _mode(mode: complex) -> str:
    return f"{mode.real:.3g}" if np.isclose(mode.imag, 0) else f"{mode.real:.3g} ± {mode.imag:.3g}j"
