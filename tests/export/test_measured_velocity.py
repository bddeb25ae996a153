"""Controllers that take (q, q̇): the same law, in Python, in C and in what stands beside it."""

import subprocess
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import sympy as sp
from helpers.export_cases import COMPILERS, STRICT, arm_loop, design

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.design import Design
from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.controller import controller
from necc_casadi.export.header import header
from necc_casadi.export.source import Source
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form


@cache
def arm(neural=False, momenta=False) -> Design:
    """An arm that measures q̇; with a Casimir in the momenta the law needs its inertia."""
    loop, casimirs = arm_loop()
    _, q2, p1, p2 = loop.plant.x
    loop = replace(loop, plant=replace(loop.plant, inertia=sp.diag(3 + 2 * sp.cos(q2), 1)))
    if momenta:
        first, second = casimirs.functions
        casimirs = Casimirs((first + p1 * p2 / 3, second), 2, 2)
    networks = Network(2, (6,), quadratic=True), Network(2, (5,), quadratic=True)
    return design((loop, casimirs), Form(*networks, phi=MonotonePhi(4) if neural else None), 3)


@pytest.mark.parametrize("neural", [False, True])
@pytest.mark.parametrize("momenta", [False, True])
def test_the_law_is_that_of_the_momenta(neural, momenta):
    made = arm(neural, momenta)
    V, rng = made.lyapunov, np.random.default_rng(1)
    x, xi = rng.uniform(-2, 2, (7, 4)), rng.uniform(-2, 2, (7, 2))
    y = V.measured(x)
    assert V.state(y) == pytest.approx(x)
    at_states = V.control_law(x, xi)
    measured = [np.asarray(v).T for v in V.measured_law_function.call([y.T, xi.T])]
    for wanted, found, again in zip(at_states, measured, made.control(y, xi), strict=True):
        assert found == pytest.approx(wanted, rel=1e-12)
        assert again == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_code_computes_it(tmp_path, real):
    made = arm(momenta=True)
    compiled = compile_controller(made, real=real, flags=STRICT)
    x = made.lyapunov.state([0.3, -0.5, 0.7, -0.2])
    u, rate = made.lyapunov.control_law(x, [0.2, 0.4])
    tolerance = {"double": 1e-12, "float": 1e-4}[real]
    found_u, found_rate = compiled.control([0.3, -0.5, 0.7, -0.2], [0.2, 0.4])
    assert found_u == pytest.approx(u, rel=tolerance)
    assert found_rate == pytest.approx(rate, rel=tolerance, abs=tolerance)
    xi, flags = compiled.init_at([0.3, -0.5, 0.7, -0.2])
    assert flags == 0
    z = np.concatenate([x, xi])
    assert np.abs(made.lyapunov.gradient(z)[4:]).max() < 10 * tolerance


def test_the_self_test_and_the_demonstration_run(tmp_path):
    gain = np.array([[0.2, 0.0, 0.3, 0.1], [0.0, 0.1, 0.0, -0.2]])
    made = replace(arm(), initial_xi="linear", initial_gain=gain)
    export_c(made, tmp_path, measured=False)
    for name in ("selftest", "main"):
        command = [COMPILERS[0], *STRICT, f"{name}.c", "necc.c", "-o", name, "-lm"]
        subprocess.run(command, cwd=tmp_path, check=True)
    subprocess.run(["./selftest"], cwd=tmp_path, check=True)
    start = [0.3, -0.5, 0.7, -0.2]
    run = subprocess.run(
        ["./main", "2", *map(str, start)], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    head, first, _ = run.stdout.splitlines()
    assert head.startswith("t,q1,q2,q1_dot,q2_dot,xi1,xi2,")
    row = [float(v) for v in first.split(",")]
    assert row[1:5] == start
    assert row[5:7] == pytest.approx(made.xi_at_start(start))
    u, _ = made.control(start, row[5:7])
    assert row[7:9] == pytest.approx(u)


def test_the_header_says_what_x_is():
    text = header(Source(arm()))
    assert "x[2]  q1_dot" in text
    assert "x is measured: coordinates and their rates" in text
    assert "state of the plant" in header(Source(design(arm_loop(), arm().form)))


def test_the_published_law_holds_no_mass():
    """The same networks with another inertia, potential and friction give the same code."""
    made = arm()
    plant = made.loop.plant
    q1, _, p1, p2 = plant.x
    other = replace(
        plant,
        inertia=sp.diag(5, 2 + sp.cos(q1)),
        H=p1**2 / 10 + p2**2 / 2 / (2 + sp.cos(q1)) + q1**4,
        R=sp.diag(0, 0, 3, 0),
    )
    changed = replace(made, loop=replace(made.loop, plant=other))
    texts = [controller(Source(d)).split("*/", 1)[1] for d in (made, changed)]
    kept = [text.replace(d.hash[:16], "") for text, d in zip(texts, (made, changed), strict=True)]
    assert kept[0] == kept[1]
    needs = replace(arm(momenta=True), loop=changed.loop)
    assert controller(Source(needs)).count("cos(") > controller(Source(made)).count("cos(")
