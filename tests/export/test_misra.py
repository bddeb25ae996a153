"""The exported C under strict compilers, and MISRA C:2012: what the README says, and no more."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import of_small_level
from helpers.export_cases import COMPILERS, STRICT, arm_loop, design, pendulum_loop
from helpers.velocity import pendulum, pendulum_with_load

from necc_casadi.export.c_project import export_c
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form

LIMITED = pendulum_loop(((-2.0, 1.0),))
SMALL = Form(
    Network(1, (40, 20), quadratic=True),
    Network(1, (20,), "sin", quadratic=True),
    phi=MonotonePhi(4),
)
SUM = Form(
    Network(2, (32, 32)), Network(1, (64,), "squareplus"), (Network(1, (5,)), Network(1, ()))
)
KEPT = Form(Network(1, (40,), quadratic=True), Network(1, (20,), quadratic=True))
CASES = {
    "float": (LIMITED, SMALL, "heun"),
    "double": (arm_loop(), SUM, "rk4"),
    "kept": (LIMITED, KEPT, "casimir"),
    "clipped": (LIMITED, KEPT, "heun"),
}
PEDANTIC = [
    "-Wcast-qual", "-Wcast-align", "-Wswitch-default", "-Wstrict-prototypes", "-Wundef",
    "-Wwrite-strings", "-Wfloat-conversion", "-Wsign-conversion", "-Wpointer-arith", "-Wvla",
    "-Wredundant-decls", "-Wbad-function-cast", "-Wformat=2",
]  # fmt: skip


def exported(folder, real):
    if real == "moving":  # a set-point and a load that change at run time
        told = pendulum_with_load(l=(sp.Rational(-1, 5), sp.Rational(1, 2)))
        made = replace(pendulum(), setpoints={"q": (sp.Integer(-2), sp.Integer(2))}, told=told)
        export_c(made, folder, real="float", certificate=of_small_level(made))
        return folder / "necc.c"
    loop, form, integrator = CASES[real]
    made = design(loop, form)  # its damping is full, so that limits scale it
    if real == "clipped":
        made = replace(made, damping=np.diag([5.0, 6.0]))
    assert made.scales_damping == (real in ("float", "kept"))
    number = "double" if real == "double" else "float"
    export_c(made, folder, real=number, integrator=integrator, sample_time=0.01, measured=False)
    return folder / "necc.c"


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("real", [*CASES, "moving"])
def test_no_warning_of_a_strict_compiler(tmp_path, real, compiler):
    code = exported(tmp_path, real)
    assert code.read_bytes().isascii()
    assert (tmp_path / "necc.h").read_bytes().isascii()
    command = [compiler, *STRICT, *PEDANTIC, "-O2", "-c", str(code), "-o", str(tmp_path / "n.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


if shutil.which("cppcheck"):

    @pytest.mark.slow
    def test_misra_deviations_are_those_of_the_readme(tmp_path):
        found = set()
        for real in (*CASES, "moving"):
            code = exported(tmp_path / real, real)
            command = ["cppcheck", "--std=c99", "-DFLT_EVAL_METHOD=0", "--addon=misra", "-q"]
            command += ["--enable=warning,style,performance,portability", str(code)]
            command += ["--suppress=missingIncludeSystem", "--template={id}: {message}"]
            command += [f"--suppress=misra-c2012-{rule}" for rule in ("2.5", "8.7")]  # of programs
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            said = set(re.findall(r"^([\w.-]+): ", done.stderr, re.MULTILINE))
            assert said
            assert {name for name in said if not name.startswith("misra-")} == set()
            found |= {name.removeprefix("misra-c2012-") for name in said}
        readme = (tmp_path / "float" / "README.md").read_text()
        assert found == set(re.findall(r"^\| (\d+\.\d+) \|", readme, re.MULTILINE))
