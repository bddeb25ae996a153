"""Activation functions, the start ξ(0), saturation and the self-test of the exported C."""

import dataclasses
import subprocess

import numpy as np
import pytest
from helpers.export_cases import COMPILERS, STRICT, arm_loop, design, paper_design, pendulum_loop

from necc_casadi.designs.design import Design
from necc_casadi.export.c_project import export_c
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.networks import GROUP
from necc_casadi.export.templating import fill
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form

SATURATED, REJECTED, NOT_CONVERGED = 1, 2, 4

SWEEP = """
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
typedef {real} necc_real;
#define LANES 32
#define R(literal) {literal}
{function}
static long double squareplus(long double x) {{ return (x + sqrtl(x * x + 4)) / 2; }}
int main(void)
{{
    long double worst = 0, worst_slope = 0;
    uint64_t bits = 0, hash = 0;
    for (long i = 0; i < 400000; ++i) {{
        necc_real a[LANES], slope[LANES];
        /* half of the points on a grid, half with random exponents down to the subnormals */
        const double grid = -{range} + 2 * {range} * (double)i / 400000.0;
        const double small = ldexp((double)(i % 1009) / 1009.0, -(int)(i % {exponents}));
        const necc_real x = (necc_real)(i % 2 ? grid : small);
        for (int k = 0; k < LANES; ++k) a[k] = x;
        activate_{name}(a, slope);
        const long double exact = {oracle};
        const long double unit = fabsl(exact) > {floor} ? fabsl(exact) : {floor};
        const long double error = fabsl((long double)a[0] - exact) / unit / {eps};
        const long double e = fabsl((long double)slope[0] - ({derivative})) / {eps};
        if (!(error <= worst)) worst = error;
        if (!(e <= worst_slope)) worst_slope = e;
        memcpy(&bits, &a[0], sizeof a[0]);
        hash = (hash ^ bits) * 1099511628211u;
        if (!(fabs((double)a[0]) <= 1) && {bounded}) return 1;
    }}
    printf("%.6Lg %.6Lg %016llx", worst, worst_slope, (unsigned long long)hash);
    return 0;
}}
"""
ORACLES = {
    "tanh": ("tanhl((long double)x)", "1 - exact * exact", 25, 1, "{tiny}"),
    "sin": ("sinl((long double)x)", "cosl((long double)x)", 500, 1, "1"),
    "squareplus": (
        "squareplus((long double)x)",
        "(1 + (long double)x / sqrtl((long double)x * x + 4)) / 2",
        30,
        0,
        "1",
    ),
}


def sweep(tmp_path, name, real, compiler, flags):
    """Largest errors of activation and derivative in units of eps, and a hash of all values."""
    number = Real(real)
    oracle, derivative, limit, bounded, floor = ORACLES[name]
    typed = name if name == "squareplus" else f"{name}_{real}"
    source = SWEEP.format(
        real=real,
        literal=f"literal##{number.suffix}" if number.suffix else "literal",
        function=fill(f"{typed}.c", sqrt=f"sqrt{number.suffix}"),
        name=name,
        range=limit,
        exponents=140 if number.suffix else 1060,
        oracle=oracle,
        derivative=derivative,
        eps=number.eps,
        bounded=bounded,
        floor=floor.format(tiny=number.tiny),
    )
    (tmp_path / "sweep.c").write_text(source)
    command = [compiler, "-std=gnu99", "-ffp-contract=off", *flags, str(tmp_path / "sweep.c")]
    subprocess.run([*command, "-o", str(tmp_path / "sweep"), "-lm"], check=True)
    done = subprocess.run([str(tmp_path / "sweep")], check=True, capture_output=True, text=True)
    value, slope, bits = done.stdout.split()
    print(name, real, compiler, flags, value, slope)
    return (float(value), float(slope)), bits


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(
    ("name", "value_error", "slope_error"),
    [("tanh", 3, 6), ("sin", 1.5, 1.5), ("squareplus", 33, 2)],
)
def test_activation_errors_in_eps_and_the_same_bits_from_every_compiler(
    tmp_path, name, real, value_error, slope_error
):
    bits = set()
    for compiler in COMPILERS:
        for flags in (["-O0"], ["-O2"], ["-O3", "-march=native"]):
            (value, slope), printed = sweep(tmp_path, name, real, compiler, flags)
            bits.add(printed)
            assert value <= value_error
            assert slope <= slope_error
    assert len(bits) == 1


def confining(loop_and_casimirs, seed=1):
    """A design whose V(x₀, ·) grows in every direction of ξ."""
    loop, casimirs = loop_and_casimirs
    nc, r = loop.controller.nc, len(casimirs.functions)
    hc, k = Network(nc, (12,), quadratic=True), Network(r, (9,), quadratic=True)
    return design(loop_and_casimirs, Form(hc, k), seed)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("loop", [pendulum_loop(), arm_loop()], ids=["pendulum", "arm"])
