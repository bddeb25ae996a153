"""How each step from model to certificate grows with the number of states.

    python benchmarks/scale.py [--repeats N] [--masses N,N,…]

Chains of N masses (n = 2N states) with one and two inputs, and an LC ladder of 40 states. Prints
Markdown tables of median seconds and, for the chains, the exponent of each step in n, fitted by
least squares on logarithms over all sizes and over the two largest ones.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
import sympy as sp

from necc_casadi import (
    ClosedLoop,
    Options,
    certify,
    design,
    find_casimirs,
    interconnect,
    judge,
    make_plant,
    simulate,
)
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.lyapunov import LyapunovFunction, make_terms
from necc_casadi.model.controller import default_controller
from necc_casadi.simulation.responses import random_states
from necc_casadi.synthesis.damping import choose_damping

T = TypeVar("T")
STEPS = ("plant", "Casimirs", "verdict", "training", "damping", "certificate", "response")
#: Steps before the verdict is known, and steps of a design, for the two goals.
JUDGED, DESIGNED = STEPS[:3], STEPS[:6]
GOALS = {"judged": 10.0, "designed": 60.0}


@dataclass(frozen=True)
class Case:
    """A plant's raw data and a target of it."""

    name: str
    x: tuple[sp.Symbol, ...]
    J: sp.Matrix
    R: sp.Matrix
    G: sp.Matrix
    H: sp.Expr
    x_star: Mapping[sp.Symbol, sp.Expr]


def chain(masses: int, inputs: int) -> Case:
    """examples/mass_spring_chain.py with N masses; the second input is a force on the last one."""
    N, damper = masses, sp.Rational(1, 5)
    q = sp.symbols(f"q1:{N + 1}", real=True)
    p = sp.symbols(f"p1:{N + 1}", real=True)
    J = sp.zeros(2 * N, 2 * N)
    J[:N, N:], J[N:, :N] = sp.eye(N), -sp.eye(N)
    driven = (N, 2 * N - 1)[:inputs]
    springs = sum((b - a) ** 2 for a, b in pairwise(q)) + q[-1] ** 2
    H = (sum(v**2 for v in p) + springs) / 2
    at_rest = {q[i]: sp.Rational(N - i, N) for i in range(N)} | dict.fromkeys(p, sp.Integer(0))
    return Case(
        name=f"chain, {inputs} input{'s' * (inputs > 1)}",
        x=(*q, *p),
        J=J,
        R=sp.diag(sp.zeros(N, N), damper * sp.eye(N)),
        G=sp.Matrix(2 * N, inputs, lambda i, j: int(i == driven[j])),
        H=H,
        x_star=at_rest,
    )


def ladder(states: int) -> Case:
    """LC ladder with open end and a voltage source: flux, charge, flux, charge, …"""
    z = sp.symbols(f"z1:{states + 1}", real=True)
    J = sp.Matrix(states, states, lambda i, j: int(i == j + 1) - int(j == i + 1))
    charges = z[1::2]
    return Case(
        name="LC ladder",
        x=z,
        J=J,
        R=sp.zeros(states, states),
        G=sp.Matrix(states, 1, lambda i, _: int(i == 0)),
        H=sum(v**2 for v in z) / 2,
        x_star={v: sp.Integer(int(v in charges)) for v in z},
    )


def timed(seconds: dict[str, float], step: str, action: Callable[[], T]) -> T:
    """Run one step and note its time."""
    began = time.perf_counter()
    result = action()
    seconds[step] = time.perf_counter() - began
    return result


