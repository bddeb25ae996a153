"""Shaping V over the domain: objectives against plain numpy, and what the certificate gains."""

import json
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers import reference
from helpers.commands import DESIGN, check_refusal, design, process
from helpers.lifted import build
from helpers.models import BASE
from helpers.problems import PENDULUM, problem, solve
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.error_bound import loss
from necc_casadi.errors import OptionError
from necc_casadi.lyapunov.lyapunov import make_terms
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.model_file import load_model
from necc_casadi.model.samples import quasi_random
from necc_casadi.model.sizes import Sizes
from necc_casadi.performance.shares import sampled_share
from necc_casadi.synthesis import plan, shaping, training
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.options import Options, paper_options
from necc_casadi.synthesis.programs import hard_program
from necc_casadi.synthesis.shaping import SampleBox, average_over, height_over, moving_weights

EXAMPLES = PENDULUM.parent

#: The pendulum's box ±2 around z* = (q*, 0, ξ*); the momentum rests, its ceiling is p²/2 at 2.
BOX = SampleBox(
    lo=np.full(3, -2.0),
    hi=np.full(3, 2.0),
    active=(0, 2),
    shaped=(0, 2),
    ceiling=2.0,
    excess=lambda offsets: np.zeros(len(offsets)),
)
SIZE = np.array([1.0, 1.0, 2.0])
ENERGY = 0.7


def make(kind, gamma=1.3, seed=0, kept=(0,)):
    if kind == "regulariser":
        return average_over(gamma, BOX, SIZE, ENERGY, seed)
    return height_over(kept, BOX, SIZE, ENERGY, 0.4, seed)


@pytest.fixture(scope="module")
def maglev():
    return problem(load_model(EXAMPLES / "maglev.py"), None)


@pytest.fixture(scope="module")
def shares(maglev):
    designs = {s: solve(maglev, Options(shape=s)) for s in ("none", "regulariser", "level")}
    return {shape: (made, certify(made)) for shape, made in designs.items()}


@pytest.fixture(scope="module")
def loose_pendulum(pendulum):
    """The level of a pendulum for which no stiffness is said to leave one critical point."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "whole_space_stiffness", lambda plan: None)
        return solve(pendulum, Options(shape="level"))


def varied(made, seed):
    """The design with other weights in its output layers."""
    moving, rng = moving_weights(made.form), np.random.default_rng(seed)
    weights = made.weights.copy()
    weights[moving] += rng.normal(size=moving.size)
    return replace(made, weights=weights)


def rows_of(shaped, made):
    """The rows u of a design, from (A, b) that were made for other output layers."""
    A, b = shaped.rows(made.lyapunov.terms, made.form, varied(made, 99).weights, made.z_star)
    return A @ made.weights[moving_weights(made.form)] + b


# --- the objectives ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_regulariser_against_plain_numpy(default_design, seed):
    """ReLU((1/N) Σ ‖z − z*‖² − γ (V(z) − V(z*))), smooth, in natural units."""
    made, shaped = varied(default_design, seed), make("regulariser", seed=seed)
    V = reference.lyapunov(made)
    heights = [V(made.z_star + offset) - V(made.z_star) for offset in shaped.inner]
    squares = ((shaped.inner / SIZE) ** 2).sum(1)
    mean = np.mean(squares - 1.3 * np.array(heights) / ENERGY)
    u = rows_of(shaped, made)
    np.testing.assert_allclose(u, [mean], rtol=1e-10, atol=1e-10)
    value = float(shaped.objective(ca.DM(u), 0.0)) / shaping._REGULARISER_WEIGHT
    assert max(mean, 0) <= value <= max(mean, 0) + shaping._SMOOTHING / 2


def offset_by(made, amount):
    """V + amount, by the bias of Hc's output layer."""
    weights = made.weights.copy()
    weights[made.form.hc.size - 2 * made.form.hc.inputs - 1] += amount
    return replace(made, weights=weights)