@pytest.mark.parametrize("neural", [False, True])
def test_init_at_is_a_strict_minimum_of_V_in_xi(loop, real, neural):
    d = confining(loop)
    if neural:
        form = Form(d.form.hc, d.form.k, phi=MonotonePhi(4))
        d = design(loop, form, 1)
    compiled = compile_controller(d, real=real, flags=STRICT)
    rng = np.random.default_rng(0)
    for _ in range(10):
        x0 = np.float32(rng.uniform(-2, 2, compiled.n)).astype(float)
        xi, flags = compiled.init_at(x0)
        assert flags == 0
        z = np.concatenate([x0, xi])
        gradient = np.asarray(d.lyapunov.gradient(z), float).ravel()[compiled.n :]
        assert np.abs(gradient).max() <= {"double": 1e-12, "float": 1e-4}[real]
        hessian = np.asarray(d.lyapunov.hessian(z), float)[compiled.n :, compiled.n :]
        assert np.linalg.eigvalsh(hessian)[0] > 0
        start = np.concatenate([x0, d.xi_star])
        assert d.V(z) <= d.V(start) + 1e-6


def test_init_at_says_when_there_is_no_minimum_and_refuses_what_is_not_finite():
    d = design(pendulum_loop(), Form(Network(1, ()), Network(1, ())))  # V linear in ξ
    compiled = compile_controller(d, flags=STRICT)
    xi, flags = compiled.init_at([0.1, 0.2])
    assert flags == NOT_CONVERGED
    assert np.isfinite(xi).all()
    xi, flags = compiled.init_at([np.nan, 0.2])
    assert (flags, list(xi)) == (REJECTED, list(d.xi_star))


@pytest.mark.parametrize("word", ["target", "linear", "minimum"])
@pytest.mark.parametrize("loop", [pendulum_loop(), arm_loop()], ids=["pendulum", "arm"])
def test_xi_starts_in_c_where_the_design_says(loop, word):
    d = confining(loop)
    n, nc = d.loop.plant.n, d.loop.controller.nc
    gain = np.random.default_rng(2).normal(size=(nc, n)) if word == "linear" else None
    d = dataclasses.replace(d, initial_xi=word, initial_gain=gain)
    stored = Design.from_text(d.text)
    assert stored.initial_xi == word
    assert (
        np.array_equal(stored.initial_gain, gain) if gain is not None else not stored.initial_gain
    )
    compiled = compile_controller(d, flags=STRICT)
    rng = np.random.default_rng(3)
    for _ in range(10):
        x0 = rng.uniform(-2, 2, compiled.n)
        xi, flags = compiled.start(x0)
        assert flags == 0
        np.testing.assert_allclose(xi, d.xi_at_start(x0), atol=1e-9)
        assert np.array_equal(xi, d.xi_star) == (word == "target")
        if gain is not None:
            np.testing.assert_allclose(xi - d.xi_star, gain @ (x0 - d.z_star[:n]), atol=1e-9)
    for bad in (np.nan, np.inf):
        xi, flags = compiled.start(np.full(n, bad))
        assert (flags == REJECTED) == (word != "target")
        assert np.array_equal(xi, d.xi_star)


@pytest.mark.parametrize("limits", [((-0.5, 0.75),), ((float("-inf"), 0.25),)])
def test_saturation_clips_u_raises_its_flag_and_leaves_xi_alone(limits):
    form = Form(Network(1, (5,)), Network(1, (6,)))
    limited, free = (
        compile_controller(
            dataclasses.replace(design(of, form), damping=np.diag([5.0, 6.0])), flags=STRICT
        )
        for of in (pendulum_loop(limits), pendulum_loop())
    )
    seen = set()
    for p in np.linspace(-1, 1, 21):
        u, xi, flags = limited.step([0.1], [0.2, p], 0.01)
        v, xi_free, _ = free.step([0.1], [0.2, p], 0.01)
        assert u == np.clip(v, *limits[0])
        assert flags == (SATURATED if u != v else 0)
        assert xi == xi_free
        seen.add(flags)
    assert seen == {0, SATURATED}
    assert limited.step([0.1], [np.inf, 0], 0.01)[2] == REJECTED


SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


BUILDS = [(compiler, []) for compiler in COMPILERS] + [("gcc", SANITIZERS)] * ("gcc" in COMPILERS)


@pytest.mark.parametrize(("compiler", "sanitize"), BUILDS)
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_self_test_passes_and_fails_when_a_weight_is_wrong(tmp_path, compiler, real, sanitize):
    d = design(pendulum_loop(((-2.0, 1.0),)), Form(Network(1, (5,)), Network(1, (6,))))
    export_c(d, tmp_path, real=real, sample_time=0.01, measured=False)
    sources = [str(tmp_path / name) for name in ("necc.c", "selftest.c")]

    def build_and_run():
        command = [compiler, *STRICT, *sanitize, "-O2", *sources, "-o", str(tmp_path / "t"), "-lm"]
        subprocess.run(command, check=True)
        return subprocess.run([str(tmp_path / "t")], capture_output=True, text=True, check=False)

    done = build_and_run()
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 failures" in done.stdout
    code = (tmp_path / "necc.c").read_text()
    weight = f"hc_w2[{GROUP + 1}] = {{\n    "
    assert weight in code
    (tmp_path / "necc.c").write_text(code.replace(weight, weight + "9 +"))
    assert build_and_run().returncode == 1


def test_cmake_builds_it_and_runs_its_test(tmp_path):
    export_c(paper_design((5,), (7,)), tmp_path / "c", measured=False)
    build = str(tmp_path / "build")
    for command in (
        ["cmake", "-S", str(tmp_path / "c"), "-B", build],
        ["cmake", "--build", build],
        ["ctest", "--test-dir", build],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "100% tests passed" in done.stdout
