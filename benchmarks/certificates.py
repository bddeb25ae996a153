"""What the certificates prove about the example plants, in what time, beside what is simulated.

    python benchmarks/certificates.py [--only NAME,…] [--no-check]

Prints Markdown tables: seconds of each proof, the level c and what limits it, the share of the
domain, and the reach along each state's axis, the others at z̄, and the half-width of the proved
region over all states, against what is simulated along the axis; then, for loops with at
most two states beside the momenta, the share against the best that any c could have on the
box, with and without `Options(convex=True)`.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import platform
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from necc_casadi import (
    Certificate,
    Design,
    Options,
    certify,
    design,
    find_casimirs,
    judge,
    load_model,
    paper_options,
)
from necc_casadi.certificate.checker.check import check
from necc_casadi.model.target import parse_target, target_from_model
from necc_casadi.simulation.convergence import converging, simulated_share

EXAMPLES = Path(__file__).parent.parent / "examples"
DEEP = {"hidden_k": (64, 64), "hidden_h": (32, 32)}
#: Points per axis of the float grid, by the number of states on it.
FINE = {1: 4001, 2: 401}
BISECTIONS = 12


@dataclass(frozen=True)
class Case:
    """A design to certify."""

    name: str
    plant: str
    options: Callable[[int], Options]  # inputs -> options
    target: str | None = None


PENDULUMS = [
    Case("pendulum, default", "pendulum", lambda m: Options(), "pi/4"),
    Case("pendulum, default 64-64", "pendulum", lambda m: Options(**DEEP), "pi/4"),
    Case("pendulum, --paper", "pendulum", paper_options, "pi/4"),
    Case(
        "pendulum, --paper 64-64", "pendulum", lambda m: replace(paper_options(m), **DEEP), "pi/4"
    ),
    Case("pendulum, --global", "pendulum", lambda m: Options(convex=True), "pi/4"),
    Case("pendulum, --global 64-64", "pendulum", lambda m: Options(convex=True, **DEEP), "pi/4"),
]
OTHERS = (
    "damped_pendulum", "series_rlc", "maglev", "dc_motor", "tora", "cart_pole",
    "mass_spring_chain", "symmetric_chain", "two_link_arm", "satellite",
)  # fmt: skip
CASES = PENDULUMS + [
    case
    for plant in OTHERS
    for case in (
        Case(plant, plant, lambda m: Options()),
        Case(f"{plant}, --global", plant, lambda m: Options(convex=True)),
    )
]


@dataclass(frozen=True, eq=False)
class Row:
    """What was measured about one design."""

    name: str
    seconds: tuple[float, float, float | None]  # equilibrium and decrease; region; check
    certificate: Certificate
    rechecked: bool | None
    simulated: float | None  # share of the domain
    possible: float | None  # share of the domain that the best c covers
    reach: dict[str, tuple[float | None, float]]  # state -> proved, simulated


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", help="names of plants, separated by commas")
    parser.add_argument("--no-check", action="store_true", help="leave the checker out")
    arguments = parser.parse_args()
    chosen = None if arguments.only is None else arguments.only.split(",")
    print(f"{platform.processor() or platform.machine()}, {platform.python_version()}\n")
    rows = []
    print(
        "| design | equilibrium, decrease | region | check | c | limited by | stability | global |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        if chosen is not None and case.plant not in chosen:
            continue
        row = measured(case, not arguments.no_check)
        rows.append(row)
        print(timing_line(row), flush=True)
    print("\n| design | domain: proved | simulated | any c could | proved of possible |")
    print("|---|---|---|---|---|")
    for row in rows:
        print(share_line(row))
    print(
        "\n| design | along each axis: proved / simulated; half-width of Ω / the same |\n|---|---|"
    )
    for row in rows:
        print(f"| {row.name} | {reach_text(row)} |")


def measured(case: Case, checked: bool) -> Row:
    """Design, certify, check and simulate one case."""
    made = made_from(case)
    began = time.perf_counter()
    certify(made, region=False)
    local = time.perf_counter() - began
    began = time.perf_counter()
    certificate = certify(made)
    region = max(0.0, time.perf_counter() - began - local)
    seconds, rechecked = None, None
    if checked:
        began = time.perf_counter()
        rechecked = holds_again(made, certificate)
        seconds = time.perf_counter() - began
    resting = made.momenta
    return Row(
        name=case.name,
        seconds=(local, region, seconds),
        certificate=certificate,
        rechecked=rechecked,
        simulated=simulated_share(made, resting),
        possible=possible_share(made, resting),
        reach=reaches(made, certificate),
    )


def made_from(case: Case) -> Design:
    """The design of a case, at the model's own target where the case names none."""
    model = load_model(EXAMPLES / f"{case.plant}.py")
    plant = model.loop.plant
    x_star = (
        target_from_model(plant, model.target or {})
        if case.target is None
        else parse_target(plant, case.target)
    )
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    verdict = judge(model.loop, casimirs, x_star)
    return design(model.loop, casimirs, verdict, x_star, case.options(plant.m))


