"""Responses of the examples beside LQR and the optimum, as a table in Markdown.

For each example: cost over the least cost (geometric mean and worst of 20 starts, drawn from the
domain with a fixed seed), of LQR, of the default design and of that of least quadratic cost; phase
and disk margins at the plant's input; how many starts arrive; seconds of the design.

    python benchmarks/quality.py [NAME ...]

Weights are Bryson's: 1/size² of every state and input. Inputs stay within the limits
of the model, where it has any.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from necc_casadi import Design, Options, design, find_casimirs, judge, load_model, parse_target
from necc_casadi.model.target import target_from_model
from necc_casadi.performance.measure import Performance, measure

EXAMPLES = Path(__file__).parents[1] / "examples"

#: Row -> example, target (None: the model's own) and whether V is made convex everywhere.
CASES: dict[str, tuple[str, str | None, bool]] = {
    "pendulum at π/4": ("pendulum", "pi/4", False),
    "pendulum at π": ("pendulum", "pi", False),
    "damped pendulum": ("damped_pendulum", "pi/4", False),
    "two-link arm": ("two_link_arm", None, False),
    "two-link arm, global": ("two_link_arm", None, True),
    "maglev": ("maglev", None, False),
    "chain of 4": ("mass_spring_chain", None, False),
    "cart-pole": ("cart_pole", None, False),
    "series RLC": ("series_rlc", None, False),
    "DC motor": ("dc_motor", None, False),
    "TORA": ("tora", None, False),
    "satellite": ("satellite", None, False),
}
HEADER = ("plant", "LQR", *("cost", "margins", "arrive", "s") * 2)


def made(name: str, target: str | None, options: Options) -> tuple[Design, float]:
    """A design, and the seconds that training took."""
    model = load_model(EXAMPLES / f"{name}.py")
    plant = model.loop.plant
    given = model.target if target is None else None
    x_star = parse_target(plant, target or "") if given is None else target_from_model(plant, given)
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    verdict = judge(model.loop, casimirs, x_star)
    began = time.perf_counter()
    result = design(model.loop, casimirs, verdict, x_star, options)
    return result, time.perf_counter() - began


def ratio(mean: float | None, worst: float | None) -> str:
    """Geometric mean and worst."""
    return "–" if mean is None or worst is None else f"{mean:.2f}/{worst:.2f}"


def cells(found: Performance, seconds: float) -> list[str]:
    """Ratio, margins, arrivals and time."""
    margins = found.design.margins
    return [
        ratio(found.design.cost_to_optimum, found.design.worst_to_optimum),
        "–" if margins is None else f"{margins.phase_deg:.0f}°, {margins.disk:.2f}",
        f"{100 * found.design.converging_share:.0f} %",
        f"{seconds:.2f}",
    ]


def row(label: str) -> list[str]:
    """One line of the table."""
    name, target, convex = CASES[label]
    result, linear = [], "–"
    for least_cost in (False, True):
        design_, seconds = made(name, target, Options(convex=convex, least_cost=least_cost))
        found = measure(design_)
        if found.lqr is not None:
            linear = ratio(found.lqr.cost_to_optimum, found.lqr.worst_to_optimum)
        result += cells(found, seconds)
    return [label, linear, *result]


def main(chosen: list[str]) -> None:
    """Print the table."""
    print("| " + " | ".join(HEADER) + " |")
    print("|" + "---|" * len(HEADER))
    for label in CASES:
        if not chosen or any(word in label for word in chosen):
            print("| " + " | ".join(row(label)) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
