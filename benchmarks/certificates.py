"""What the certificates prove about the example plants, and in what time.

    python benchmarks/certificates.py [--only NAME,…] [--no-check]

Prints a Markdown table: seconds of the local proofs, of the region and of the checker; the height
of what ends the region above V(z̄), how much of it is proved, on how many cells of how many kept
states; shares of the domain, sampled and simulated.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

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
from necc_casadi.certificate.claims.regions import Region
from necc_casadi.model.target import parse_target, target_from_model
from necc_casadi.performance.shares import sampled_share
from necc_casadi.report.findings import global_claim
from necc_casadi.simulation.convergence import simulated_share

EXAMPLES = Path(__file__).parent.parent / "examples"
DEEP = {"hidden_k": (64, 64), "hidden_h": (32, 32)}


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
    Case("pendulum at π", "pendulum", lambda m: Options(), "pi"),
    Case("pendulum, --paper", "pendulum", paper_options, "pi/4"),
    Case(
        "pendulum, --paper 64-64", "pendulum", lambda m: replace(paper_options(m), **DEEP), "pi/4"
    ),
    Case("pendulum, --global", "pendulum", lambda m: Options(convex=True), "pi/4"),
    Case("pendulum, --global 64-64", "pendulum", lambda m: Options(convex=True, **DEEP), "pi/4"),
]
OTHERS = (
    "damped_pendulum", "series_rlc", "maglev", "dc_motor", "tora", "cart_pole",
    "mass_spring_chain", "symmetric_chain", "two_link_arm", "satellite", "buck_filter",
    "hydraulic_cylinder", "mems_comb", "port_crane", "quarter_car", "qube_pendulum", "robot_joint",
)  # fmt: skip
CASES = PENDULUMS + [
    case
    for plant in OTHERS
    for case in (
        Case(plant, plant, lambda m: Options()),
        Case(f"{plant}, --global", plant, lambda m: Options(convex=True)),
    )
]
HEADER = (
    "| design | local | region | check | obstacle | height | proved of it | kept | cells "
    "| sampled | simulated | stability | global |\n" + "|---" * 13 + "|"
)


@dataclass(frozen=True, eq=False)
class Row:
    """What was measured about one design."""

    name: str
    seconds: tuple[float, float, float | None]  # equilibrium and decrease; the rest; check
    certificate: Certificate
    rechecked: bool | None
    sampled: float | None  # share of the domain in Ω
    simulated: float | None  # share of the domain from which it converges


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", help="names of plants, separated by commas")
    parser.add_argument("--no-check", action="store_true", help="leave the checker out")
    arguments = parser.parse_args()
    chosen = None if arguments.only is None else arguments.only.split(",")
    print(f"{platform.processor() or platform.machine()}, {platform.python_version()}\n")
    print(HEADER)
    for case in CASES:
        if chosen is None or case.plant in chosen:
            print(line(measured(case, not arguments.no_check)), flush=True)


def measured(case: Case, checked: bool) -> Row:
    """Design, certify and check one case."""
    made = made_from(case)
    start = time.perf_counter()
    certify(made, region=False)
    local = time.perf_counter() - start
    start = time.perf_counter()
    certificate = certify(made)
    region = time.perf_counter() - start - local
    rechecked, seconds = None, None
    if checked:
        start = time.perf_counter()
        rechecked = holds_again(made, certificate)
        seconds = time.perf_counter() - start
    return Row(
        name=case.name,
        seconds=(local, region, seconds),
        certificate=certificate,
        rechecked=rechecked,
        sampled=sampled_share(made, certificate),
        simulated=simulated_share(made, made.momenta, made.seed),
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
    """Whether the independent checker proves every claim that is held again."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made.save(folder / "design.json")
        (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
        held = {claim.name for claim in certificate.claims if claim.holds}
        return all(r.holds for r in check(folder) if r.name in held | {"design", "contents"})


def line(row: Row) -> str:
    """One row of the table."""
    c, (local, region, seconds) = row.certificate, row.seconds
    obstacle, claimed = c.obstacle, c.region
    whole = global_claim(c)
    everywhere = whole is not None and whole.holds
    cells = [
        row.name,
        f"{1000 * local:.0f} ms",
        f"{region:.2f} s",
        "–" if seconds is None else f"{seconds:.2f} s{'' if row.rechecked else ', FAILS'}",
        ("none" if everywhere else "–") if obstacle is None else obstacle.kind,
        "–" if obstacle is None else f"{obstacle.level_above_minimum:.4g}",
        "–" if c.obstacle_share is None else f"{100 * c.obstacle_share:.2f} %",
        str(len(claimed.kept)) if isinstance(claimed, Region) else "–",
        str(len(claimed.leaves)) if isinstance(claimed, Region) else "–",
        percent(row.sampled),
        percent(row.simulated),
        c.stability or "not proved",
        "yes" if c.is_global else "bounded" if everywhere else "no",
    ]
    return f"| {' | '.join(cells)} |"


def percent(share: float | None) -> str:
    """A share with three digits."""
    return "–" if share is None else f"{100 * share:.3g} %"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
