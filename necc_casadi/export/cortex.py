"""Flash and stack of the controller on a Cortex-M4F, as the cross compiler gives them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from necc_casadi.export.controller import controller
from necc_casadi.export.header import header
from necc_casadi.export.source import Source

__all__ = ["cross_compiled", "deepest_stack"]


_COMPILER = "arm-none-eabi-gcc"


_FLAGS = (
    "-std=c99", "-O2", "-ffp-contract=off", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard",
    "-mfpu=fpv4-sp-d16",
)  # fmt: skip


def cross_compiled(source: Source) -> str:
    """Bytes of flash and stack in words; why not, where there is no cross compiler."""
    compiler, size = shutil.which(_COMPILER), shutil.which("arm-none-eabi-size")
    if compiler is None or size is None:
        return f"Flash and stack: not looked at, there was no `{_COMPILER}` at export."
    with tempfile.TemporaryDirectory(prefix="necc-") as name:
        folder = Path(name)
        (folder / "necc.h").write_text(header(source), encoding="utf-8")
        (folder / "necc.c").write_text(controller(source), encoding="utf-8")
        commands = (
            [compiler, *_FLAGS, "-fcallgraph-info=su", "-c", "necc.c", "-o", "necc.o"],
            [size, "necc.o"],
        )
        printed = ""
        for command in commands:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=60, check=False
            )
            if done.returncode != 0:
                return f"Flash and stack: `{_COMPILER}` failed."
            printed = done.stdout
        numbers = re.search(r"^\s*(\d+)\s+(\d+)\s+(\d+)", printed, re.MULTILINE)
        graph = (folder / "necc.ci").read_text(encoding="utf-8")
    stack = deepest_stack(graph, source.named("necc_step"))
    if numbers is None or stack is None:
        return f"Flash and stack: `{_COMPILER}` gave them in another form."
    flash, bss = int(numbers[1]) + int(numbers[2]), int(numbers[3])
    return (
        f"Compiled for a Cortex-M4F with `{_COMPILER} -O2`: {flash} bytes of flash, {bss} of RAM "
        f"that is not the stack, {stack} bytes of stack for `necc_step`, the deepest way through "
        "the compiler's graph of calls (the C library's own not counted)."
    )


def deepest_stack(graph: str, entry: str) -> int | None:
    """Bytes from `entry` down in what gcc writes for ``-fcallgraph-info=su``; None without it."""
    nodes = re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', graph)
    frames = {title: _bytes(label) for title, label in nodes}
    calls: dict[str, set[str]] = {}
    for caller, called in re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', graph):
        calls.setdefault(caller, set()).add(called)

    def depth(name: str) -> int:
        below = max((depth(called) for called in calls.get(name, ())), default=0)
        return frames.get(name, 0) + below  # nothing in the code calls itself

    return depth(entry) if entry in frames else None


def _bytes(label: str) -> int:
    found = re.search(r"(\d+) bytes", label)
    return int(found[1]) if found else 0
