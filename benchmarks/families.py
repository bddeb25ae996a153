"""Families, set-points at run time and integral action: what is proved, and attacks on it.

    python benchmarks/families.py [--rows 10000] [--samples 100000] [--only NAME]

Prints a Markdown table: seconds are CPU seconds of this process. Attacks go through the exported C
code, compiled; the plant is written from its Lagrange equations by sympy alone and stepped by a
Runge–Kutta method here, with u held over a sample. Counted are starts of a claimed set from which V
rises above the level, or that are not where the claim says in the end.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi import Certificate, Design, make_model, run
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.everywhere import prove_everywhere
from necc_casadi.certificate.prover.family import prove_family
from necc_casadi.certificate.prover.integral import prove_integral
from necc_casadi.certificate.prover.setpoints import prove_setpoints
from necc_casadi.designs.family import FAMILY_FILE, Family, lift
from necc_casadi.designs.plant_file import PLANT_FILE, plant_text
from necc_casadi.export.c_project import export_c
from necc_casadi.export.governor import Governor
from necc_casadi.export.level_set import level_set
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.model_file import Model
from necc_casadi.model.ranges import Ranges
from necc_casadi.simulation.perturbed import OtherPlants
from necc_casadi.synthesis.integral import with_integral

#: One call of the code at a time for each row of starts.
LOOP = """
#include <string.h>
#include <math.h>
#include "necc.h"
#define K (NECC_NX / 2)
static void plant(const double *y, const double *u, const double *p, double *rate) {
@plant@
}
static void sample(double *y, const double *u, const double *p, double dt) {
    double k1[NECC_NX], k2[NECC_NX], k3[NECC_NX], k4[NECC_NX], w[NECC_NX];
    plant(y, u, p, k1);
    for (int i = 0; i < NECC_NX; i++) w[i] = y[i] + dt / 2 * k1[i];
    plant(w, u, p, k2);
    for (int i = 0; i < NECC_NX; i++) w[i] = y[i] + dt / 2 * k2[i];
    plant(w, u, p, k3);
    for (int i = 0; i < NECC_NX; i++) w[i] = y[i] + dt * k3[i];
    plant(w, u, p, k4);
    for (int i = 0; i < NECC_NX; i++) y[i] += dt / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}
/* From each start (y, xi) with what the plant has, p = (theta, d): the margin at the start, the
 * least of all samples, and the coordinates in the end. */
void follow(int count, double *starts, const double *all, int width, const double *r,
            const double *told, long steps, double dt, double *out) {
    for (int row = 0; row < count; row++) {
        double *y = starts + (long)row * (NECC_NX + NECC_NXI), u[NECC_NU], least = 1, first = 1;
        const double *p = all + (long)row * width;
        double *o = out + (long)row * (2 + NECC_NX);
        necc_state s;
        necc_init(&s);
        memcpy(s.xi, y + NECC_NX, sizeof s.xi);
#if NECC_HAS_TARGET
        memcpy(s.r, r + row * K, sizeof s.r);
#endif
#if NECC_HAS_PARAMETER
        memcpy(s.theta, told + row * NECC_NTHETA, sizeof s.theta);
#endif
        (void)r, (void)told;
        for (long k = 0; k < steps; k++) {
            necc_step(&s, y, u, k ? dt : 0);
#if NECC_HAS_MARGIN
            double margin = necc_margin(&s, y);
            if (k == 0) {
                first = margin;
                if (!(margin > 0)) break;
            }
            least = margin < least ? margin : least;
#endif
            sample(y, u, p, dt);
        }
        o[0] = first;
        o[1] = least;
        memcpy(o + 2, y, NECC_NX * sizeof *y);
    }
}
/* From each start (y, xi): (y, xi) after every so many samples, u held over each. */
void trace(int count, double *starts, const double *all, int width, long times, long every,
           double dt, double *out) {
    const int wide = NECC_NX + NECC_NXI;
    for (int row = 0; row < count; row++) {
        double *y = starts + (long)row * wide, u[NECC_NU];
        const double *p = all + (long)row * width;
        necc_state s;
        necc_init(&s);
        memcpy(s.xi, y + NECC_NX, sizeof s.xi);
        for (long k = 0; k < times * every; k++) {
            double *o = out + ((long)row * times + k / every) * wide;
            necc_step(&s, y, u, k ? dt : 0);
            if (k % every == 0) {
                memcpy(o, y, NECC_NX * sizeof *y);
                memcpy(o + NECC_NX, s.xi, sizeof s.xi);
            }
            sample(y, u, p, dt);
        }
    }
}
#if NECC_HAS_PARAMETER
/* Commands, loads and switches of xi, a new one of each every so often: of each sample (y, xi, r,
 * theta) after it, the margin there, that before the command, and what became of the command. */
