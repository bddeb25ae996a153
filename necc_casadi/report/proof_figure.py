"""Sampled plants beside the proof: their errors in time, and where they rest in the proved band."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from necc_casadi.arrays import Vector
from necc_casadi.performance.beside_proof import BesideProof
from necc_casadi.report.beside import shown_states
from necc_casadi.report.style import INK, TARGET, styled
from necc_casadi.report.ticks import finished, logarithmic, panels, scaled_label

__all__ = ["proof_figure"]


#: The smallest error that a logarithmic axis shows, of the largest.
_LEAST = 1e-12


def proof_figure(
    found: BesideProof, title: str, states: tuple[str, ...], units: Mapping[str, str]
) -> Figure | None:
    """Errors in time and at rest, with what is proved; None where nothing is off the target."""
    shown = shown_states(found, states)
    if not shown:
        return None
    exact = found.proved.claim == "integral"
    with styled():
        figure = panels(len(shown), 2, (3.1, 2.0), legend=0.35)
        figure.suptitle(f"{title}: {len(found.errors)} sampled plants beside what is proved")
        axes = figure.subplots(len(shown), 2, squeeze=False)
        for (left, right), i in zip(axes, shown, strict=True):
            name, unit = states[i], units.get(states[i], "")
            _in_time(left, found, i)
            finished(left, [("x", "time", "s"), ("y", f"{name} less target", unit)])
            if exact:
                _decay(right, found, i)
                finished(right, [("x", "time", "s")])
                right.set_ylabel(scaled_label(f"|{name} less target|", unit, 0))
                logarithmic(right, "y")
            else:
                _at_rest(right, found, i, name)
                finished(right, [("x", f"{name} less target, at rest", unit)])
                right.set_ylabel("plants")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=2, fontsize=8)
    return figure


def _in_time(axis: Axes, found: BesideProof, i: int) -> None:
    """Responses over the band in which every plant is proved to rest."""
    lo, hi = next(side for k, side in enumerate(found.proved.error.values()) if k == i)
    if found.proved.claim == "integral":
        axis.axhline(0.0, color=TARGET, lw=1.6, zorder=3, label="proved: every plant rests here")
    else:
        axis.axhspan(lo, hi, color=TARGET, alpha=0.3, lw=0, label="proved: every plant rests here")
    for k, error in enumerate(found.errors):
        label = "sampled plants" if k == 0 else None
        times = found.times[: len(error)]
        axis.plot(times, error[:, i], color=INK, lw=0.7, alpha=0.45, label=label)
    axis.set_xlim(0, found.times[-1])
    axis.grid(alpha=0.25)


def _decay(axis: Axes, found: BesideProof, i: int) -> None:
    """How the error vanishes."""
    largest = max(float(np.abs(error[:, i]).max()) for error in found.errors)
    for error in found.errors:
        size = np.maximum(np.abs(error[:, i]), _LEAST * largest)
        axis.semilogy(found.times[: len(error)], size, color=INK, lw=0.7, alpha=0.45)
    axis.set_xlim(0, found.times[-1])
    axis.grid(alpha=0.25)


def _at_rest(axis: Axes, found: BesideProof, i: int, name: str) -> None:
    """Where they rest, in the band."""
    lo, hi = found.proved.error[name]
    rests: Vector = found.at_rest[:, i] if len(found.at_rest) else np.zeros(0)
    room = 0.08 * (hi - lo)
    axis.axvspan(lo, hi, color=TARGET, alpha=0.3, lw=0)
    for end in (lo, hi):
        axis.axvline(end, color=TARGET, lw=1.2)
    axis.hist(rests, bins=np.linspace(lo, hi, 21).tolist(), color=INK, alpha=0.85)
    axis.set_xlim(lo - room, hi + room)
    axis.grid(alpha=0.25)