def run(case: Case) -> dict[str, float]:
    """Seconds of each step; raises where the case does not end in a proof."""
    sp.core.cache.clear_cache()
    seconds: dict[str, float] = {}

    def build() -> ClosedLoop:
        plant = make_plant(case.x, case.J, case.R, case.G, case.H, name=case.name)
        return interconnect(plant, default_controller(plant))

    loop = timed(seconds, "plant", build)
    casimirs = timed(seconds, "Casimirs", lambda: find_casimirs(loop, (), case.x_star))
    verdict = timed(seconds, "verdict", lambda: judge(loop, casimirs, case.x_star))
    unit = np.eye(loop.plant.m)
    options = Options(D=unit, Dc=unit)
    made = timed(seconds, "training", lambda: design(loop, casimirs, verdict, case.x_star, options))

    def damp() -> tuple[np.ndarray, np.ndarray]:
        terms = make_terms(loop, casimirs)
        V = LyapunovFunction(terms, made.form, made.weights, uncoupled(unit, unit))
        return choose_damping(V, loop, made.z_star)

    D, Dc = timed(seconds, "damping", damp)
    damped = type(made).from_text(replace(made, damping=uncoupled(D, Dc)).text)
    certificate = timed(seconds, "certificate", lambda: certify(damped, region=False))
    x0 = random_states(damped, 1)[0]
    timed(seconds, "response", lambda: simulate(damped, x0))
    if not certificate.certified:
        unproved = [claim.statement for claim in certificate.claims if not claim.holds]
        raise RuntimeError(f"{case.name}, n = {len(case.x)}: {unproved}")
    return seconds


def medians(case: Case, repeats: int) -> dict[str, float]:
    """Median seconds of each step and of the two totals."""
    runs = [run(case) for _ in range(repeats)]
    result = {step: statistics.median(r[step] for r in runs) for step in STEPS}
    result["judged"] = statistics.median(sum(r[s] for s in JUDGED) for r in runs)
    result["designed"] = statistics.median(sum(r[s] for s in DESIGNED) for r in runs)
    return result


def row(label: str, n: int | str, values: Mapping[str, float], digits: str) -> str:
    """One line of the table."""
    cells = [format(values[key], digits) for key in (*STEPS, "judged", "designed")]
    return f"| {label} | {n} | {' | '.join(cells)} |"


def exponents(sizes: list[int], table: list[dict[str, float]]) -> dict[str, float]:
    """Slope of log(seconds) in log(n) for each column."""
    return {
        key: float(np.polyfit(np.log(sizes), np.log([v[key] for v in table]), 1)[0])
        for key in table[0]
    }


def main() -> None:
    """Run all cases and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3, help="runs per case")
    parser.add_argument("--masses", default="5,10,20,50", help="lengths of the chains")
    arguments = parser.parse_args()
    masses = [int(text) for text in arguments.masses.split(",")]
    machine = platform.processor() or platform.machine()
    print(f"{machine}, {os.cpu_count()} cores, Python {platform.python_version()}; median of "
          f"{arguments.repeats} runs, seconds\n")  # fmt: skip
    print(f"| plant | n | {' | '.join(STEPS)} | **judged** | **designed** |")
    print("|---" * (len(STEPS) + 4) + "|", flush=True)
    largest: dict[str, float] = {}
    for inputs in (1, 2):
        table = []
        for count in masses:
            case = chain(count, inputs)
            table.append(medians(case, arguments.repeats))
            print(row(case.name, 2 * count, table[-1], ".3f"), flush=True)
        largest = {key: max(table[-1][key], largest.get(key, 0.0)) for key in GOALS}
        sizes = [2 * count for count in masses]
        print(row("exponent", "all", exponents(sizes, table), ".1f"))
        print(row("exponent", "last two", exponents(sizes[-2:], table[-2:]), ".1f"), flush=True)
    case = ladder(40)
    print(row(case.name, 40, medians(case, arguments.repeats), ".3f"))
    print(f"\nSlowest chain of n = {2 * masses[-1]}: "
          + ", ".join(f"{key} in {largest[key]:.1f} s (goal {goal:g} s)"
                      for key, goal in GOALS.items()))  # fmt: skip


if __name__ == "__main__":
    main()
