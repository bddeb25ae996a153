"""Attack on what is proved: many states of every claimed region, followed by an outside integrator.

    python benchmarks/attack.py [--states 10000] [--only NAME[@TARGET];…]

The plant comes from the model file alone, the controller from the exported C code, both compiled
and stepped by a fixed-step Runge–Kutta method that is written here. Three quarters of the states
are in the upper tenth of the level. Counted are states from which V rises, that leave the claimed
reach, or that are not near the target in the end though they were claimed to converge. Where the
whole space is claimed, states are drawn from three times the domain.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import sympy as sp

from necc_casadi import Certificate, Design, choose, load_model
from necc_casadi.export.c_project import export_c
from necc_casadi.methods.find import find_method
from necc_casadi.model.model_file import Model
from necc_casadi.model.target import parse_target, target_from_model

EXAMPLES = Path(__file__).parent.parent / "examples"
TARGETS = {"pendulum": "pi/4"}
CHECKPOINTS = 60
#: Further horizons for those that are not near the target.
LONGER = 20
LOOP = """
#define _GNU_SOURCE
#include <math.h>
#include <string.h>
#include "necc.h"
#define N (NECC_NX + NECC_NXI)
static void plant(const double *x, const double *u, double *xdot) {
@plant@
}
static void measured(const double *x, double *y) {
@measured@
}
static void field(const double *z, double *slope) {
    double u[NECC_NU], y[NECC_NX];
    measured(z, y);
#ifdef LIMITED /* as the code keeps the limits of u */
    necc_state s;
    necc_init(&s);
    memcpy(s.xi, z + NECC_NX, sizeof s.xi);
    necc_output(&s, y, u);
    memcpy(slope + NECC_NX, s.xidot, sizeof s.xidot);
#else
    necc_control(y, z + NECC_NX, u, slope + NECC_NX);
#endif
    plant(z, u, slope);
}
void follow(int count, double *z, long steps, double dt, int kept, double *out) {
    for (int row = 0; row < count; row++) {
        double *s = z + (long)row * N, k1[N], k2[N], k3[N], k4[N], w[N];
        for (long step = 0; step < steps; step++) {
            if (step % (steps / kept) == 0 && step / (steps / kept) < kept)
                memcpy(out + ((long)row * kept + step / (steps / kept)) * N, s, sizeof w);
            field(s, k1);
            for (int i = 0; i < N; i++) w[i] = s[i] + dt / 2 * k1[i];
            field(w, k2);
            for (int i = 0; i < N; i++) w[i] = s[i] + dt / 2 * k2[i];
            field(w, k3);
            for (int i = 0; i < N; i++) w[i] = s[i] + dt * k3[i];
            field(w, k4);
            for (int i = 0; i < N; i++) s[i] += dt / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
        }
    }
}
"""


def compiled(model: Model, made: Design, folder: Path, limited: bool) -> ctypes.CDLL:
    """The closed loop as a shared library."""
    plant = model.system
    u = sp.symbols(f"u:{plant.m}", real=True)
    slope = plant.drift + plant.directions * sp.Matrix(u)
    names = {s: sp.Symbol(f"x[{i}]") for i, s in enumerate(plant.x)}
    names |= {v: sp.Symbol(f"u[{k}]") for k, v in enumerate(u)}
    lines = [f"    xdot[{i}] = {sp.ccode(e.xreplace(names))};" for i, e in enumerate(slope)]
    seen = list(plant.x)  # or (q, q̇), where the controller takes velocities
    if made.measurement.of_velocities:
        seen[len(seen) // 2 :] = plant.drift[: len(seen) // 2]
    shown = [f"    y[{i}] = {sp.ccode(e.xreplace(names))};" for i, e in enumerate(seen)]
    export_c(made, folder)
    text = LOOP.replace("@plant@", "\n".join(lines))
    text = text.replace("@measured@", "\n".join(shown))
    (folder / "loop.c").write_text(
        "#define _GNU_SOURCE\n#include <math.h>\n" + text, encoding="utf-8"
    )
    library = folder / "loop.so"
    command = [
        "gcc",
        *["-DLIMITED"] * limited,
        "-O3",
        "-shared",
        "-fPIC",
        "-std=c99",
        "-o",
        library,
        "loop.c",
        "necc.c",
    ]
    subprocess.run([*command, "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(library))


def drawn(made: Design, certificate: Certificate, count: int, top: float) -> np.ndarray:
    """States of the region below a level, or of three times the domain, (count, N)."""
    rng, region = np.random.default_rng(0), certificate.region
    z_bar, n = made.z_bar, len(made.z_bar)
    if region is None:
        half = 3 * (made.domain.hi - made.domain.lo) / 2
        return z_bar + rng.uniform(-half, half, (count, n))
    sides = [
        (z_bar[i] - np.pi, z_bar[i] + np.pi) if side is None else side
        for i, side in enumerate((certificate.reach or {}).values())
    ]
    lo, hi = np.array(sides).T
    bottom = made.V(z_bar)
    found: list[np.ndarray] = []
    for _ in range(4000):
        z = z_bar + rng.uniform(0, 1, (4096, 1)) ** (1 / n) * (
            rng.uniform(lo, hi, (4096, n)) - z_bar
        )
        share = (made.lyapunov.V(z) - bottom) / (top - bottom)
        high = (share <= 1) & ((share > 0.9) | (rng.uniform(size=4096) < 0.02))
        for row in z[high]:
            if certificate.contains(made.V, row):
                found.append(row)
        if len(found) >= count:
            break
    return np.array(found[:count])


def far_from(made: Design, starts: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Which states (B, N) are not much nearer to z̄ than their starts."""
    away, before = (np.abs((v - made.z_bar) / made.sizes.state).max(1) for v in (z, starts))
    return np.asarray(away > 0.05 * np.maximum(before, 1))


