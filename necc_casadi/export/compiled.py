"""Compile the exported C here and run it through ctypes."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.errors import OutputError
from necc_casadi.export.controller import controller
from necc_casadi.export.header import header
from necc_casadi.export.source import Source
from necc_casadi.export.templating import PREFIX

__all__ = [
    "CompiledController",
    "Running",
    "compile_controller",
    "compile_shared",
    "find_compiler",
    "load_controller",
]


_REJECTED = 2  # NECC_REJECTED


#: Room for parameters that are told.
_MOST_TOLD = 64


_REMEDY = "Install gcc or clang, or name one in the environment variable CC."


@dataclass(frozen=True, eq=False)
class CompiledController:
    """The exported controller as machine code; the caller keeps ξ, as in C."""

    library: ctypes.CDLL
    n: int  # plant states
    nc: int  # controller states
    m: int  # inputs
    real: Any  # ctypes.c_double or ctypes.c_float
    prefix: str = PREFIX

    def control(self, x: Sequence[float], xi: Sequence[float]) -> tuple[Vector, Vector]:
        """``necc_control``: plant state (n,), controller state (nc,) -> u (m,), ξ̇ (nc,)."""
        u, xi_dot = (self.real * self.m)(), (self.real * self.nc)()
        self._function("control")(self._array(x, self.n), self._array(xi, self.nc), u, xi_dot)
        return np.array(u, float), np.array(xi_dot, float)

    def init(self) -> Vector:
        """``necc_init``: ξ at the designed equilibrium, (nc,)."""
        state = self._state(())
        self._function("init")(state)
        return np.array(state, float)[: self.nc]

    def init_at(self, x0: Sequence[float]) -> tuple[Vector, int]:
        """``necc_init_at``: plant state (n,) -> ξ at the minimum of V(x0, ·), (nc,), flags."""
        return self._started("init_at", x0)

    def start(self, x0: Sequence[float]) -> tuple[Vector, int]:
        """``necc_start``: plant state (n,) -> ξ(0) of the design, (nc,), flags."""
        return self._started("start", x0)

    def samples(
        self, xi: Sequence[float], xs: Sequence[Sequence[float]], dts: Sequence[float]
    ) -> tuple[Vector, Vector, list[int]]:
        """``necc_step`` at each of N samples.

        Parameters
        ----------
        xi
            ξ at the first sample, (nc,); with integral action ζ may stand behind it.
        xs
            What is measured, (N, n).
        dts
            Seconds since the sample before, (N,); the first counts for nothing.

        Returns
        -------
        tuple
            u (N, m), ξ that u is computed with, and ζ where it was given, (N, nc), flags.
        """
        state, us, xis, flags = self._state(xi), [], [], []
        for x, dt in zip(xs, dts, strict=True):
            u = (self.real * self.m)()
            arguments = (state, self._array(x, self.n), u, self.real(dt))
            flags.append(int(self._function("step")(*arguments)))
            us.append(list(u))
            xis.append(list(state)[: len(xi)])
        return np.array(us, float), np.array(xis, float), flags

    def running(self, x0: Sequence[float] | None = None) -> Running:
        """A state of its own, as ``necc_init`` has it, or ``necc_start`` at x0 (n,)."""
        state = self._state(())
        if x0 is not None:
            self._function("start")(state, self._array(x0, self.n))
        return Running(self, state)

    def step(
        self, xi: Sequence[float], x: Sequence[float], dt: float
    ) -> tuple[Vector, Vector, int]:
        """A sample and the next, dt (s) later at the same x: u (m,) at the first, ξ (nc,), flags.

        With integral action ζ may stand behind ξ, and then it does so in what comes back. Where
        either is rejected: what that one returns.
        """
        us, xis, flags = self.samples(xi, [x, x], [0, dt])
        rejected = next((k for k, flag in enumerate(flags) if flag & _REJECTED), 0)
        return us[rejected], xis[1], flags[rejected]

    def margin(self, x: Sequence[float], xi: Sequence[float]) -> float | None:
        """``necc_margin`` at (x, ξ), from 0 on in Ω; None where the code has none.

        With integral action ζ may stand behind ξ.
        """
        return Running(self, self._state(xi)).margin(x)

    def _started(self, name: str, x0: Sequence[float]) -> tuple[Vector, int]:
        state = self._state(())
        flags = self._function(name)(state, self._array(x0, self.n))
        return np.array(state, float)[: self.nc], int(flags)

    def _state(self, kept: Sequence[float]) -> Any:
        """Memory for ``necc_state`` as ``necc_init`` makes it, but for the ξ and ζ given."""
        room = 3 * (self.nc + self.m + self.n) + _MOST_TOLD + 8
        state = (self.real * room)()
        self._function("init")(state)
        for i, value in enumerate(kept):
            state[i] = float(value)
        return state

    def _function(self, name: str) -> Any:
        return getattr(self.library, f"{self.prefix}_{name}")

    def _array(self, values: Sequence[float], length: int) -> Any:
        return (self.real * length)(*(float(v) for v in values))


@dataclass(frozen=True, eq=False)
class Running:
    """One ``necc_state`` and the functions that take it."""

    code: CompiledController
    state: Any

    @property
    def xi(self) -> Vector:
        """ξ, (nc,)."""
        return np.array(self.state[: self.code.nc], float)

    def step(self, x: Sequence[float], dt: float) -> tuple[Vector, int]:
        """``necc_step``: what is measured (n,), s since the last sample -> u (m,), flags."""
        u = (self.code.real * self.code.m)()
        flags = self._call("step", x, self.code.n, u, self.code.real(dt))
        return np.array(u, float), flags

    def margin(self, x: Sequence[float]) -> float | None:
        """``necc_margin`` at what is measured (n,); None where the code has none."""
        if not hasattr(self.code.library, f"{self.code.prefix}_margin"):
            return None
        function = self.code._function("margin")
        function.restype = self.code.real
        return float(function(self.state, self.code._array(x, self.code.n)))

    def set_target(self, x: Sequence[float], r: Sequence[float]) -> int:
        """``necc_set_target``: what is measured (n,), a value per coordinate -> flags."""
        return self._call("set_target", x, self.code.n, self.code._array(r, self.code.n // 2))

    def target(self) -> Vector:
        """``necc_get_target``: the set-point that is applied, (n/2,)."""
        r = (self.code.real * (self.code.n // 2))()
        self.code._function("get_target")(self.state, r)
        return np.array(r, float)

    def set_parameter(self, theta: Sequence[float]) -> int:
        """``necc_set_parameter``: what the plant has now (p,) -> flags."""
        return self._call("set_parameter", theta, len(theta))

    def set_switch(self, how: int) -> None:
        """``necc_set_switch``: 0, ξ stays; 1, u stays; 2, V(x, ·) is least."""
        self.code._function("set_switch")(self.state, ctypes.c_int(how))

    def _call(self, name: str, values: Sequence[float], length: int, *more: Any) -> int:
        function = self.code._function(name)
        return int(function(self.state, self.code._array(values, length), *more))


def compile_controller(
    design: Design, *, flags: Sequence[str] = ("-O2",), **options: Any
) -> CompiledController:
    """Export `design`, compile it and load it; `options` are fields of Source.

    Raises
    ------
    OutputError
        When no C compiler is found, or it fails.
    """
    with tempfile.TemporaryDirectory(prefix="necc-") as folder:
        source = Source(design, **options)
        for name, text in (("necc.h", header(source)), ("necc.c", controller(source))):
            (Path(folder) / name).write_text(text, encoding="utf-8")
        return load_controller(Path(folder), prefix=source.prefix, flags=flags)


def load_controller(
    folder: Path,
    *,
    prefix: str = PREFIX,
    compiler: str | None = None,
    flags: Sequence[str] = ("-O2",),
) -> CompiledController:
    """Compile ``necc.c`` of `folder` (OUT/c) in a temporary folder and load it.

    Raises
    ------
    OutputError
        When no C compiler is found, or it fails, or the code has other names.
    """
    compiler = compiler or find_compiler()
    if compiler is None:
        raise OutputError("output", "no C compiler was found", _REMEDY)
    with tempfile.TemporaryDirectory(prefix="necc-") as build:
        target = Path(build) / "necc.so"
        compile_shared(compiler, [Path(folder) / "necc.c"], target, flags)
        library = ctypes.CDLL(str(target))
    try:
        n, nc, m, size = (ctypes.c_int * 4).in_dll(library, f"{prefix}_dimensions")
    except ValueError:
        raise OutputError(
            "output", f"{folder} holds no code with the prefix {prefix}", "Name the prefix."
        ) from None
    real = ctypes.c_float if size == ctypes.sizeof(ctypes.c_float) else ctypes.c_double
    return CompiledController(library, n, nc, m, real, prefix)


def compile_shared(
    compiler: str, sources: Sequence[Path], target: Path, flags: Sequence[str]
) -> None:
    """Compile C99 sources into a shared library, without contraction.

    Raises
    ------
    OutputError
        With the compiler's first message, when it fails.
    """
    command = [compiler, "-std=c99", "-ffp-contract=off", *flags, "-shared", "-fPIC"]
    command += [*map(str, sources), "-o", str(target), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        first = (done.stderr.strip().splitlines() or ["it said nothing"])[0]
        raise OutputError("output", f"{compiler} failed: {first}", _REMEDY)


def find_compiler() -> str | None:
    """The C compiler of this machine: CC, else cc, gcc or clang; None without one."""
    candidates = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next((path for name in candidates if name and (path := shutil.which(name))), None)