@pytest.mark.parametrize("kind", ["regulariser", "level"])
def test_an_offset_of_V_changes_nothing(default_design, kind):
    """As published, with V(z) for V(z) − V(z*), an offset alone makes the regulariser vanish."""
    raised, shaped = offset_by(default_design, 100.0), make(kind)
    V, W = reference.lyapunov(default_design), reference.lyapunov(raised)
    z = default_design.z_star
    assert W(z) - V(z) == pytest.approx(100.0)
    np.testing.assert_allclose(rows_of(shaped, raised), rows_of(shaped, default_design), atol=1e-9)
    points = z + make("regulariser").inner
    published = [np.mean([p @ p - 0.2 * f(p) for p in points]) for f in (V, W)]
    assert published[0] > 0 > published[1]


@pytest.mark.parametrize("kept", [(0,), (0, 2)])
def test_rows_of_the_level_against_plain_numpy(default_design, kept):
    """Growth of w along rays and w on the boundary, w minimised by brute force."""
    made = default_design
    shaped = make("level", kept=kept).at(made.lyapunov, made.z_star)
    V, z = reference.lyapunov(made), made.z_star
    assert shaped.energy == pytest.approx(BOX.ceiling / 2)
    u = rows_of(shaped, made)
    growth, edge = u[: len(shaped.rays)], u[len(shaped.rays) :]

    def w(s):
        point = z.copy()
        point[list(kept)] = s
        if kept == (0, 2):
            return V(point)
        xi = np.linspace(-8, 8, 3201)
        values = [V(np.array([point[0], 0.0, v])) for v in xi]
        best = xi[int(np.argmin(values))]
        fine = np.linspace(best - 0.01, best + 0.01, 201)
        return min(V(np.array([point[0], 0.0, v])) for v in fine)

    for offset, value in list(zip(shaped.boundary, edge, strict=True))[::17]:
        height = w((z + offset)[list(kept)]) - V(z)
        assert value * shaped.energy == pytest.approx(height, abs=1e-4)
    for i in range(0, len(shaped.rays), 37):
        o = shaped.rays[i][list(kept)]
        s = z[list(kept)] + o
        slope = (w(s + 0.05 * o) - w(s - 0.05 * o)) / 0.1
        square = ((o / SIZE[list(kept)]) ** 2).sum()
        assert growth[i] * shaped.energy * square == pytest.approx(slope, abs=2e-2)


def test_the_objective_is_the_level_where_w_grows_everywhere():
    shaped = make("level")
    M = len(shaped.rays)
    u = np.full(shaped.count, 50.0)
    values = [float(shaped.objective(ca.DM(u), c)) for c in (0.5, 1.5)]
    assert values[0] - values[1] == pytest.approx(shaping._LEVEL_WEIGHT)
    margins = np.asarray(shaped.margins(ca.DM(u), 1.0)).ravel()
    np.testing.assert_allclose(margins, [1.0, *[49.0] * len(shaped.boundary)])
    u[:M] = -1.0  # w falls along every ray
    assert float(shaped.objective(ca.DM(u), 1.5)) > values[1] + 50 * shaping._LEVEL_WEIGHT


@pytest.mark.parametrize(("hidden", "activation"), [((6,), "tanh"), ((5, 4), "sin")])
def test_within_the_bounds_no_network_undoes_a_quadratic_part(hidden, activation):
    """What κ keeps below its network, for the worst output weights that are allowed."""
    form = Form(*(Network(2, hidden, activation, quadratic=True) for _ in range(2)))
    w_hat = 0.5 * form.initial(np.random.default_rng(3))
    for network, start in ((form.hc, 0), (form.k, form.hc.size)):
        w_hat[start + network.size - 4 : start + network.size - 2] = (1.0, 2.0)
    lower, upper = make("level").held(form, w_hat)
    assert (lower <= w_hat).all()
    assert (w_hat <= upper).all()
    rng = np.random.default_rng(4)
    for _ in range(20):
        worst = np.where(rng.random(form.size) < 0.5, lower, upper)
        worst = np.where(np.isfinite(worst), worst, w_hat)
        for network, part in zip((form.hc, form.k), form.split(worst), strict=True):
            floor = hessian_floor(network, part)
            assert np.linalg.eigvalsh(floor.mid)[0] > 0
    assert (upper - w_hat)[np.isfinite(upper)].min() > 0


@given(
    hidden=st.lists(st.integers(1, 4), max_size=2).map(tuple),
    activation=st.sampled_from(["tanh", "sin", "squareplus"]),
    quadratic=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=25, deadline=None)
