"""The same bits from every compiler and processor, and CasADi's MEX route."""

import importlib.util
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers.export_cases import COMPILERS, design, paper_design, pendulum_loop

from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import load_controller
from necc_casadi.export.controller import c_networks
from necc_casadi.export.matlab import export_mex
from necc_casadi.export.operations import count_networks
from necc_casadi.export.source import Source
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "export.py"
ARM = all(shutil.which(tool) for tool in ("arm-none-eabi-gcc", "qemu-system-arm"))
NETWORKS = [Network(1, (20, 9), name, True) for name in ("tanh", "sin", "squareplus")]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("network", NETWORKS, ids=lambda network: network.activation)
def test_every_compiler_and_optimisation_gives_the_same_bits(tmp_path, network, real):
    # The pendulum's law calls no function of the C library, so all of it must agree.
    export_c(design(pendulum_loop(), Form(network, network)), tmp_path, real=real, measured=False)
    rng = np.random.default_rng(0)
    points = rng.uniform(-4, 4, (50, 3)).astype(np.float32).astype(float)
    results = set()
    for compiler in COMPILERS:
        for flags in (["-O0"], ["-O2"], ["-Os"], ["-O3", "-march=native"]):
            loaded = load_controller(tmp_path, compiler=compiler, flags=flags)
            values = [loaded.step(z[2:], z[:2], 0.01)[:2] for z in points]
            results.add(np.array(values).tobytes())
    assert len(results) == 1


def test_mex_source_computes_the_control_law(tmp_path):
    d = design(pendulum_loop(), Form(Network(1, (5,)), Network(1, (6,)), phi=MonotonePhi(3)))
    path = export_mex(d, tmp_path)
    assert "mexFunction" in path.read_text()
    library = tmp_path / "law.so"
    command = [COMPILERS[0], "-shared", "-fPIC", str(path), "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    external = ca.external("necc_control", str(library))
    got = np.concatenate([np.asarray(v, float).ravel() for v in external([0.3, 0.1], [0.2])])
    np.testing.assert_allclose(got, np.concatenate(d.control([0.3, 0.1], [0.2])), atol=1e-13)


if ARM:

    @pytest.fixture(scope="module")
    def benchmark():
        spec = importlib.util.spec_from_file_location("export_benchmark", BENCHMARK)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    @pytest.mark.slow
    def test_cortex_m_gives_our_bits_within_its_budget(tmp_path, benchmark):
        sizes = {"d2": paper_design(), "d1": paper_design((32,), (64,))}
        counts = {}
        for name, d in sizes.items():
            for real in ("float", "double"):
                export_c(d, tmp_path / f"{name}_{real}", real=real, measured=False)
                counts[name, real] = count_networks(c_networks(Source(d, real)), real)
        budget, seen = {"d2": 50_000, "d1": 8_000}, set()
        for name, level, core, real, row in benchmark.cortex(tmp_path):
            instructions, stack, flash, bss, same = row
            wide = 2 if real == "double" else 1
            assert same == "yes"
            assert int(bss) == 0
            assert int(stack) <= wide * 1536
            assert int(flash) <= wide * 30 * 1024
            each = counts[name, real].items()
            arithmetic = sum(number for kind, number in each if kind != "weights")
            assert arithmetic < int(instructions) < 3 * arithmetic
            seen.add((core, real))
            if level == "-O3":
                assert int(instructions) <= budget[name]
        assert len(seen) == 3
