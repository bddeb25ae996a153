"""OUT/c/README.md: how to use the C code, its size and its time measured on this machine."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from necc_casadi.export.compiled import find_compiler
from necc_casadi.export.controller import c_networks, controller
from necc_casadi.export.cortex import cross_compiled
from necc_casadi.export.header import header
from necc_casadi.export.operations import (
    count_networks,
    count_text,
    least_cycles,
    least_cycles_dual_issue,
)
from necc_casadi.export.source import Source
from necc_casadi.export.templating import fill
from necc_casadi.texts import escaped

__all__ = ["Measurement", "measure", "readme"]


_FLAGS = (("-O2",), ("-O3", "-march=native"))


@dataclass(frozen=True)
class Measurement:
    """Size and time of the controller under one set of compiler flags."""

    flags: tuple[str, ...]
    text: int | None  # bytes of code and constants; None without binutils
    bss: int | None  # bytes of zeroed memory
    control: float  # ns for one necc_control
    step: float  # ns for one necc_step


def readme(source: Source, *, measured: bool = True) -> str:
    """The text of README.md; `measured` runs the compiler, where there is one, for a second."""
    compiler = find_compiler() if measured else None
    rows = [m for flags in _FLAGS if compiler and (m := measure(source, compiler, flags))]
    float_note = ""
    if source.real == "float":
        beside = (
            "but the one about this code" if source.disturbed_claim else "not about its rounding"
        )
        float_note = f" The claims in `necc.h` are about exact arithmetic, {beside}."
    text = fill(
        "README.md",
        title=escaped(source.design.loop.plant.name),
        sample_time=f"{source.step_time:g}",
        sample_literal=source.number.literal(source.step_time),
        real=source.real,
        float_note=float_note,
        order="; ".join(f"`{array}` = ({', '.join(of)})" for array, of in _order(source).items()),
        counted=counted(source),
        calls=_calls(source),
        cross=cross_compiled(source) if measured else "",
        measured=_table(rows, compiler) if rows else "Not measured: no C compiler was at hand.",
    )
    return source.named(text)


def _order(source: Source) -> dict[str, list[str]]:
    """What stands in x and u, with units."""
    plant, measured = source.design.loop.plant, source.design.measurement
    units = {**plant.units, **measured.units}
    return {
        array: [escaped(f"{name} [{units[name]}]" if name in units else name) for name in names]
        for array, names in {"x": measured.names, "u": plant.input_names}.items()
    }


def _calls(source: Source) -> str:
    """How many evaluations of the law a sample takes."""
    if source.kept is not None:
        return (
            f"`necc_step` takes {source.substeps + 1} of these, all of them in `necc_output`: xi "
            f"goes {source.substeps} step(s) down V before u is computed."
        )
    many = {"euler": "one", "heun": "two", "rk4": "four"}[source.integrator]
    return f"`necc_step` takes {many} of these, `necc_output` one of them."


#: Plant terms that ``necc_control`` calls once.
_TERMS = ("casimirs", "shifted", "hamiltonian", "control_law")


def counted(source: Source) -> str:
    """Operations of one ``necc_control``, and what they cost at least on a Cortex-M4F and M7."""
    code, counts = controller(source), count_networks(c_networks(source), source.real)
    for name in _TERMS:
        body = re.search(rf"^static void {name}\(.*?\n\{{\n(.*?)\n\}}", code, re.M | re.S)
        if body is not None and (name != "hamiltonian" or source.neural_phi):
            counts.update(count_text(body[1]))
    weights = counts["weights"]
    listed = ", ".join(f"{n} {name}" for name, n in sorted(counts.items()) if name != "weights")
    text = f"One `necc_control` takes {listed} and reads {weights} weights: counted in the code."
    return f"{text} {_on_m4(source, counts)} {_on_m7(source, counts)}"


def _on_m4(source: Source, counts: Counter[str]) -> str:
    if source.real == "double":
        return "A Cortex-M4F computes `double` in software."
    return (
        f"A Cortex-M4F needs at least {least_cycles(counts)} cycles for them (1 for each "
        "multiplication, addition and weight, 14 for a division or a root; the C library is not "
        "counted): a bound from below, not measured; stores, loops and flash come on top."
    )


def _on_m7(source: Source, counts: Counter[str]) -> str:
    unit = " with an FPU for `double` (`fpv5-d16`)" if source.real == "double" else ""
    return (
        f"A Cortex-M7{unit} begins at most two instructions in a cycle, so that it needs at least "
        f"{least_cycles_dual_issue(counts)} cycles for the arithmetic, without contraction: a "
        "bound from below, too, and a low one, since Arm publishes no latencies and none is "
        "assumed; loads are not counted either."
    )


def measure(source: Source, compiler: str, flags: tuple[str, ...]) -> Measurement | None:
    """Compile and time the controller here; None where that fails."""
    with tempfile.TemporaryDirectory(prefix="necc-") as folder:
        build = Path(folder)
        texts = {
            "necc.h": header(source),
            "necc.c": controller(source),
            "timing.c": source.named(fill("timing.c")),
        }
        for name, text in texts.items():
            (build / name).write_text(text, encoding="utf-8")
        options = ["-std=c99", "-ffp-contract=off", *flags]
        steps = (
            [compiler, *options, "-c", "necc.c", "-o", "necc.o"],
            [compiler, *options, "timing.c", "necc.o", "-o", "timing", "-lm"],
        )
        if any(_run(step, build) is None for step in steps):
            return None
        times = _run(["./timing"], build)
        if times is None:
            return None
        control, step = (float(v) for v in times.split())
        return Measurement(flags, *_sizes(build / "necc.o"), control, step)


def _run(command: list[str], folder: Path) -> str | None:
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=60, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def _sizes(target: Path) -> tuple[int | None, int | None]:
    """(text with constants, bss) in bytes, by binutils' ``size``."""
    tool = shutil.which("size")
    printed = _run([tool, str(target)], target.parent) if tool else None
    numbers = re.search(r"^\s*(\d+)\s+(\d+)\s+(\d+)", printed or "", re.MULTILINE)
    return (int(numbers[1]) + int(numbers[2]), int(numbers[3])) if numbers else (None, None)


def _table(rows: list[Measurement], compiler: str | None) -> str:
    lines = [
        f"Measured at export, {Path(compiler or 'cc').name} on {platform.machine()}, "
        "best of several blocks:",
        "",
        "| flags | code and constants, B | .bss, B | `necc_control`, ns | `necc_step`, ns |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        sizes = " | ".join("–" if v is None else str(v) for v in (row.text, row.bss))
        lines.append(f"| `{' '.join(row.flags)}` | {sizes} | {row.control:.0f} | {row.step:.0f} |")
    return "\n".join(lines)
