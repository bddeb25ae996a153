"""Rows per second of a Monte Carlo study on Dask against the same rows in a bare loop.

    python benchmarks/study.py [--rows 1000] [--workers 2] [--repeats 3]

Prints a Markdown table. The loops run side by side, as many as there are workers, once everything
is loaded. *Efficiency* is the rate of the study over theirs: of the whole call, cluster and imports
included, and from the first finished batches on. *CPU* is theirs over the seconds of all processes
of the study, which says what Dask costs on a machine that others use, too.
"""

from __future__ import annotations

import argparse
import multiprocessing
import platform
import resource
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil  # Dask brings it

from necc_casadi import Design, run
from necc_casadi.designs.plant_file import read_plant
from necc_casadi.study.cluster import computed
from necc_casadi.study.montecarlo import MonteCarlo
from necc_casadi.study.rows import opened
from necc_casadi.study.vary import read_bands

WEIGHED = """
import sympy as sp
q, p, m, g = sp.symbols("q p m g", real=True)
name = "Weighed pendulum"
x = (q, p)
params = {m: 1.25, g: 9.81}
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational(1, 10))
G = sp.Matrix([0, 1])
H = p**2 / (2 * m) + m * g * (1 - sp.cos(q))
"""


def job(folder: Path) -> MonteCarlo:
    """A design, and what is to be varied about it."""
    model, out = folder / "weighed.py", folder / "out"
    model.write_text(WEIGHED, encoding="utf-8")
    run(model, "pi/4", out=out, plots=False)
    made = Design.load(out)
    plant, text = read_plant(out, made)
    return MonteCarlo(made.text, text, read_bands("m=10%,g=5%", plant.values), 10, 0)


def cpu() -> float:
    """Seconds of this process, of those that it has ended, and of those that are alive."""
    each = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    own = sum(usage.ru_utime + usage.ru_stime for usage in each)
    alive = (process.cpu_times() for process in psutil.Process().children(recursive=True))
    return own + sum(times.user + times.system for times in alive)


def loop(study: MonteCarlo, indices: range, ready: Any, done: Any) -> None:
    """Rows in a bare loop, begun with the others; CPU seconds."""
    study.row(0)
    ready.wait()
    before = time.process_time()
    for index in indices:
        study.row(index)
    done.put(time.process_time() - before)


def bare(study: MonteCarlo, rows: int, workers: int) -> tuple[float, float]:
    """Rows per second of bare loops side by side, once prepared, and CPU seconds per row."""
    context = multiprocessing.get_context("spawn")
    ready, done = context.Barrier(workers + 1), context.Queue()
    each = [range(k, rows, workers) for k in range(workers)]
    loops = [context.Process(target=loop, args=(study, own, ready, done)) for own in each]
    for process in loops:
        process.start()
    ready.wait()
    began = time.perf_counter()
    spent = sum(done.get() for _ in loops)
    seconds = time.perf_counter() - began
    for process in loops:
        process.join()
    return rows / seconds, spent / rows


def on_dask(study: MonteCarlo, rows: int, workers: int, out: Path) -> tuple[float, float, float]:
    """Rows per second of the whole call and after its first batch, and CPU seconds per row."""
    began, before = time.perf_counter(), cpu()
    first, early = None, 0
    with opened(out, study.columns, rows, study.study) as kept:
        for batch in computed(study, kept.missing, None, workers):
            kept.add(batch)
            if first is None and len(kept.done) > 4 * workers:  # every worker is at work
                first, early = time.perf_counter(), len(kept.done)
            if len(kept.done) == rows:  # the workers are still there
                last, spent = time.perf_counter(), cpu() - before
    ended = time.perf_counter()
    steady = (rows - early) / (last - (first or began))
    return rows / (ended - began), steady, spent / rows


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    rows, workers = arguments.rows, arguments.workers
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        study = job(folder)
        loops, rates = [], []
        for repeat in range(arguments.repeats):
            loops.append(bare(study, rows, workers))
            rates.append(on_dask(study, rows, workers, folder / f"study-{repeat}"))
    ideal, loop_cpu = (statistics.median(values) for values in zip(*loops, strict=True))
    whole, steady, spent = (statistics.median(values) for values in zip(*rates, strict=True))
    print(f"{platform.machine()}, {rows} rows, {workers} workers, medians of {arguments.repeats}\n")
    print(
        "| rows/s of bare loops | on Dask, whole call | after its first batches "
        "| efficiency: whole, steady, CPU |"
    )
    print("|---|---|---|---|")
    print(
        f"| {ideal:.1f} | {whole:.1f} | {steady:.1f} | {100 * whole / ideal:.0f} %, "
        f"{100 * steady / ideal:.0f} %, {100 * loop_cpu / spent:.0f} % |"
    )


if __name__ == "__main__":
    main()