def kept(made: Design, states: np.ndarray, sign: int) -> np.ndarray:
    """(x, ξ) from what the code keeps, (x, ξ − γ(x)), for sign 1; and back for −1."""
    rows = states.reshape(-1, states.shape[-1]).copy()
    n = made.loop.plant.n
    rows[:, n:] += sign * made.lyapunov.gamma(rows[:, :n])
    return rows.reshape(states.shape)


def attacked(name: str, count: int) -> list[str]:
    """One row of the table."""
    model = load_model(EXAMPLES / f"{name.partition('@')[0]}.py")
    name, _, target = name.partition("@")
    plant, target = model.system, target or TARGETS.get(name)
    x = parse_target(plant, target) if target else target_from_model(plant, model.target)
    method = find_method(model, x).chosen
    if method is None:
        return [name, "refused", *["–"] * 6]
    choice = choose(method.loop, method.casimirs, method.verdict, x)
    return row_of(name, model, choice.design, choice.certificate, count)


def row_of(
    name: str, model: Model, made: Design, certificate: Certificate, count: int
) -> list[str]:
    """One row of the table, of a design that is there."""
    follows = [
        c.data.get("follows")
        for c in certificate.claims
        if c.name in ("region", "global") and c.holds
    ]
    anywhere = any(c.name == "clipping" and c.data.get("everywhere") for c in certificate.claims)
    limited = anywhere or certificate.level_clipped is not None
    top = certificate.level_clipped or certificate.level or 0.0
    starts = drawn(made, certificate, count, top)
    rates = np.abs(made.spectrum)
    slow = float(np.min(np.abs(made.spectrum.real)))
    dt, horizon = 0.05 / rates.max(), 15 / slow
    steps = int(np.clip(np.ceil(horizon / dt), CHECKPOINTS, 30_000))
    steps -= steps % CHECKPOINTS
    with tempfile.TemporaryDirectory() as folder:
        library = compiled(model, made, Path(folder), limited)
        z = np.ascontiguousarray(kept(made, starts, -1))
        out = np.empty((len(z), CHECKPOINTS, z.shape[1]))
        pointer = ctypes.POINTER(ctypes.c_double)
        library.follow(
            len(z), z.ctypes.data_as(pointer), ctypes.c_long(steps), ctypes.c_double(dt),
            CHECKPOINTS, out.ctypes.data_as(pointer),
        )  # fmt: skip
        for _ in range(LONGER if "converges" in follows else 0):  # a valley of V may be flat
            slow_ones = np.flatnonzero(far_from(made, starts, kept(made, z, 1)))
            if not slow_ones.size:
                break
            again, more = np.ascontiguousarray(z[slow_ones]), out[: len(slow_ones)].copy()
            library.follow(
                len(again), again.ctypes.data_as(pointer), ctypes.c_long(steps),
                ctypes.c_double(dt), CHECKPOINTS, more.ctypes.data_as(pointer),
            )  # fmt: skip
            z[slow_ones] = again
    out, z = kept(made, out, 1), kept(made, z, 1)
    V = made.lyapunov.V(out.reshape(-1, z.shape[1])).reshape(len(z), -1)
    height = np.maximum(V[:, :1] - made.V(made.z_bar), 1e-300)
    rises = int((np.diff(V, axis=1) > 1e-7 * height).any(1).sum())
    left = 0
    if certificate.region is not None:
        for i, side in enumerate((certificate.reach or {}).values()):
            if side is not None:
                slack = 1e-9 * (side[1] - side[0])
                beyond = (out[:, :, i] < side[0] - slack) | (out[:, :, i] > side[1] + slack)
                left += int(beyond.any(1).sum())
    late = int(far_from(made, starts, z).sum())
    claim = "global" if certificate.is_global else "/".join(str(f) for f in follows)
    kind = ("scaled" if made.scales_damping else "clipped") if limited else "–"
    return [name, claim, kind, *map(str, (len(z), rises, left, late)), f"{steps}"]


def main() -> None:
    """Attack every example and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--states", type=int, default=10_000)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    names = given.only.split(";") if given.only else sorted(p.stem for p in EXAMPLES.glob("*.py"))
    print(
        "| plant | claim | inputs | states | V rises | leave reach | not near the target | steps |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in names:
        print("| " + " | ".join(attacked(name, given.states)) + " |", flush=True)


if __name__ == "__main__":
    main()