def holds_again(made: Design, certificate: Certificate) -> bool:
    """Whether the independent checker proves every claim again."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made.save(folder / "design.json")
        (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
        return all(result.holds for result in check(folder))


def values(made: Design, points: np.ndarray) -> np.ndarray:
    """V at states (B, n + nc)."""
    return made.lyapunov.V(points)


def possible_share(made: Design, resting: Sequence[int]) -> float | None:
    """Share of the domain, momenta at rest, of the largest component of {V ≤ c} that any c allows.

    In floating point on a fine grid: points are flooded from z̄ in the order of V, and c ends at
    the boundary of the domain, where a momentum would leave it, or at another critical point: a
    point that is reached and lower than its surroundings, or a pass to lower ground.
    """
    active = [i for i in range(made.loop.n) if i not in resting]
    if len(active) not in FINE:
        return None
    lo, hi = made.domain.lo, made.domain.hi
    axes = [np.linspace(lo[i], hi[i], FINE[len(active)]) for i in active]
    mesh = np.stack([v.ravel() for v in np.meshgrid(*axes, indexing="ij")], -1)
    points = np.zeros((len(mesh), made.loop.n))
    points[:, active] = mesh
    V = values(made, points).reshape([axis.size for axis in axes])
    ceiling = min((momentum_level(made, i, lo, hi) for i in resting), default=np.inf)
    start = tuple(int(np.argmin(abs(a - made.z_bar[i]))) for a, i in zip(axes, active, strict=True))
    return flooded_share(V, start, ceiling)


def momentum_level(made: Design, state: int, lo: np.ndarray, hi: np.ndarray) -> float:
    """V where one momentum alone leaves the domain, at z̄."""
    corners = np.repeat(made.z_bar[None], 2, axis=0)
    corners[:, state] = lo[state], hi[state]
    return float(values(made, corners).min())


def flooded_share(V: np.ndarray, start: tuple[int, ...], ceiling: float) -> float:
    """Share of the points in the component of {V ≤ c} around `start`, for the largest c."""
    start = downhill(V, start)
    order, seen, count = [(V[start], start)], {start}, 0
    highest = bottom = float(V[start])
    while order:
        value, at = heapq.heappop(order)
        edge = any(k in (0, n - 1) for k, n in zip(at, V.shape, strict=True))
        # behind a pass V falls again; by less than this it is the grid's own roughness
        fallen = highest - value > 1e-3 * (highest - bottom) + 1e-12
        if edge or value > ceiling or fallen:
            break
        highest = max(highest, float(value))
        count += 1
        for other in neighbours(at, V.shape):
            if other not in seen:
                seen.add(other)
                heapq.heappush(order, (V[other], other))
    return count / V.size


def downhill(V: np.ndarray, at: tuple[int, ...]) -> tuple[int, ...]:
    """The lowest point of the grid near z̄, by steepest descent."""
    while (best := min(neighbours(at, V.shape), key=lambda k: V[k])) and V[best] < V[at]:
        at = best
    return at


def neighbours(at: tuple[int, ...], shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Points of the grid around one, diagonals too."""
    ranges = [range(max(0, k - 1), min(n, k + 2)) for k, n in zip(at, shape, strict=True)]
    return [other for other in itertools.product(*ranges) if other != at]