def test_V_is_affine_in_what_moves(crane, hidden, activation, quadratic, seed):
    """V(m + s) + V(m − s) = 2 V(m) for every step s of output layers and κ."""
    form = Form(*(Network(2, hidden, activation, quadratic) for _ in range(2)))
    rng = np.random.default_rng(seed)
    weights, z = form.initial(rng), rng.normal(size=6)
    moving = moving_weights(form)
    assert len(set(moving)) == moving.size
    assert moving.min() >= 0
    assert moving.max() < form.size
    step = np.zeros(form.size)
    step[moving] = rng.normal(size=moving.size)
    base = solve_form(crane, form, weights)
    values = [
        reference.lyapunov(replace(base, weights=weights + sign * step))(z) for sign in (-1, 0, 1)
    ]
    assert values[0] + values[2] == pytest.approx(2 * values[1], rel=1e-9, abs=1e-9)


def solve_form(task, form, weights):
    return build(task, form, weights, np.zeros(2))


def test_large_networks_are_evaluated_alike(default_design, monkeypatch):
    shaped = make("level")
    scalars = rows_of(shaped, default_design)
    monkeypatch.setattr(shaping, "_SCALAR_WEIGHTS", 0)
    np.testing.assert_allclose(rows_of(shaped, default_design), scalars, rtol=1e-11, atol=1e-11)


# --- samples -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [(0,), (0, 2)])
def test_samples_lie_in_the_domain_and_on_its_boundary(kept):
    shaped = make("level", seed=3, kept=kept)
    others = [i for i in range(3) if i not in kept]
    for offsets in (shaped.rays, shaped.boundary):
        assert np.all(np.abs(offsets) <= 2.0)
        assert not offsets[:, others].any()
    assert np.all(np.abs(shaped.boundary[:, list(kept)]).max(1) == 2.0)
    sides = {
        (axis, np.sign(b[axis])) for b in shaped.boundary for axis in kept if abs(b[axis]) == 2
    }
    assert sides == {(axis, sign) for axis in kept for sign in (-1, 1)}


def test_states_that_no_casimir_contains_cap_the_level():
    """Their energy is of their own, whatever the networks do."""
    flat = replace(BOX, shaped=(2,), excess=lambda offsets: 0.1 * offsets[:, 0] ** 2)
    assert height_over((2,), flat, SIZE, ENERGY, 0.4, 0).energy == pytest.approx(0.2)


def test_minimisers_are_those_of_the_v_that_is_given(default_design):
    made = default_design
    shaped = make("level").at(made.lyapunov, made.z_star)
    for offset in shaped.rays[::20]:
        assert abs(made.lyapunov.gradient(made.z_star + offset)[2]) < 1e-9