void govern(long samples, double *y, const double *commands, const double *loads, const int *how,
            long every, double dt, double *out) {
    double u[NECC_NU], p[NECC_NTHETA + NECC_NU] = {0};
    necc_state s;
    necc_start(&s, y);
    memcpy(p, s.theta, sizeof s.theta);
    for (long k = 0; k < samples; k++) {
        double *o = out + k * (NECC_NX + NECC_NXI + K + NECC_NTHETA + 3);
        necc_step(&s, y, u, k ? dt : 0);
        double before = necc_margin(&s, y);
        necc_set_switch(&s, how[k / every]);
        if (k % every == every / 2) { /* a load that the present is proved to stand */
            necc_state other = s;
            if (necc_set_parameter(&other, loads + k / every * NECC_NTHETA) == NECC_OK) {
                s = other;
                memcpy(p, s.theta, sizeof s.theta);
            }
        }
        int flags = necc_set_target(&s, y, commands + k / every * K);
        memcpy(o, y, NECC_NX * sizeof *y), o += NECC_NX;
        memcpy(o, s.xi, sizeof s.xi), o += NECC_NXI;
        memcpy(o, s.r, sizeof s.r), o += K;
        memcpy(o, s.theta, sizeof s.theta), o += NECC_NTHETA;
        o[0] = necc_margin(&s, y), o[1] = before, o[2] = flags;
        necc_step(&s, y, u, 0);
        sample(y, u, p, dt);
    }
}
#endif
"""


def pendulum() -> Model:
    """A pendulum with a mass and gravity that are not known, or told."""
    q, m, g = sp.symbols("q m g")
    return make_model(
        q=q, M=m, V=m * g * (1 - sp.cos(q)), B=1, friction=sp.Rational(1, 10),
        params={m: 1, g: 1}, target={q: sp.Rational(3, 2)}, name="pendulum",
    )  # fmt: skip


def arm() -> Model:
    """Two links of 1 kg and 1 m, and a payload at the tip."""
    q1, q2, mp, g = sp.symbols("q1 q2 mp g")
    both = mp * (1 + sp.cos(q2)) + sp.Rational(1, 3) + sp.cos(q2) / 2
    M = [[sp.Rational(5, 3) + sp.cos(q2) + 2 * mp * (1 + sp.cos(q2)), both],
         [both, sp.Rational(1, 3) + mp]]  # fmt: skip
    V = g * (sp.Rational(3, 2) + mp) * (1 - sp.cos(q1))
    V += g * (sp.Rational(1, 2) + mp) * (1 - sp.cos(q1 + q2))
    return make_model(
        q=(q1, q2), M=M, V=V, B=sp.eye(2), friction=sp.eye(2) / 5,
        params={mp: sp.Rational(1, 2), g: sp.Rational(981, 100)},
        target={q1: sp.pi / 4, q2: -sp.pi / 3}, name="arm",
    )  # fmt: skip


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and its CPU seconds."""
    began = time.process_time()
    return call(), time.process_time() - began


def designed(model: Model, **options: Any) -> tuple[Design, Certificate]:
    """Held in the whole space, where that is proved."""
    found = run(replace(model, ranges=Ranges()), convex=True, plots=False, **options)
    if found.design is None or found.certificate is None:
        raise SystemExit(f"{model.system.name}: {found.status}")
    return found.design, found.certificate


