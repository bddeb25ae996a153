"""Power shaping: the outputs it finds, the loop it makes, and what is proved of it."""

import dataclasses
import json

import numpy as np
import pytest
import sympy as sp
from helpers.problems import solve
from helpers.shaped import lossy_motor, machine, parallel_rlc, shaped_problem
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.design import Design
from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import compile_controller
from necc_casadi.methods.method import Method, Refusal
from necc_casadi.methods.shaping import power_shaping, shaping_functions
from necc_casadi.model.plant import make_plant
from necc_casadi.simulation.saturated import saturated_field
from necc_casadi.symbolic.zero import is_zero

PROBLEMS = {"parallel RLC": parallel_rlc, "motor": lossy_motor, "machine": machine}


@pytest.fixture(
    scope="module",
    params=[pytest.param(p, marks=[pytest.mark.slow] * (p == "machine")) for p in PROBLEMS],
)
def task(request):
    return shaped_problem(*PROBLEMS[request.param]())


@pytest.fixture(scope="module")
def made(task) -> Design:
    return solve(task)


def states(design, count=20, reach=0.3):
    rng = np.random.default_rng(0)
    spread = rng.uniform(-1, 1, (count, design.loop.n)) * design.sizes.state
    return design.z_star + reach * spread


def at(matrix, symbols, z):
    function = sp.lambdify([symbols], matrix, "numpy")
    return np.array([np.array(function(row), float) for row in z])


def test_what_the_published_loop_refuses_is_held(task):
    assert task.published.reason in ("invisible_gradient", "invisible_negative_curvature")
    assert task.verdict.assignable
    assert task.verdict.stability == "asymptotic"
    loop = task.loop
    assert all(is_zero(entry) for entry in loop.mismatch)
    for c in task.casimirs.functions:
        slope = sp.Matrix([c]).jacobian(loop.z)
        assert all(is_zero(e) for e in slope * loop.M)
        assert all(is_zero(e) for e in loop.M * slope.T)


def test_the_loop_as_built_is_the_one_of_the_theory(task, made):
    """ż = (M/Φ₁ − 𝒢𝒟𝒢ᵀ)∇V, and ẋ = (F − GDGᵀ)∇ₓW, η̇ = −Dc∇_ηW in what the controller keeps."""
    z, V, loop = states(made), made.lyapunov, made.loop
    field, slope = V.vector_field(z), V.gradient(z)
    M, ports = at(loop.M, loop.z, z), at(loop.ports, loop.z, z)
    flow = M - np.einsum("bij,jk,blk->bil", ports, made.damping, ports)
    scale = np.abs(field).max(axis=0) + 1e-300
    assert np.abs((field - np.einsum("bij,bj->bi", flow, slope)) / scale).max() < 1e-10
    n, m = loop.plant.n, loop.plant.m
    D, Dc = made.damping[:m, :m], made.damping[m:, m:]
    assert not made.damping[:m, m:].any()
    dgamma = at(loop.slopes, loop.plant.x, z[:, :n])
    F, G = (at(A, loop.plant.x, z[:, :n]) for A in (loop.plant.J - loop.plant.R, loop.plant.G))
    W_x = slope[:, :n] + np.einsum("bij,bj->bi", dgamma, slope[:, n:])
    x_dot = np.einsum("bij,bj->bi", F - np.einsum("bij,jk,blk->bil", G, D, G), W_x)
    assert np.abs((field[:, :n] - x_dot) / scale[:n]).max() < 1e-9
    kept = field[:, n:] - np.einsum("bji,bj->bi", dgamma, field[:, :n])
    assert np.abs((kept + slope[:, n:] @ Dc.T) / scale[n:]).max() < 1e-9


def test_clipped_inputs_do_not_pull_the_controller_off(task):
    """ξ − γ(x) moves by v_c alone, whatever the plant gets."""
    made = solve(task)
    limits = tuple((u - 1e-3, u + 1e-3) for u in np.atleast_1d(holding(made)))
    plant = dataclasses.replace(made.loop.plant, u_limits=limits)
    tight = dataclasses.replace(made, loop=dataclasses.replace(made.loop, plant=plant))
    z = states(tight)
    clipped = np.asarray(saturated_field(tight)(z.T), float).T
    free = tight.lyapunov.vector_field(z)
    n = plant.n
    dgamma = at(tight.loop.slopes, plant.x, z[:, :n])
    kept = [f[:, n:] - np.einsum("bji,bj->bi", dgamma, f[:, :n]) for f in (clipped, free)]
    assert np.abs(clipped - free).max() > 0
    assert np.abs(kept[0] - kept[1]).max() <= 1e-9 * np.abs(kept[1]).max()


