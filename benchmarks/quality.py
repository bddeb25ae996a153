"""Responses of the examples beside LQR and the optimum, as a table in Markdown.

For each example: cost over the least cost (geometric mean and worst of 20 starts, drawn from the
domain with a fixed seed), of LQR, of the plain default and of the design that the tool keeps; phase
and disk margins at the plant's input; how many starts arrive; what is proved: the whole space, or
the share of the plant's states at rest that the region holds; processor seconds of design and
proofs.

    python benchmarks/quality.py [--polish] [NAME ...]

With --polish, the design that the tool keeps where it is asked to improve it on responses stands
beside the one that it keeps otherwise, in place of the plain default.

Weights are Bryson's: 1/size² of every state and input. Inputs stay within the limits
of the model, where it has any.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from necc_casadi import (
    Certificate,
    Design,
    Options,
    certify,
    choose,
    design,
    find_casimirs,
    judge,
    load_model,
    parse_target,
)
from necc_casadi.model.target import target_from_model
from necc_casadi.performance.measure import measure
from necc_casadi.performance.shares import plant_share

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
HEADER = ("plant", "LQR", *("cost", "margins", "arrive", "proved", "s") * 2, "kept")


def task(name: str, target: str | None) -> SimpleNamespace:
    """A judged target of an example."""
    model = load_model(EXAMPLES / f"{name}.py")
    plant = model.loop.plant
    given = model.target if target is None else None
    x_star = parse_target(plant, target or "") if given is None else target_from_model(plant, given)
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    verdict = judge(model.loop, casimirs, x_star)
    return SimpleNamespace(parts=(model.loop, casimirs, verdict, x_star))


def ratio(mean: float | None, worst: float | None) -> str:
    """Geometric mean and worst."""
    return "–" if mean is None or worst is None else f"{mean:.2f}/{worst:.2f}"


def proved(made: Design, certificate: Certificate) -> str:
    """The whole space, or a share of the plant's states at rest."""
    whole = any(claim.name == "global" and claim.holds for claim in certificate.claims)
    if certificate.is_global:
        return "global"
    return "one minimum" if whole else f"{100 * plant_share(made, certificate):.0f} %"


def cells(made: Design, certificate: Certificate, seconds: float) -> tuple[str, list[str]]:
    """LQR's ratio; ratio, margins, arrivals, proved share and time of a design."""
    found = measure(made)
    margins, lqr = found.design.margins, found.lqr
    linear = "–" if lqr is None else ratio(lqr.cost_to_optimum, lqr.worst_to_optimum)
    return linear, [
        ratio(found.design.cost_to_optimum, found.design.worst_to_optimum),
        "–" if margins is None else f"{margins.phase_deg:.0f}°, {margins.disk:.2f}",
        f"{100 * found.design.converging_share:.0f} %",
        proved(made, certificate),
        f"{seconds:.2f}",
    ]


def row(label: str, polish: bool) -> list[str]:
    """One line of the table."""
    name, target, convex = CASES[label]
    parts, options = task(name, target).parts, Options(convex=convex)
    if polish:
        linear, before, _ = kept(parts, options)
        _, after, how = kept(parts, replace(options, polish=True))
        return [label, linear, *before, *after, how]
    began = time.process_time()
    plain = design(*parts, options)
    certificate = certify(plain)
    linear, before = cells(plain, certificate, time.process_time() - began)
    _, after, how = kept(parts, options)
    return [label, linear, *before, *after, how]


def kept(parts: Sequence[Any], options: Options) -> tuple[str, list[str], str]:
    """LQR's ratio, the cells of the design that is kept, and what it is."""
    began = time.process_time()
    choice = choose(*parts, options)
    linear, found = cells(choice.design, choice.certificate, time.process_time() - began)
    names = [choice.kept.name]
    if choice.kept.name == "polished":
        names.insert(0, choice.others[-1].name)
    return linear, found, ", ".join(names)


def main(arguments: list[str]) -> None:
    """Print the table."""
    chosen = [word for word in arguments if word != "--polish"]
    print("| " + " | ".join(HEADER) + " |")
    print("|" + "---|" * len(HEADER))
    for label in CASES:
        if not chosen or any(word in label for word in chosen):
            print("| " + " | ".join(row(label, "--polish" in arguments)) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
