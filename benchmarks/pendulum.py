"""The paper's pendulum, side by side in one run: training, and what the controllers do.

    python benchmarks/pendulum.py [--seeds N] [--epochs N]

Prints Markdown tables. Needs the extra ``bench`` (torch) and scipy; nothing is timed against a
stored figure, everything runs here. A column "reference" carries figures measured on another
machine, as a sanity check only.
"""

from __future__ import annotations

import argparse
import platform
import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from authors_method import train as train_authors
from baseline import LoopMetrics, closed_loop_metrics, quadratic

from necc_casadi import (
    Design,
    Options,
    certify,
    design,
    find_casimirs,
    judge,
    load_model,
    paper_options,
    parse_target,
)
from necc_casadi.export.compiled import compile_controller
from necc_casadi.simulation.responses import random_states

MODEL = Path(__file__).parent.parent / "examples" / "pendulum.py"
SIZES = {"64 / 32": ((64,), (32,)), "64-64 / 32-32": ((64, 64), (32, 32))}
REFERENCE = {"64 / 32": "46 s, 2.4e-3", "64-64 / 32-32": "70 s, 5.0e-3"}
HORIZON = 40.0
STARTS = 10


def main() -> None:
    """Run both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20, help="seeds 0 … N-1 of our designs")
    parser.add_argument("--epochs", type=int, default=2000, help="epochs of the authors' method")
    arguments = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, {platform.python_version()}\n")
    make = designer()
    training_table(make, arguments.seeds, arguments.epochs)
    control_table(make, arguments.seeds)


def designer() -> Callable[[Options], Design]:
    """options -> Design for the pendulum at π/4."""
    model = load_model(MODEL)
    x_star = parse_target(model.loop.plant, "pi/4")
    casimirs = find_casimirs(model.loop)
    verdict = judge(model.loop, casimirs, x_star)
    return lambda options: design(model.loop, casimirs, verdict, x_star, options)


def _forms(hidden: tuple[tuple[int, ...], tuple[int, ...]], seed: int) -> dict[str, Options]:
    sizes = {"hidden_k": hidden[0], "hidden_h": hidden[1], "seed": seed}
    return {
        "`--paper`": replace(paper_options(1), **sizes),
        "default form": replace(Options(), **sizes),
    }


def training_table(make: Callable[[Options], Design], seeds: int, epochs: int) -> None:
    """Time, ε and distance of the authors' method and of both our forms."""
    print("| networks | method | seconds | ratio | ε | ‖z̄ − z*‖ | reference |")
    print("|---|---|---|---|---|---|---|")
    for size, hidden in SIZES.items():
        times = {}
        for recipe in ("separate", "shared"):
            result = train_authors(*hidden, seed=0, epochs=epochs, recipe=recipe)
            times[recipe] = result.seconds
            note = REFERENCE[size] if recipe == "separate" else ""
            print(
                f"| {size} | authors' method, {recipe} | {result.seconds:.1f} | 1 | "
                f"{result.loss:.1e} | {_shown(result.distance)} | {note} |",
                flush=True,
            )
        for form in _forms(hidden, 0):
            made = [make(_forms(hidden, seed)[form]) for seed in range(seeds)]
            seconds = statistics.median(sum(s.seconds for s in d.starts) for d in made)
            losses = [max(s.loss for s in d.starts) for d in made]
            bounds = [certify(d, region=False).bound_rigorous for d in made]
            worst = max(np.inf if b is None else b for b in bounds)
            print(
                f"| {size} | {form}, {seeds} seeds | {seconds:.3f} (median) | "
                f"{times['separate'] / seconds:.0f} / {times['shared'] / seconds:.0f} | "
                f"≤ {max(losses):.1e} | proved ≤ {worst:.1e} | |",
                flush=True,
            )
    print()


def _shown(value: float | None) -> str:
    return "none found" if value is None else f"{value:.1e}"


def control_table(make: Callable[[Options], Design], seeds: int) -> None:
    """Settling time and effort from the same initial states, over seeds."""
    hidden = SIZES["64 / 32"]
    first = make(_forms(hidden, 0)["default form"])
    x0s = random_states(first, STARTS, seed=0)
    rows: dict[str, list[LoopMetrics]] = {}
    for seed in range(seeds):
        for form, options in _forms(hidden, seed).items():
            rows.setdefault(form, []).extend(_responses(make(options), x0s))
    gains = (float(first.D[0, 0]), float(first.Dc[0, 0]))
    for label, damping in (("D = 5, Dc = 6", (5.0, 6.0)), ("our D and Dc", gains)):
        for curvature in (None, 2.5):
            plain = quadratic(
                np.pi / 4, damping=damping[0], controller_damping=damping[1], curvature=curvature
            )
            name = "least curvature" if curvature is None else f"curvature {curvature}"
            xi0s = [np.array([plain.xi_star])] * len(x0s)
            rows[f"quadratic baseline, {name}, {label}"] = closed_loop_metrics(
                plain.control, plain.xi_dot, plain.xi_star, np.pi / 4, x0s, xi0s, HORIZON
            )
    print("| controller | settling time [s] | peak \\|u\\| | ∫u² | ∫(u − u*)² |")
    print("|---|---|---|---|---|")
    for name, metrics in rows.items():
        print(
            f"| {name} | {_median(m.settling_time for m in metrics)} | "
            f"{_median(m.peak_input for m in metrics)} | "
            f"{_median(m.input_energy for m in metrics)} | "
            f"{_median(m.excess_energy for m in metrics)} |"
        )
    print(f"\nMedians over {STARTS} initial states (and seeds), horizon {HORIZON:g} s, ξ(0) = ξ*.")


def _responses(made: Design, x0s: Sequence[np.ndarray]) -> list[LoopMetrics]:
    law = compile_controller(made)  # the exported C, called from Python: the quickest route

    def u(x: np.ndarray, xi: np.ndarray) -> np.ndarray:
        return law.control(x, xi)[0]

    def xi_dot(x: np.ndarray, xi: np.ndarray) -> np.ndarray:
        return law.control(x, xi)[1]

    xi = made.xi_star
    return closed_loop_metrics(u, xi_dot, float(xi[0]), np.pi / 4, x0s, [xi] * len(x0s), HORIZON)


def _median(values: Sequence[float]) -> str:
    numbers = sorted(values)
    return f"{statistics.median(numbers):.3g} (max {numbers[-1]:.3g})"


if __name__ == "__main__":
    main()
