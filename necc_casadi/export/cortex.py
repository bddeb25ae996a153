"""Flash and stack of the controller on Cortex-M4F and M7, as the cross compiler gives them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from necc_casadi.export.controller import controller
from necc_casadi.export.header import header
from necc_casadi.export.source import Source

__all__ = ["cross_compiled", "deepest_stack"]


_COMPILER = "arm-none-eabi-gcc"


_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-mthumb", "-mfloat-abi=hard")


#: Processors, with their units for floating point.
_PROCESSORS = {
    "Cortex-M4F": ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"),
    "Cortex-M7": ("-mcpu=cortex-m7", "-mfpu=fpv5-d16"),
}


def cross_compiled(source: Source) -> str:
    """Bytes of flash and stack in words; why not, where there is no cross compiler."""
    compiler, size = shutil.which(_COMPILER), shutil.which("arm-none-eabi-size")
    if compiler is None or size is None:
        return f"Flash and stack: not looked at, there was no `{_COMPILER}` at export."
    texts = {"necc.h": header(source), "necc.c": controller(source)}
    found = []
    for name, flags in _PROCESSORS.items():
        numbers = _compiled(texts, (compiler, *_FLAGS, *flags), size, source.named("necc_step"))
        if isinstance(numbers, str):
            return numbers
        flash, bss, stack = numbers
        found.append(
            f"for a {name} {flash} bytes of flash, {bss} of RAM that is not the stack, {stack} "
            "bytes of stack for `necc_step`"
        )
    return (
        f"Compiled with `{_COMPILER} -O2`: {'; '.join(found)}, the deepest way through the "
        "compiler's graph of calls (the C library's own not counted)."
    )


def _compiled(
    texts: Mapping[str, str], command: Sequence[str], size: str, entry: str
) -> tuple[int, int, int] | str:
    """(flash, .bss, stack) in bytes, or what went wrong."""
    with tempfile.TemporaryDirectory(prefix="necc-") as name:
        folder = Path(name)
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8")
        printed = ""
        for step in (
            [*command, "-fcallgraph-info=su", "-c", "necc.c", "-o", "necc.o"],
            [size, "necc.o"],
        ):
            done = subprocess.run(
                step, cwd=folder, capture_output=True, text=True, timeout=60, check=False
            )
            if done.returncode != 0:
                return f"Flash and stack: `{_COMPILER}` failed."
            printed = done.stdout
        numbers = re.search(r"^\s*(\d+)\s+(\d+)\s+(\d+)", printed, re.MULTILINE)
        graph = (folder / "necc.ci").read_text(encoding="utf-8")
    stack = deepest_stack(graph, entry)
    if numbers is None or stack is None:
        return f"Flash and stack: `{_COMPILER}` gave them in another form."
    return int(numbers[1]) + int(numbers[2]), int(numbers[3]), stack


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
