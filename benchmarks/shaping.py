"""What shaping V over the domain gives: the certified share with and without, and what it costs.

    python benchmarks/shaping.py [--only NAME,…] [--seeds N] [--starts N]

Prints a Markdown table: the share of the domain that is proved, momenta at rest; the share that
any level could have on the box (up to two states beside the momenta); the share with momenta,
sampled; the level above V(z̄); ε; the time inside IPOPT; settling time and peak input from the same
random states of the domain. Medians over seeds, the least and the largest in brackets.
"""

from __future__ import annotations

import argparse
import platform
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from necc_casadi import Design, Options, certify, design, find_casimirs, judge, load_model
from necc_casadi.cases import Shape
from necc_casadi.designs.error_bound import natural_loss
from necc_casadi.model.samples import quasi_random
from necc_casadi.model.target import parse_target, target_from_model
from necc_casadi.performance.shares import sampled_share
from necc_casadi.simulation.responses import default_horizon, random_states, response_from

EXAMPLES = Path(__file__).parent.parent / "examples"
TARGETS = {"pendulum": "pi/4"}
PLANTS = ("pendulum", "maglev", "dc_motor", "two_link_arm", "cart_pole", "mems_comb")
SAMPLES = 20_000
HORIZON, POINTS = 40.0, 2001


@dataclass(frozen=True)
class Row:
    """What was measured about one design."""

    sampled: float  # share of the domain in Ω
    height: float | None  # of what ends the region, above V(z̄)
    with_momenta: float
    level: float
    loss: float
    seconds: float
    settling: tuple[float, ...]  # s, one per start; inf: not settled
    peaks: tuple[float, ...]
    shaped: bool  # whether a program with samples was solved


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", help="names of plants, separated by commas")
    parser.add_argument("--seeds", type=int, default=5, help="seeds 0 … N-1")
    parser.add_argument("--starts", type=int, default=10, help="random states per design")
    arguments = parser.parse_args()
    plants = PLANTS if arguments.only is None else arguments.only.split(",")
    print(f"{platform.processor() or platform.machine()}, {platform.python_version()}\n")
    print(
        "| plant | shape | sampled share | obstacle | with momenta | level | ε | IPOPT [s] "
        "| settling [s] | peak \\|u\\| |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for plant in plants:
        make = designer(plant)
        for shape in get_args(Shape):
            rows = [
                measured(make, shape, seed, arguments.starts) for seed in range(arguments.seeds)
            ]
            print(line(plant, shape, rows), flush=True)


def designer(plant: str) -> Callable[[Options], Design]:
    """options -> Design for an example plant at its target."""
    model = load_model(EXAMPLES / f"{plant}.py")
    text = TARGETS.get(plant)
    x_star = (
        target_from_model(model.loop.plant, model.target)
        if text is None
        else parse_target(model.loop.plant, text)
    )
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    verdict = judge(model.loop, casimirs, x_star)
    return lambda options: design(model.loop, casimirs, verdict, x_star, options)


def measured(make: Callable[[Options], Design], shape: str, seed: int, starts: int) -> Row:
    """Design, certify and simulate."""
    made = make(Options(shape=shape, seed=seed))
    certificate = certify(made)
    obstacle = certificate.obstacle
    horizon = max(HORIZON, default_horizon(made))
    x0s = random_states(made, starts, seed=0)
    responses = [response_from(made, x0, time=horizon, points=POINTS) for x0 in x0s]
    sampled = sampled_share(made, certificate)
    level = certificate.level or (np.inf if sampled == 1.0 else -np.inf)
    return Row(
        sampled=sampled or 0.0,
        height=None if obstacle is None else obstacle.level_above_minimum,
        with_momenta=share_below(made, level),
        level=level - made.V(made.z_bar),
        loss=natural_loss(made),
        seconds=sum(start.seconds for start in made.starts),
        settling=tuple(response.settling_time for response in responses),
        peaks=tuple(response.peak_input for response in responses),
        shaped=any(start.mode == "shaped" for start in made.starts),
    )


def share_below(made: Design, level: float) -> float:
    """Share of the whole domain, momenta included, on which V ≤ level, by samples."""
    domain = made.domain
    points = domain.lo + quasi_random(SAMPLES, made.loop.n, 0) * (domain.hi - domain.lo)
    values = made.lyapunov.V(points)
    return float((values <= level).mean())


def line(plant: str, shape: str, rows: Sequence[Row]) -> str:
    """One row of the table."""
    heights = [row.height for row in rows if row.height is not None]
    settling = [time for row in rows for time in row.settling]
    settled = sum(np.isfinite(settling))
    unsettled = "" if settled == len(settling) else f", {settled} of {len(settling)} settle"
    stiff = shape == "level" and not any(row.shaped for row in rows)
    note = " (stiffness alone, or nothing)" if stiff else ""
    return (
        f"| {plant} | {shape}{note} | {percent(row.sampled for row in rows)} "
        f"| {spread(heights, '.2f') if heights else '–'} "
        f"| {percent(row.with_momenta for row in rows)} "
        f"| {spread((row.level for row in rows), '.2f')} | ≤ {max(row.loss for row in rows):.0e} "
        f"| {spread((row.seconds for row in rows), '.2f')} "
        f"| {statistics.median(settling):.2f}{unsettled} "
        f"| {statistics.median(peak for row in rows for peak in row.peaks):.2f} |"
    )


def percent(values: Iterable[float]) -> str:
    """Median and range in percent."""
    return spread((100 * value for value in values), ".1f") + " %"


def spread(values: Iterable[float], digits: str) -> str:
    """Median and range."""
    ordered = sorted(values)
    middle = statistics.median(ordered)
    return f"{middle:{digits}} ({ordered[0]:{digits}} … {ordered[-1]:{digits}})"


if __name__ == "__main__":
    main()
