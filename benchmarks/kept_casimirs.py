"""Casimirs kept against Heun's method: V from sample to sample, settling, local limit.

    python benchmarks/kept_casimirs.py [--starts N] [--time S]

Plain default designs of the pendulum at π/4 and of the two-link arm, compiled C, x from the middle
half of the domain, ξ where the design starts it, constant periods, the plant by a fixed-step
Runge–Kutta method. *Rising* are samples at which V rises by more than 1e-9 of the largest V at the
start, *settling* is the median time until |z − z̄|, in sizes, stays within 2 % of its first value,
*arrive* those within 0.1 % in the end.
"""

from __future__ import annotations

import argparse
import ctypes
import tempfile
from pathlib import Path

import numpy as np
from sampled import EXAMPLES, compiled

from necc_casadi import Design, design, find_casimirs, judge, load_model, parse_target
from necc_casadi.cases import Integrator
from necc_casadi.export.kept_casimirs import kept_casimirs
from necc_casadi.export.sampled_loop import largest_stable_time
from necc_casadi.model.model_file import Model
from necc_casadi.model.target import target_from_model

CASES = {
    "pendulum": ("pi/4", (0.05, 0.1, 0.4, 0.8, 1.1, 1.5)),
    "two_link_arm": (None, (0.05, 0.1, 0.2, 0.25, 0.3)),
}
SCHEMES: tuple[Integrator, ...] = ("heun", "casimir")


def made_of(name: str, target: str | None) -> tuple[Model, Design]:
    """Model and plain default design."""
    model = load_model(EXAMPLES / f"{name}.py")
    plant = model.loop.plant
    x = parse_target(plant, target) if target else target_from_model(plant, model.target)
    casimirs = find_casimirs(model.loop)
    return model, design(model.loop, casimirs, judge(model.loop, casimirs, x), x)


def run(
    library: ctypes.CDLL, made: Design, z: np.ndarray, period: float, time: float
) -> tuple[float, float, float, float]:
    """Shares of samples that rise and of starts that arrive, around largest rise and settling."""
    pointer, n = ctypes.POINTER(ctypes.c_double), made.loop.plant.n
    z, s = np.ascontiguousarray(z.copy()), np.full(len(z), period)
    reach = [np.ascontiguousarray(z[:, :n].copy()) for _ in range(2)]
    V, gaps = [made.lyapunov.V(z)], []
    for _ in range(int(time / period)):
        arrays = [v.ctypes.data_as(pointer) for v in (z, s, *reach)]
        library.sample(len(z), *arrays)
        with np.errstate(all="ignore"):
            V.append(made.lyapunov.V(z))
            gaps.append(np.linalg.norm((z - made.z_bar) / made.sizes.state, axis=1))
    first = gaps[0]
    near = np.array(gaps) <= 0.02 * first
    settled = [
        period * (1 + (np.flatnonzero(~row)[-1] + 1 if not row.all() else 0)) for row in near.T
    ]
    arrive = near[-1] & (gaps[-1] <= 1e-3 * first)
    rise = np.diff(np.array(V), axis=0)
    bottom = made.V(made.z_bar)
    count = rise > 1e-9 * (V[0].max() - bottom)
    median = float(np.median(np.where(near[-1], settled, np.inf)))
    return float(count.mean()), float(np.nanmax(rise)), median, float(arrive.mean())


def main() -> None:
    """One row per plant and period."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=150)
    parser.add_argument("--time", type=float, default=60.0)
    options = parser.parse_args()
    print("heun / casimir\n")
    print("| plant | T, s | steps | rising, % | largest rise | settling, s | arrive, % |")
    print("|---|---|---|---|---|---|---|")
    for name, (target, times) in CASES.items():
        model, made = made_of(name, target)
        limits = [f"{i} {largest_stable_time(made, i):.3f} s" for i in SCHEMES]
        n, rng = made.loop.plant.n, np.random.default_rng(0)
        lo, hi = made.domain.lo[:n], made.domain.hi[:n]
        x = rng.uniform(0.75 * lo + 0.25 * hi, 0.25 * lo + 0.75 * hi, (options.starts, n))
        z = np.array([[*v, *made.xi_at_start(v)] for v in x])
        for period in times:
            cells = []
            for scheme in SCHEMES:
                with tempfile.TemporaryDirectory() as folder:
                    library = compiled(
                        model, made, Path(folder), "double", integrator=scheme, sample_time=period
                    )
                    cells.append(run(library, made, z, period, options.time))
            shown = [
                f"{100 * a:.3g} / {100 * b:.3g}" if k in (0, 3) else f"{a:.2g} / {b:.2g}"
                for k, (a, b) in enumerate(zip(*cells, strict=True))
            ]
            steps = kept_casimirs(made).steps(period)
            print(f"| {name} | {period:g} | {steps} | " + " | ".join(shown) + " |", flush=True)
        print(f"| {name}, local limit: {', '.join(limits)} | | | | | | |", flush=True)


if __name__ == "__main__":
    main()
