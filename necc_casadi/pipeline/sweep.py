"""One design for each value of a, in the same form, with what is proved about it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.design import Design
from necc_casadi.designs.measures import measure
from necc_casadi.performance.shares import sampled_share
from necc_casadi.pipeline.clock import Say
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.simulation.convergence import simulated_share

__all__ = ["sweep_a"]


def sweep_a(
    values: tuple[float, float, int], train: Callable[[float], Design], say: Say
) -> tuple[SweepPoint, ...]:
    """The designs that `train` makes for a = lo … hi, n of them."""
    points = []
    for index, a in enumerate(np.linspace(*values).tolist()):
        progress = f"sweeping a: {index + 1} of {values[2]}"
        say(progress)
        points.append(_point(a, train(a), progress, say))
    return tuple(points)


def _point(a: float, made: Design, progress: str, say: Say) -> SweepPoint:
    """What this design reached, what is proved about it, and its simulated share."""
    certificate = certify(made, report=lambda stage, _: say(f"{progress}, {stage}"))
    measures = measure(made)
    return SweepPoint(
        a=a,
        loss=measures.loss,
        distance=measures.distance,
        bound_paper=measures.bound_paper,
        bound_rigorous=certificate.bound_rigorous,
        domain_share=sampled_share(made, certificate),
        simulated_share=simulated_share(made, made.momenta, made.seed),
        limited_by=certificate.limited_by,
    )