def saved(
    folder: Path, made: Design, certificate: Certificate, model: Model, family: Family | None = None
) -> Path:
    """A folder as necc-design writes it, the C code included."""
    made.save(folder / "design.json")
    (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    (folder / PLANT_FILE).write_text(plant_text(made, model.parametric), encoding="utf-8")
    if family is not None:
        family.save(folder / FAMILY_FILE)
    export_c(made, folder / "c", certificate=certificate, measured=False,
             parametric=model.parametric)  # fmt: skip
    return folder


def checked(folder: Path, name: str) -> tuple[bool, float]:
    """Whether a claim is proved again, and the seconds of the whole check."""
    results, seconds = timed(lambda: check(folder))
    return all(result.holds for result in results if result.name == name), seconds


# --- attacks --------------------------------------------------------------------------------------


def motion(model: Model, names: Sequence[str]) -> str:
    """Q̈ in C from Lagrange's equations, of (q, q̇), u and p = (θ, d)."""
    plant, varied = model.system, model.parametric
    k = plant.n // 2
    q, p = plant.x[:k], plant.x[k:]
    v = sp.Matrix(sp.symbols(f"v0:{k}", real=True))
    kinetic = sp.hessian(varied.H, p)
    M = sp.simplify(kinetic.inv())
    U = varied.H.subs(dict.fromkeys(p, 0))
    T = (v.T * M * v)[0, 0] / 2
    momenta = M * v
    drift = sum((momenta.diff(s) * w for s, w in zip(q, v, strict=True)), sp.zeros(k, 1))
    slope = sp.Matrix([sp.diff(T - U, s) for s in q])
    friction = sp.Matrix(varied.R[k:, k:]) * v
    u, d = (sp.Matrix(sp.symbols(f"{letter}0:{plant.m}", real=True)) for letter in "ud")
    force = sp.Matrix(varied.G[k:, :]) * (u + d) + slope - drift - friction
    given = {sp.Symbol(n, real=True): sp.Symbol(f"p[{i}]") for i, n in enumerate(names)}
    known = {sp.Symbol(n, real=True): value for n, value in varied.values.items() if n not in names}
    given |= {d[i]: sp.Symbol(f"p[{len(names) + i}]") for i in range(plant.m)}
    given |= {s: sp.Symbol(f"y[{i}]") for i, s in enumerate((*q, *v))}
    given |= {s: sp.Symbol(f"u[{i}]") for i, s in enumerate(u)}
    entries = [*v, *sp.simplify(M.inv() * force)]
    codes = [sp.ccode(sp.sympify(e).subs(known).subs(given)) for e in entries]
    return "\n".join(f"    rate[{i}] = {code};" for i, code in enumerate(codes))


def compiled(folder: Path, model: Model, names: Sequence[str], build: Path) -> ctypes.CDLL:
    """The exported controller with the plant of these parameters."""
    source, target = build / "loop.c", build / "loop.so"
    source.write_text(LOOP.replace("@plant@", motion(model, names)), encoding="utf-8")
    subprocess.run(
        ["cc", "-O2", "-std=c99", "-ffp-contract=off", "-shared", "-fPIC", str(source),
         str(folder / "c" / "necc.c"), f"-I{folder / 'c'}", "-o", str(target), "-lm"],
        check=True,
    )  # fmt: skip
    return ctypes.CDLL(str(target))


def attacked(
    folder: Path, model: Model, names: Sequence[str], starts: np.ndarray, values: np.ndarray,
    r: np.ndarray, told: np.ndarray, dt: float, steps: int,
) -> np.ndarray:  # fmt: skip
    """(first margin, least margin, (q, q̇) in the end) of each start."""
    n = model.system.n
    with tempfile.TemporaryDirectory() as build:
        library = compiled(folder, model, names, Path(build))
    out = np.zeros((len(starts), 2 + n))
    pointer = ctypes.POINTER(ctypes.c_double)
    arrays = [np.ascontiguousarray(a, float) for a in (starts.copy(), values, r, told, out)]
    s, p, targets, loads, found = (a.ctypes.data_as(pointer) for a in arrays)
    library.follow(len(starts), s, p, values.shape[1], targets, loads,
                   ctypes.c_long(steps), ctypes.c_double(dt), found)  # fmt: skip
    return arrays[-1]


def within(rng: np.random.Generator, sides: Mapping[str, tuple[float, float]], rows: int):
    """Values of parameters, a fifth of them at an end of their range."""
    lo, hi = np.array(list(sides.values())).reshape(-1, 2).T
    share = rng.uniform(size=(rows, len(lo)))
    ends = rng.uniform(size=share.shape) < 0.2
    return lo + (hi - lo) * np.where(ends, np.round(share), share)


# --- what is measured -----------------------------------------------------------------------------


def family_of_pendulums(rows: int, folder: Path) -> list[tuple[str, str, str]]:
    """r in [-2.5, 2.5], m ± 10 %, g ± 5 %: proved, checked, compared with the true errors."""
    model = pendulum()
    made, certificate = designed(model)
    exact = sp.Rational
    sides = {"m": (exact(9, 10), exact(11, 10)), "g": (exact(19, 20), exact(21, 20))}
    reach = (exact(-5, 2), exact(5, 2))
    family = lift(made, Ranges(setpoints={"q": reach}, uncertain=sides), model.parametric)
    if not isinstance(family, Family):
        return [("pendulum family", "all proved", family.sentence)]
    claim, seconds = timed(lambda: prove_family(family))
    if not claim.holds:
        return [("pendulum family", "all proved", claim.statement)]
    saved(folder, made, replace(certificate, claims=(*certificate.claims, claim)), model, family)
    again, checking = checked(folder, "family")
    lo, hi = claim.data["error"]["q"]
    grid = [np.linspace(float(a), float(b), 21) for a, b in (*sides.values(), reach)]
    true = max(
        abs(rest) for m in grid[0][[0, -1]] for g in grid[1][[0, -1]] for r in grid[2]
        if (rest := rest_of_member(family, m, g, r)) is not None
    )  # fmt: skip
    name = "pendulum, r in [-2.5, 2.5], m ± 10 %, g ± 5 %"
    lines = [
        (f"{name}: boxes", "all", f"{len(claim.data['boxes'])}"),
        (f"{name}: proved", "≤ 30 s", f"{seconds:.1f} s"),
        (
            f"{name}: checked",
            "≤ 60 s",
            f"{checking:.1f} s, {'holds' if again else 'DOES NOT HOLD'}",
        ),
        (f"{name}: q error, proved over true", "≤ 1.3", f"{max(-lo, hi) / true:.3f}"),
        (f"{name}: common region", "≥ 9 %", common_region(claim.data)),
    ]
    return lines + family_attack(rows, folder, model, made, sides, max(-lo, hi))


def common_region(data: Mapping[str, Any]) -> str:
    """Of the claim, where it says one."""
    share = data.get("common_share")
    return "no such claim" if share is None else f"{100 * share:.1f} %"


def rest_of_member(family: Family, m: float, g: float, r: float) -> float | None:
    """Q at rest less r, by Newton's method on the member's V."""
    member = family.member({"m": m, "g": g, "q": r})
    z = member.z_bar
    if not np.all(np.linalg.eigvalsh(member.lyapunov.hessian(z)) > 0):
        return None
    return float(z[0] - member.z_star[0])


def family_attack(
    rows: int, folder: Path, model: Model, made: Design, sides: Mapping[str, Any], most: float
) -> list[tuple[str, str, str]]:
    """At the design's own set-point, from near rest: none rests beyond the proved error."""
    rng = np.random.default_rng(0)
    values = within(rng, {k: tuple(map(float, v)) for k, v in sides.items()}, rows)
    starts = made.z_star[None] + rng.uniform(-0.5, 0.5, (rows, 3))
    values = np.hstack([values, np.zeros((rows, 1))])
    found = attacked(folder, model, list(sides), starts, values, np.zeros((rows, 1)),
                     np.zeros((rows, 1)), 0.01, 4000)  # fmt: skip
    off = np.abs(found[:, 2] - made.z_star[0])
    text = f"{int((off > most + 1e-6).sum())} of {rows} rest beyond; worst {off.max():.3g}"
    return [("attack: family of pendulums at its target", "0", text)]


def moving_pendulum(rows: int, samples: int, folder: Path) -> list[tuple[str, str, str]]:
    """Set-points in [-2.5, 2.5] and a mass that is told, in one level set; and its governor."""
    model = pendulum()
    made, certificate = designed(model)
    known = {k: v for k, v in model.parametric.values.items() if k != "m"}
    told = Plants(model.parametric.at(known), {"m": (sp.Rational(9, 10), sp.Rational(11, 10))})
    reach = (sp.Rational(-5, 2), sp.Rational(5, 2))
    moving = replace(made, setpoints={"q": reach}, told=told)
    claim, seconds = timed(lambda: prove_setpoints(moving))
    if claim is None or not claim.holds:
        return [("set-points and a mass that is told", "proved", "NOT proved")]
    proof = replace(certificate, design_hash=moving.hash, claims=(*certificate.claims, claim))
    saved(folder, moving, proof, model)
    again, checking = checked(folder, "setpoints")
    name = "pendulum, r in [-2.5, 2.5], m ± 10 % told"
    word = "holds" if again else "DOES NOT HOLD"
    lines = [
        (f"{name}: one level, proved / checked", "", f"{seconds:.1f} s / {checking:.1f} s, {word}")
    ]
    lines.append(governed(moving, proof, model, folder, samples))
    lines.append(set_point_attack(rows, moving, proof, model, folder))
    return lines


def governed(
    made: Design, proof: Certificate, model: Model, folder: Path, samples: int
) -> tuple[str, str, str]:
    """Random commands, loads and switches of ξ; where V is highest it is evaluated in Python."""
    every, dt, rng = 600, 0.005, np.random.default_rng(1)
    count = samples // every + 1
    commands, loads = rng.uniform(-2.7, 2.7, count), rng.uniform(0.9, 1.1, count)
    how = rng.integers(0, 3, count).astype(np.int32)
    y, out = made.z_star[:2].copy(), np.zeros((samples, 8))
    with tempfile.TemporaryDirectory() as build:
        library = compiled(folder, model, ["m"], Path(build))
    pointer = ctypes.POINTER(ctypes.c_double)
    numbers = [a.ctypes.data_as(pointer) for a in (y, commands, loads, out)]
    library.govern(
        ctypes.c_long(samples), *numbers[:3], how.ctypes.data_as(ctypes.POINTER(ctypes.c_int)),
        ctypes.c_long(every), ctypes.c_double(dt), numbers[3],
    )  # fmt: skip
    governor = Governor(made, proof)
    x, xi, r, load, after, before, flags = np.split(out, [2, 3, 4, 5, 6, 7], axis=1)
    moved = np.isin(flags[:, 0], (0, 16))
    worst = np.argsort(np.where(moved, after[:, 0], np.inf))[:500]
    share = max(governor.above(x[i], xi[i], r[i], load[i]) for i in worst)
    text = (
        f"V over the level at most {share:.9f} after a move, {1 - before.min():.6f} between; "
        f"commands taken at {int((flags == 0).sum())}, part of the way at "
        f"{int((flags == 16).sum())}, refused at {int((flags == 32).sum())}"
    )
    return (f"governor: {samples} samples", "no violation", text)


def set_point_attack(
    rows: int, made: Design, proof: Certificate, model: Model, folder: Path
) -> tuple[str, str, str]:
    """Any set-point, mass and start of the level set: V stays below the level, and q → r."""
    found = level_set(made, proof)
    rng, half = np.random.default_rng(2), found.half
    masses, low, high = rng.uniform(0.9, 1.1, (rows, 1)), *found.sides
    r = rng.uniform(low, high, (rows, 1))
    scale = 0.8 * rng.uniform(size=(rows, 1)) ** 0.5
    q = r + scale * rng.uniform(-half[0], half[0], (rows, 1))
    v = scale * rng.uniform(-1, 1, (rows, 1)) * np.sqrt(2 * found.level / masses)
    xi = made.xi_star + scale * rng.uniform(-half[1], half[1], (rows, 1))
    values = np.hstack([masses, np.zeros((rows, 1))])
    ends = attacked(folder, model, ["m"], np.hstack([q, v, xi]), values, r, masses, 0.01, 8000)
    inside = ends[:, 0] > 0
    off = np.abs(ends[inside, 2] - r[inside, 0])
    rises = int((ends[inside, 1] < -1e-6).sum())
    text = (
        f"{rises} above the level, {int((off > 1e-4).sum())} not at rest at r, of "
        f"{int(inside.sum())} inside"
    )
    return (f"attack: set-points, {rows} of (m, r, start)", "0", text)


def no_offset(
    model: Model, name: str, sides: Mapping[str, Any], push: float, rows: int, folder: Path,
    dt: float, steps: int,
) -> list[tuple[str, str, str]]:  # fmt: skip
    """Integral action over the whole ranges: proved, checked, attacked."""
    made, _ = designed(model)
    pushes = [(-sp.Rational(push), sp.Rational(push))] * model.system.m
    plants = Plants(model.parametric, sides)
    closed = with_integral(made, plants=plants, disturbance=pushes)
    claim, seconds = timed(lambda: prove_integral(closed, plants, pushes))
    if claim is None or not claim.holds:
        text = "none" if claim is None else claim.statement
        return [(f"{name}: no offset", "proved", f"NOT proved in {seconds:.1f} s: {text}")]
    proof = certify(closed, region=False)
    proof = replace(proof, claims=(*proof.claims, claim))
    saved(folder, closed, proof, model)
    again, checking = checked(folder, "integral")
    word = "holds" if again else "DOES NOT HOLD"
    lines = [
        (f"{name}: no offset, proved / checked", "", f"{seconds:.1f} s / {checking:.1f} s, {word}")
    ]
    k, rng = model.system.n // 2, np.random.default_rng(3)
    values = within(rng, {key: tuple(map(float, v)) for key, v in sides.items()}, rows)
    values = np.hstack([values, rng.uniform(-push, push, (rows, model.system.m))])
    units = closed.units
    size = np.concatenate([units.state[:k], units.state[2 * k :]])
    half = np.array(claim.data["half_widths"]) * size
    star = np.concatenate([closed.z_star[:k], closed.xi_star])
    scale = rng.uniform(0, 1, (rows, 1)) ** 0.5
    around = star + scale * rng.uniform(-1, 1, (rows, 2 * k)) * half
    rates = scale * rng.uniform(-1, 1, (rows, k))
    starts = np.hstack([around[:, :k], rates, around[:, k:]])
    ends = attacked(folder, model, list(sides), starts, values, np.zeros((rows, k)),
                    np.zeros((rows, 1)), dt, steps)  # fmt: skip
    inside = ends[:, 0] > 0
    off = np.abs(ends[inside, 2 : 2 + k] - closed.z_star[:k]).max(axis=1)
    lines.append((
        f"{name}: offset left, simulated", "1e-9",
        f"largest {off.max(initial=0):.2g}, {int((off > 1e-9).sum())} of {int(inside.sum())} "
        f"starts inside, of {rows}, above",
    ))  # fmt: skip
    return lines


def payload_on_the_arm(rows: int, folder: Path) -> list[tuple[str, str, str]]:
    """Offset without integral action, and with it for any payload."""
    model = arm()
    made, _ = designed(model)
    plants = OtherPlants(made, model.parametric)
    errors = []
    for mp in (0.0, 1.0):
        theta = plants.nominal.copy()
        theta[plants.names.index("mp")] = mp
        rest = plants.rest_error(theta)
        errors.append(np.nan if rest is None else np.abs(rest[:2]).max())
    lines = [("arm, payload 0 or 1 kg, not known: offset without ζ", "", f"{max(errors):.3g} rad")]
    sides = {"mp": (sp.Integer(0), sp.Integer(1))}
    name = "arm, payload 0 … 1 kg, |d| ≤ 1 N m"
    return lines + no_offset(model, name, sides, 1.0, rows, folder, 0.001, 30_000)


def any_payload_from_anywhere(rows: int, folder: Path) -> list[tuple[str, str, str]]:
    """The arm for every payload and start, the claim `everywhere`: V of none rises."""
    model, name = arm(), "arm, payload 0 … 1 kg not known: claim everywhere"
    ranges = Ranges(uncertain={"mp": (sp.Integer(0), sp.Integer(1))})
    found = run(replace(model, ranges=ranges), convex=True, plots=False)
    made, proof = found.design, found.certificate
    family = lift(made, ranges, model.parametric)
    claim, seconds = timed(lambda: prove_everywhere(family))
    if not claim.holds:
        return [(name, "1 s", f"NOT proved: {claim.statement}")]
    saved(folder, made, proof, model, family)
    again, checking = checked(folder, "everywhere")
    lines = [(
        f"{name}: proved, checked", "1 s",
        f"{seconds:.2f} s, {checking:.1f} s, {'holds' if again else 'DOES NOT HOLD'}",
    )]  # fmt: skip
    rng, times, every, dt = np.random.default_rng(5), 25, 250, 0.004
    payload = within(rng, {"mp": (0.0, 1.0)}, rows)
    values = np.hstack([payload, np.zeros((rows, 2))])
    starts = np.hstack([rng.uniform(-6, 6, (rows, 4)), rng.uniform(-3, 3, (rows, 2))])
    with tempfile.TemporaryDirectory() as build:
        library = compiled(folder, model, ["mp"], Path(build))
    out, pointer = np.zeros((rows, times, 6)), ctypes.POINTER(ctypes.c_double)
    arrays = [np.ascontiguousarray(a, float) for a in (starts, values, out)]
    s, p, o = (a.ctypes.data_as(pointer) for a in arrays)
    library.trace(rows, s, p, 3, ctypes.c_long(times), ctypes.c_long(every),
                  ctypes.c_double(dt), o)  # fmt: skip
    V = energies(family, model, arrays[-1].reshape(-1, 6), np.repeat(payload[:, 0], times))
    V = V.reshape(rows, times)
    rises = np.diff(V, axis=1) / (1 + np.abs(V[:, :1]))
    speed = np.abs(arrays[-1][:, -1, 2:4]).max(axis=1)
    text = (
        f"{int((rises > 1e-7).any(axis=1).sum())} rise, the most by {rises.max():.1g} of V; "
        f"{int((speed > 1e-3).sum())} still move after {times * every * dt:g} s"
    )
    return [*lines, (f"attack: arm from anywhere, {rows} of (payload, start)", "0", text)]


def energies(family: Family, model: Model, rows: np.ndarray, payload: np.ndarray) -> np.ndarray:
    """V of each member at rows of (q, q̇, ξ), momenta with the member's own inertia."""
    x, H = model.system.x, model.parametric.H
    theta = sp.Symbol("mp", real=True)
    known = {sp.Symbol(k, real=True): v for k, v in model.parametric.values.items() if k != "mp"}
    M = sp.simplify(sp.hessian(H, x[2:]).inv()).subs(known)
    v = sp.Matrix(sp.symbols("v0:2", real=True))
    momenta = sp.lambdify([x[0], x[1], *v, theta], list(M * v))
    p = np.array(momenta(*rows[:, :4].T, payload))
    z = np.vstack([rows[:, :2].T, p, rows[:, 4:].T])
    values = [payload if q.name == "mp" else np.zeros(len(payload)) for q in family.parameters]
    return np.array(family.V_function.map(len(payload))(z, np.array(values))).ravel()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=10_000)
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--only", choices=("family", "setpoints", "integral", "arm", "everywhere"))
    given = parser.parse_args()
    print("| | goal | measured |\n|---|---|---|")
    tenth = sp.Rational(1, 10)
    sides = {"m": (1 - tenth, 1 + tenth), "g": (1 - tenth / 2, 1 + tenth / 2)}

    def show(lines: Sequence[tuple[str, str, str]]) -> None:
        for line in lines:
            print(f"| {' | '.join(line)} |", flush=True)

    with tempfile.TemporaryDirectory() as place:
        folders = [Path(place) / str(i) for i in range(5)]
        for folder in folders:
            folder.mkdir()
        if given.only in (None, "family"):
            show(family_of_pendulums(given.rows, folders[0]))
        if given.only in (None, "setpoints"):
            show(moving_pendulum(given.rows, given.samples, folders[1]))
        if given.only in (None, "integral"):
            show(no_offset(pendulum(), "pendulum, m ± 10 %, g ± 5 %, |d| ≤ 0.1", sides, 0.1,
                           given.rows, folders[2], 0.01, 5_000))  # fmt: skip
        if given.only in (None, "arm"):
            show(payload_on_the_arm(given.rows, folders[3]))
        if given.only in (None, "everywhere"):
            show(any_payload_from_anywhere(given.rows, folders[4]))


if __name__ == "__main__":
    main()