@given(d=st.integers(1, 3), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_samples_fill_the_cube_evenly(d, seed):
    points = quasi_random(256, d, seed)
    assert points.shape == (256, d)
    assert np.all((points >= 0) & (points < 1))
    assert np.array_equal(points, quasi_random(256, d, seed))
    corners = np.random.default_rng(0).uniform(size=(20, d))
    counted = [(points < corner).all(1).mean() for corner in corners]
    np.testing.assert_allclose(counted, corners.prod(1), atol=0.06)


def test_many_dimensions_are_filled_too():
    points = quasi_random(500, 15, 1)
    assert abs(np.corrcoef(points.T) - np.eye(15)).max() < 0.3


# --- the program ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["regulariser", "level"])
def test_derivatives_that_are_written_by_hand(pendulum, kind):
    """Hessian of the Lagrangian and Jacobian against differences, in the variables that move."""
    form = Form(Network(1, (3,), quadratic=True), Network(1, (4,), quadratic=True))
    terms = make_terms(pendulum.loop, pendulum.casimirs)
    x, shaped = np.array([np.pi / 4, 0.0]), make(kind)
    lifting = Lifting(terms, form, x, Sizes.ones(3, 1, 1), np.zeros(1))
    program = hard_program(lifting, np.full(3, 0.4), None)
    anchor = training.Anchor(np.zeros(1))
    solver = training._Solver(lifting, program, 0.4, anchor, shaped, False)
    nlp, n = solver.solver, solver.n_small
    rng = np.random.default_rng(1)
    w0 = form.initial(rng)
    A, b, moving = solver._sampled(shaped, w0, np.zeros(1))
    p = np.concatenate([[0.0], w0, A.ravel(order="F"), b])
    point = np.concatenate([rng.uniform(0.5, 1.5, n), w0])
    free = np.concatenate([np.arange(n), n + moving])
    multipliers = rng.normal(size=nlp.size_in("lam_g0")[0])

    def constraints(v):
        return np.asarray(nlp.get_function("nlp_g")(z_at(v), p), float).ravel()

    def z_at(v):
        z = point.copy()
        z[free] = v
        return z

    def lagrangian_slope(v):
        f_slope = nlp.get_function("nlp_grad_f")(z_at(v), p)[-1]
        J = nlp.get_function("nlp_jac_g")(z_at(v), p)[-1]
        return np.asarray(f_slope, float).ravel()[free] + (np.asarray(J).T @ multipliers)[free]

    J = np.asarray(nlp.get_function("nlp_jac_g")(point, p)[-1])[:, free]
    np.testing.assert_allclose(J, reference.jacobian(constraints, point[free]), atol=1e-6)
    upper = np.asarray(nlp.get_function("nlp_hess_l")(point, p, 1.0, multipliers), float)
    hessian = (upper + np.triu(upper, 1).T)[np.ix_(free, free)]
    differences = reference.jacobian(lagrangian_slope, point[free], 1e-4)
    np.testing.assert_allclose(hessian, differences, atol=1e-5 * abs(hessian).max())


def test_target_is_assigned_exactly_whatever_the_shape(shares):
    for shape, (made, certificate) in shares.items():
        assert loss(made) <= 1e-12, shape
        assert certificate.certified, shape
        assert np.linalg.norm(made.z_bar - made.z_star) <= 1e-8
    assert [s.mode for s in shares["regulariser"][0].starts] == ["shaped"]
    assert [s.mode for s in shares["level"][0].starts] == ["hard", "shaped"]


def test_what_ends_the_region_is_raised_to_the_bound_of_the_model(shares):
    """Levitation, seed 0: a pass at 0.32 J, and the named bound of q at 3.9 J; 8.7 % and 18.6 %."""
    plain, shaped = (shares[shape][1].obstacle for shape in ("none", "level"))
    assert plain.kind == "critical_point"
    assert shaped.kind == "domain"
    assert shaped.at["q"] == pytest.approx(1)
    assert shaped.level_above_minimum > 8 * plain.level_above_minimum
    share = {shape: sampled_share(*shares[shape]) for shape in ("none", "level")}
    assert share["level"] > 1.8 * share["none"]
    assert len(shares["level"][1].region.kept) == 1  # V stays convex in ξ


def test_one_critical_point_comes_first(pendulum):
    """Where stiffness alone leaves no obstacle, there is nothing to shape."""
    made = solve(pendulum, Options(shape="level"))
    assert [start.mode for start in made.starts] == ["hard"]
    assert np.array_equal(made.weights, solve(pendulum, Options(whole=True)).weights)
    assert certify(made).is_global


def test_shaping_alone_leaves_one_critical_point_too(loose_pendulum):
    assert [start.mode for start in loose_pendulum.starts] == ["hard", "shaped"]
    assert loss(loose_pendulum) <= 1e-12
    assert certify(loose_pendulum).is_global


def test_nothing_is_shaped_that_no_casimir_contains():
    """The cart's pole bends V; no Casimir contains its angle."""
    task = problem(load_model(EXAMPLES / "cart_pole.py"), None)
    plain, shaped = (solve(task, Options(shape=shape)) for shape in ("none", "level"))
    assert np.array_equal(plain.weights, shaped.weights)


def test_shaped_certificate_is_proved_again(tmp_path, shares):
    made, certificate = shares["level"]
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert all(result.holds for result in check(tmp_path))
    text = certificate.to_json().replace(repr(certificate.level), repr(certificate.level + 0.3))
    assert text != certificate.to_json()
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    assert not all(result.holds for result in check(tmp_path))


def test_shaping_is_reproducible(maglev, shares):
    again, made = solve(maglev, Options(shape="level")), shares["level"][0]
    assert np.array_equal(again.weights, made.weights)
    assert np.array_equal(again.xi_star, made.xi_star)


def test_published_form_can_be_shaped(pendulum):
    plain, shaped = (
        certify(solve(pendulum, replace(paper_options(1), shape=shape))).obstacle
        for shape in ("none", "level")
    )
    assert shaped.level_above_minimum > 3 * plain.level_above_minimum


def test_several_inputs_and_casimirs(crane):
    made = solve(crane, Options(shape="regulariser", hidden_k=(8,), hidden_h=(6,)))
    assert made.starts[-1].mode == "shaped"
    assert loss(made) <= 1e-9
    level = solve(crane, Options(shape="level", hidden_k=(8,), hidden_h=(6,)))
    assert loss(level) <= 1e-12


def test_where_the_model_is_not_defined_counts_as_outside(tmp_path):
    """ln(1 + q) on a domain that reaches beyond its pole: the samples there stay finite."""
    path = tmp_path / "plant.py"
    text = "\nH = p**2 / 2 + q - sp.log(1 + q)\ndomain = {q: (-3, 4), p: (-2, 2)}\n"
    path.write_text(BASE + text, encoding="utf-8")
    task = problem(load_model(path), "q=1/2")
    for shape in ("level", "regulariser"):
        made = solve(task, Options(shape=shape))
        assert made.starts[-1].mode == "shaped"
        assert loss(made) <= 1e-9


def test_too_few_weights_fall_back_to_the_conditions_at_the_target(pendulum):
    """One neuron each and no quadratic part: the hidden layers have to move."""
    made = solve(
        pendulum, Options(shape="regulariser", quadratic=False, hidden_k=(1,), hidden_h=(1,))
    )
    assert made.starts[-1].mode != "shaped"


# --- options -------------------------------------------------------------------------------------

CLASHES = [
    ({"shape": "round"}, "round"),
    ({"gamma": 2.0}, "gamma"),
    ({"shape": "level", "gamma": 2.0}, "gamma"),
    ({"shape": "regulariser", "gamma": -1.0}, "gamma"),
    ({"shape": "regulariser", "gamma": float("nan")}, "gamma"),
    ({"shape": "level", "phi": "neural"}, "--phi"),
    ({"shape": "level", "learn_casimir": True}, "--learn-casimir"),
    ({"shape": "level", "convex": True}, "--global"),
]


@pytest.mark.parametrize(("chosen", "piece"), CLASHES)
def test_options_that_cannot_be_met_are_refused(pendulum, chosen, piece):
    with pytest.raises(OptionError, match=re.escape(piece)) as raised:
        solve(pendulum, Options(**chosen))
    assert raised.value.code == "usage"
    assert raised.value.remedy


def test_sum_of_betas_is_refused(crane):
    with pytest.raises(OptionError, match=r"K\(Σ") as raised:
        solve(crane, Options(shape="level", casimir_form="sum"))
    assert "--casimir-form joint" in raised.value.remedy


@pytest.mark.parametrize("arguments", [
    ["--shape", "round"],
    ["--shape", "regulariser", "--gamma", "0"],
    ["--shape", "regulariser", "--gamma", "nan"],
    ["--gamma", "2"],
    ["--shape", "level", "--global"],
    ["--shape", "level", "--phi", "neural"],
    ["--shape", "level", "--learn-casimir"],
])  # fmt: skip
def test_bad_values_on_the_command_line(tmp_path, arguments):
    out = tmp_path / "out"
    result = design(PENDULUM, "--target", "pi/4", "--json", "--out", out, *arguments)
    check_refusal(result, "usage")
    assert not out.exists()


def test_the_command_as_a_process(tmp_path):
    done = process(
        DESIGN, PENDULUM, "--target", "pi/4", "--shape", "level", "--json", "--no-plots",
        "--out", "out", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["status"] == "certified"
    assert data["choice"]["kept"] == "shaped"
    assert data["certificate"]["global"]


def test_help_explains_the_options(tmp_path):
    done = process(DESIGN, "--help", cwd=tmp_path)
    assert done.returncode == 0
    section = done.stdout.split("Region of attraction:")[1].split("Solver and damping:")[0]
    assert "--shape [none|regulariser|level]" in section
    assert "--gamma" in section
    assert "[default: none]" in " ".join(section.split())