def reaches(made: Design, certificate: Certificate) -> dict[str, tuple[float | None, float]]:
    """Distance from z̄ along each axis, the shorter side: in the proved region, and simulated."""
    region = certificate.region

    def covered(z: np.ndarray) -> bool:
        return region is not None and region.contains(made.V, z)

    def settles(z: np.ndarray) -> bool:
        return bool(converging(made, z[None]).arrived[0])

    lo, hi = made.domain.lo, made.domain.hi
    result = {}
    for i, name in enumerate(made.loop.states):
        axis = np.eye(made.loop.n)[i]
        ends = (axis * (hi[i] - made.z_bar[i]), axis * (lo[i] - made.z_bar[i]))
        proved = None
        if certificate.region is not None:
            proved = min(along(covered, made.z_bar, end) for end in ends)
        simulated = min(along(settles, made.z_bar, end) for end in ends)
        result[name] = (proved, simulated)
    return result


def along(holds: Callable[[np.ndarray], bool], start: np.ndarray, end: np.ndarray) -> float:
    """Length of the way from `start` towards start + end on which a property holds, bisected."""
    low, high = 0.0, 1.0
    if holds(start + 0.999999 * end):
        low = 1.0
    for _ in range(BISECTIONS if low == 0.0 else 0):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(start + middle * end) else (low, middle)
    return low * float(np.linalg.norm(end))


# --- tables ---------------------------------------------------------------------------------------


def timing_line(row: Row) -> str:
    """One row of the first table."""
    c, (local, region, checked) = row.certificate, row.seconds
    check_text = "–" if checked is None else f"{checked:.2f} s{'' if row.rechecked else ', FAILS'}"
    level = "–" if c.level is None else f"{c.level:.4g}"
    limit = c.limited_by or "–"
    return (
        f"| {row.name} | {1000 * local:.0f} ms | {region:.2f} s | {check_text} | {level} | {limit} "
        f"| {c.stability or 'not proved'} | {'yes' if c.is_global else 'no'} |"
    )


def share_line(row: Row) -> str:
    """One row of the second table."""
    proved, possible = row.certificate.domain_share, row.possible
    ratio = f"{proved / possible:.0%}" if proved is not None and possible else "–"
    return (
        f"| {row.name} | {percent(proved)} | {percent(row.simulated)} | {percent(possible)} "
        f"| {ratio} |"
    )


def percent(share: float | None) -> str:
    """A share with three digits."""
    return "–" if share is None else f"{100 * share:.3g} %"


def reach_text(row: Row) -> str:
    """State: along the axis, proved / simulated; then the half-width of Ω over all states."""
    claims = {claim.name: claim.data for claim in row.certificate.claims}
    sizes, parts = claims.get("region", {}), []
    for state, (proved, simulated) in row.reach.items():
        text = f"{state} {share_of(proved, simulated)}"
        wide = sizes.get(f"reach_{state}")
        parts.append(text if wide is None else f"{text}; {share_of(wide, simulated)}")
    return ", ".join(parts)


def share_of(proved: float | None, simulated: float) -> str:
    """A proved length beside a simulated one."""
    if proved is None:
        return f"– / {simulated:.3g}"
    ratio = f"{proved / simulated:.0%}" if simulated > 0 else "–"
    return f"{proved:.3g} / {simulated:.3g} ({ratio})"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