def holding(design):
    return design.control(design.z_star[: design.loop.plant.n], design.xi_star)[0]


def test_certified_and_checked_again(made, tmp_path):
    certificate = certify(made)
    assert certificate.certified
    assert certificate.stability == "asymptotic"
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    export_c(made, tmp_path / "c", certificate=certificate, measured=False)
    results = [r for r in check(tmp_path) if r.name != "code"]  # the folder lists no files
    assert [(r.name, r.statement) for r in results if not r.holds] == []
    assert Design.load(tmp_path).hash == made.hash


@pytest.mark.parametrize("entry", ["gamma", "alpha", "D"])
def test_the_checker_refuses_another_output(tmp_path, entry):
    made = solve(shaped_problem(*parallel_rlc()))
    certificate = certify(made, region=False)
    data = json.loads(made.text)
    if entry == "gamma":
        data["model"]["gamma"] = ["2*q + phi"]
    elif entry == "alpha":
        data["model"]["alpha"] = [["2"]]
    else:
        data["D"] = [[(-1.0).hex()]]
    (tmp_path / "design.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    results = {r.name: r.holds for r in check(tmp_path)}
    assert not results["design"]
    assert not results["damping" if entry == "D" else "structure"]
    assert not results["decrease"]


def test_the_parallel_rlc_is_proved_from_everywhere():
    task = shaped_problem(*parallel_rlc())
    q, phi = task.loop.plant.x
    assert task.loop.shaping == (q + phi / 2,)
    assert certify(solve(task)).is_global


def test_a_voltage_fed_magnet_is_refused_with_proof():
    """No passive output of this J − R curves V along the gap; a supply of another kind may."""
    q, p, lam = sp.symbols("q p lam", real=True)
    J = sp.Matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
    H = p**2 / 2 + lam**2 * (1 - q) / 2 + q
    plant = make_plant((q, p, lam), J, sp.diag(0, 0, 1), sp.Matrix([0, 0, 1]), H)
    point = {q: sp.Rational(1, 2), p: sp.Integer(0), lam: sp.sqrt(2)}
    refusal = power_shaping(plant, point)
    assert isinstance(refusal, Refusal)
    assert refusal.proved
    assert "this J − R" in refusal.reason


@st.composite
def plants(draw):
    """Linear plants with a full rank of J − R, one or two inputs."""
    n, m = draw(st.integers(2, 4)), draw(st.integers(1, 2))
    number = st.integers(-3, 3).map(sp.Integer)
    A = sp.Matrix(n, n, lambda i, j: draw(number))
    L = sp.Matrix(n, n, lambda i, j: draw(number) if j <= i else 0)
    G = sp.Matrix(n, min(m, n - 1), lambda i, j: draw(number))
    return A - A.T, L * L.T, G


@given(plants())
@settings(max_examples=40, deadline=None)
def test_as_many_outputs_as_a_constant_structure_has(case):
    """n − rank(G⊥F) functions, each with F∇γ = −Gα; the loop's M is dissipative."""
    J, R, G = case
    n = J.rows
    if G.rank() < G.cols:
        return
    x = sp.symbols(f"x1:{n + 1}", real=True)
    H = sum(s**2 for s in x) / 2 + x[0]
    plant = make_plant(x, J, R, G, H)
    found = shaping_functions(plant, {})
    left = sp.Matrix.vstack(*[v.T for v in G.T.nullspace()]) * (J - R)
    assert len(found.functions) == found.generic_count == n - left.rank()
    answer = power_shaping(plant, dict.fromkeys(x, sp.Integer(0)))
    if isinstance(answer, Method):
        loop = answer.loop
        assert all(is_zero(e) for e in loop.mismatch)
        symmetric = np.array(loop.M + loop.M.T, float)
        assert np.linalg.eigvalsh(symmetric).max() <= 1e-9 * max(1.0, np.abs(symmetric).max())


def test_the_emitted_controller_is_the_law_in_what_is_kept():
    """Compiled C against CasADi: u, and the rate of ξ − γ(x)."""
    made = solve(shaped_problem(*machine()))
    library = compile_controller(made)
    law, n = made.lyapunov.control_law_function, made.loop.plant.n
    for z in states(made, 5):
        x, kept = z[:n], made.lyapunov.stored(z[:n], z[n:])
        u, rate = (np.asarray(v, float).ravel() for v in law.call([x, kept]))
        found_u, found_rate = library.control(x, kept)
        assert np.allclose(found_u, u, rtol=1e-11, atol=1e-11 * np.abs(u).max())
        assert np.allclose(found_rate, rate, rtol=1e-9, atol=1e-11 * np.abs(rate).max())
