"""Attack on what is proved of the sampled loop: starts of the region, random periods, compiled C.

    python benchmarks/sampled.py [--starts 10000] [--period 0.05] [--limit U] [--only NAME;…]

The plant comes from the model file alone, the controller is ``necc_step`` of the exported C code; u
is held, and the plant is followed by a fixed-step Runge–Kutta method written here. Half
of the starts are in the upper tenth of the level. Periods are of five kinds: the longest, uniform,
mostly short, and short (1e-3 or 1e-9 of the longest) or long by chance. Counted are samples at
which u is clipped, of those that are looked at, and at which W rises, starts that leave the region,
at a sample or where it is seen at a random time between two (x there with ξ as far advanced: x is
in the projection), or the box between two samples, and those that are not near z̄ in the end.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi import Design, choose, load_model
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.prover.certify import certify, with_sampled_loop
from necc_casadi.export.c_project import export_c
from necc_casadi.export.sampled_loop import largest_stable_time
from necc_casadi.methods.find import find_method
from necc_casadi.model.model_file import Model
from necc_casadi.model.target import parse_target, target_from_model

EXAMPLES = Path(__file__).parent.parent / "examples"
TARGETS = {"pendulum": "pi/4"}
#: Steps of the plant in one sample; samples at which W is looked at; of those that are followed.
INNER, LOOKED, FOLLOWED = 16, 200, 200
#: Kinds of periods.
KINDS = 5
LOOP = """
#include <math.h>
#include "necc.h"
#define N (NECC_NX + NECC_NXI)
static void plant(const double *x, const necc_real *u, double *xdot) {
@plant@
}
long sample(int count, double *z, const double *periods, double *lo, double *hi) {
    long clipped = 0;
    for (int row = 0; row < count; row++) {
        double *s = z + (long)row * N, h = periods[row] / @inner@;
        double k[4][NECC_NX], w[NECC_NX];
        necc_real x[NECC_NX], u[NECC_NU], no[NECC_NU];
        necc_state state;
        necc_init(&state);
        for (int i = 0; i < NECC_NX; i++) x[i] = (necc_real)s[i];
        for (int i = 0; i < NECC_NXI; i++) state.xi[i] = (necc_real)s[NECC_NX + i];
        clipped += (necc_step(&state, x, u, 0) & NECC_SATURATED) != 0;
        for (int step = 0; step < @inner@; step++) {
            for (int stage = 0; stage < 4; stage++) {
                double part = stage == 0 ? 0.0 : stage == 3 ? h : h / 2;
                for (int i = 0; i < NECC_NX; i++)
                    w[i] = stage ? s[i] + part * k[stage - 1][i] : s[i];
                plant(w, u, k[stage]);
            }
            for (int i = 0; i < NECC_NX; i++) {
                s[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
                lo[(long)row * NECC_NX + i] = fmin(lo[(long)row * NECC_NX + i], s[i]);
                hi[(long)row * NECC_NX + i] = fmax(hi[(long)row * NECC_NX + i], s[i]);
            }
        }
        for (int i = 0; i < NECC_NX; i++) x[i] = (necc_real)s[i];
        necc_step(&state, x, no, (necc_real)periods[row]);
        for (int i = 0; i < NECC_NXI; i++) s[NECC_NX + i] = state.xi[i];
    }
    return clipped;
}
"""


def compiled(model: Model, made: Design, folder: Path, real: str, **options: Any) -> ctypes.CDLL:
    """One sample of the loop as a shared library; `options` of the export."""
    plant = model.system
    u = sp.symbols(f"u:{plant.m}", real=True)
    slope = plant.drift + plant.directions * sp.Matrix(u)
    names = {s: sp.Symbol(f"x[{i}]") for i, s in enumerate(plant.x)}
    names |= {v: sp.Symbol(f"u[{k}]") for k, v in enumerate(u)}
    lines = [f"    xdot[{i}] = {sp.ccode(e.xreplace(names))};" for i, e in enumerate(slope)]
    export_c(made, folder, real=real, measured=False, **options)
    text = LOOP.replace("@plant@", "\n".join(lines)).replace("@inner@", str(INNER))
    (folder / "loop.c").write_text(text, encoding="utf-8")
    command = ["gcc", "-O2", "-shared", "-fPIC", "-std=c99", "-o", "loop.so", "loop.c", "necc.c"]
    subprocess.run([*command, "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "loop.so"))
    library.sample.restype = ctypes.c_long
    return library


class Lyapunov:
    """W in the units of the model."""

    def __init__(self, made: Design, certificate: Certificate, region: SampledRegion) -> None:
        self.made, unit, energy = made, made.units.state, made.units.energy
        self.Q = np.array(region.metric) * np.outer(unit, unit) / energy
        self.level = region.level * energy
        self.lo, self.hi = np.array(region.box).T * unit

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """At states (B, N)."""
        g = self.made.lyapunov.gradient(z)
        return self.made.lyapunov.V(z) + np.einsum("bi,ij,bj->b", g, self.Q, g) / 2


def drawn(W: Lyapunov, count: int, rng: np.random.Generator) -> np.ndarray:
    """Starts of the region, half of them in the upper tenth."""
    bottom, found = W.made.V(W.made.z_bar), [np.empty((0, len(W.lo)))] * 2
    for _ in range(20_000):
        z = rng.uniform(W.lo, W.hi, (4096, len(W.lo)))
        share = (W(z) - bottom) / (W.level - bottom)
        high, low = z[(share < 1) & (share > 0.9)], z[share < 1]
        found = [np.vstack([a, b])[: count // 2] for a, b in zip(found, (high, low), strict=True)]
        if all(len(part) == count // 2 for part in found):
            break
    return np.vstack(found)


def periods(longest: float, count: int, kind: int, rng: np.random.Generator) -> np.ndarray:
    """Periods of one sample."""
    x = rng.uniform(size=count)
    shares = (np.ones(count), 1 - x, (1 - x) ** 6, np.where(x < 0.5, 1e-3, 1.0))
    shares += (np.where(x < 0.5, 1e-9, 1.0),)
    return longest * shares[kind]


def attacked(name: str, period: float, count: int, real: str, limit: float | None) -> list[str]:
    """One row of the table."""
    name, _, target = name.partition("@")
    model = load_model(EXAMPLES / f"{name}.py")
    plant, target = model.system, target or TARGETS.get(name)
    x = parse_target(plant, target) if target else target_from_model(plant, model.target)
    method = find_method(model, x).chosen
    if method is None:
        return [name, "refused"]
    choice = choose(method.loop, method.casimirs, method.verdict, x)
    made, plain = choice.design, choice.certificate
    if limit is not None:
        bounded = replace(made.loop.plant, u_limits=((-limit, limit),) * made.loop.plant.m)
        made = replace(made, loop=replace(made.loop, plant=bounded))
        plain = certify(made)
    began = time.perf_counter()
    certificate = with_sampled_loop(made, plain, period, "heun")
    proved = time.perf_counter() - began
    region = certificate.sampled
    if region is None:
        (why,) = [c.statement for c in certificate.claims if c.name == "sampled"]
        return [name, f"{period:g}", why]
    with tempfile.TemporaryDirectory() as folder:
        made.save(Path(folder) / "design.json")
        (Path(folder) / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
        began = time.perf_counter()
        holds = all(result.holds for result in check(Path(folder)))
        checked = time.perf_counter() - began
        W, rng = Lyapunov(made, certificate, region), np.random.default_rng(0)
        library, longest = (
            compiled(model, made, Path(folder), real),
            region.period * made.units.time,
        )
        starts = drawn(W, count, rng)
        clipped, rises, left, late = attack(library, W, starts, longest, rng, made)
    local = largest_stable_time(made)
    return [
        name, f"{longest:.3g}", "–" if local is None else f"{local:.3g}",
        f"{region.height * made.units.energy:.4g}", f"{proved:.1f}", f"{checked:.1f}",
        "yes" if holds else "NO", str(len(starts)), str(clipped), str(rises), str(left), str(late),
    ]  # fmt: skip


def attack(
    library: ctypes.CDLL,
    W: Lyapunov,
    starts: np.ndarray,
    longest: float,
    rng: np.random.Generator,
    made: Design,
) -> tuple[int, int, int, int]:
    """Samples at which u is clipped and W rises, starts that leave the box and do not arrive."""
    pointer, n = ctypes.POINTER(ctypes.c_double), made.loop.plant.n
    kind = np.arange(len(starts)) % KINDS
    z = np.ascontiguousarray(starts)
    lo, hi = (np.ascontiguousarray(z[:, :n].copy()) for _ in range(2))

    def drawn_periods() -> np.ndarray:
        s = np.empty(len(z))
        for k in range(KINDS):
            s[kind == k] = periods(longest, int((kind == k).sum()), k, rng)
        return s

    def advance(z: np.ndarray, s: np.ndarray) -> int:
        arrays = [np.ascontiguousarray(v) for v in (s, lo, hi)]
        at = z.ctypes.data_as(pointer)
        return int(library.sample(len(z), at, *[v.ctypes.data_as(pointer) for v in arrays]))

    before, rises, clipped = W(z), 0, 0
    slack = 1e-12 * max(1.0, float(np.abs(before).max()))
    out = np.zeros(len(z), dtype=bool)
    for _ in range(LOOKED):
        s = drawn_periods()
        between = z.copy()
        advance(between, s * rng.uniform(size=len(s)))
        clipped += advance(z, s)
        after = W(z)
        rises += int((after > before + slack).sum())
        for seen, value in ((between, W(between)), (z, after)):
            out |= (value > np.minimum(before + slack, W.level)) | (
                (seen < W.lo) | (seen > W.hi)
            ).any(1)
        before = after
    left = int((out | ((lo < W.lo[:n]) | (hi > W.hi[:n])).any(1)).sum())
    slow = float(np.min(np.abs(made.spectrum.real)))
    for _ in range(int(min(FOLLOWED / slow / longest, 50_000))):
        advance(z, drawn_periods())
    away = np.abs((z - made.z_bar) / made.sizes.state).max(1)
    return clipped, rises, left, int((away > 0.01).sum())


def main() -> None:
    """Attack and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=10_000)
    parser.add_argument("--period", type=float, default=0.05)
    parser.add_argument("--limit", type=float, help="|u| at most, of every input")
    parser.add_argument("--real", default="double", choices=["double", "float"])
    parser.add_argument("--only", default="pendulum")
    given = parser.parse_args()
    print(
        "| plant | T, s | local limit, s | W − V(z̄) | proved, s | checked, s | holds | starts "
        "| clipped | rises | outside | late |\n|" + "---|" * 12
    )
    for name in given.only.split(";"):
        row = attacked(name, given.period, given.starts, given.real, given.limit)
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
