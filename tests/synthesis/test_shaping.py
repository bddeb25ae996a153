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
from necc_casadi.synthesis import shaping, training
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.options import Level, Options, Regulariser, paper_options
from necc_casadi.synthesis.programs import hard_program
from necc_casadi.synthesis.shaping import SampleBox, make_shaping, moving_weights

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


def make(kind, gamma=1.3, seed=0):
    asked = Level() if kind == "level" else Regulariser(gamma)
    return make_shaping(asked, BOX, SIZE, ENERGY, 0.4, seed)


@pytest.fixture(scope="module")
def level_design(pendulum):
    return solve(pendulum, Options(shape="level"))


@pytest.fixture(scope="module")
def shares(default_design, level_design, pendulum):
    regularised = solve(pendulum, Options(shape="regulariser"))
    designs = {"none": default_design, "regulariser": regularised, "level": level_design}
    return {shape: (made, certify(made)) for shape, made in designs.items()}


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
    points = z + shaped.inner
    published = [np.mean([p @ p - 0.2 * f(p) for p in points]) for f in (V, W)]
    assert published[0] > 0 > published[1]


@pytest.mark.parametrize("seed", range(3))
def test_rows_of_the_level_against_plain_numpy(default_design, seed):
    """ΔV, growth along rays, curvature along directions, ΔV on the boundary."""
    made, shaped = varied(default_design, seed), make("level", seed=seed)
    V, z = reference.lyapunov(made), made.z_star
    energy = shaped.energy
    assert energy == pytest.approx(BOX.ceiling / 2)
    u = rows_of(shaped, made)
    N = len(shaped.inner)
    inner, growth, curvature, edge = np.split(u, [N, 2 * N, 3 * N])
    for i in range(0, N, 37):
        assert inner[i] * energy == pytest.approx(V(z + shaped.inner[i]) - V(z), abs=1e-9)
        o = shaped.rays[i]
        slope = reference.jacobian(lambda t, o=o: V(z + t[0] * o), np.ones(1))[0, 0]
        square = ((o / SIZE) ** 2).sum()
        assert growth[i] * energy * square == pytest.approx(slope, abs=1e-7)
        y, d = z + shaped.near[i], shaped.directions[i]
        assert ((d / SIZE) ** 2).sum() == pytest.approx(1)
        second = reference.hessian(lambda t, y=y, d=d: V(y + t[0] * d), np.zeros(1))[0, 0]
        assert curvature[i] * energy == pytest.approx(second, abs=1e-5)
    for offset, value in zip(shaped.boundary[::17], edge[::17], strict=True):
        assert value * energy == pytest.approx(V(z + offset) - V(z), abs=1e-9)


def test_level_objective_counts_what_lies_above_the_level(default_design):
    """For V that grows everywhere, the objective is the share outside {ΔV ≤ c}, smoothly."""
    shaped = make("level")
    N, M = len(shaped.inner), len(shaped.rays)
    u = np.full(shaped.count, 50.0)
    for outside in (0, 60, N):
        u[:N] = np.where(np.arange(N) < outside, 9.0, -7.0)
        value = float(shaped.objective(ca.DM(u), 1.0)) / shaping._LEVEL_WEIGHT
        assert value == pytest.approx(outside / N, abs=0.01)
    margins = np.asarray(shaped.margins(ca.DM(u), 1.0)).ravel()
    np.testing.assert_allclose(margins, [1.0, *[49.0] * len(shaped.boundary)])
    u[N : N + M] = -1.0  # V falls along every ray
    assert float(shaped.objective(ca.DM(u), 1.0)) > 5 * shaping._LEVEL_WEIGHT


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


def test_samples_lie_in_the_domain_and_on_its_boundary():
    shaped = make("level", seed=3)
    for offsets in (shaped.inner, shaped.rays, shaped.near, shaped.boundary):
        assert np.all(np.abs(offsets) <= 2.0)
        assert not offsets[:, 1].any()  # the momentum rests
    assert np.all(np.abs(shaped.boundary[:, [0, 2]]).max(1) == 2.0)
    sides = {
        (axis, np.sign(b[axis])) for b in shaped.boundary for axis in (0, 2) if abs(b[axis]) == 2
    }
    assert sides == {(0, -1), (0, 1), (2, -1), (2, 1)}
    assert np.all(np.abs(shaped.near) <= 0.2 * 2.0 + 1e-12)


def test_samples_above_every_level_are_left_out():
    """A state that no Casimir contains has energy of its own, which caps the level too."""
    steep = replace(BOX, shaped=(2,), excess=lambda offsets: 10 * offsets[:, 0] ** 2)
    shaped = make_shaping(Level(), steep, SIZE, ENERGY, 0.4, 0)
    assert np.all(10 * shaped.inner[:, 0] ** 2 <= 2.0)
    assert not shaped.boundary[:, 0].any()
    flat = replace(steep, excess=lambda offsets: 0.1 * offsets[:, 0] ** 2)
    assert make_shaping(Level(), flat, SIZE, ENERGY, 0.4, 0).energy == pytest.approx(0.2)


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
        assert loss(made) <= 1e-9, shape
        assert certificate.certified, shape
        assert np.linalg.norm(made.z_bar - made.z_star) <= 1e-8
        mode = "hard" if shape == "none" else "shaped"
        assert [start.mode for start in made.starts] == [mode]


def test_certified_share_grows(shares):
    """The pendulum of the paper on its box, seed 0: 34 %, 39 % and 59 % when this was written."""
    share = {shape: sampled_share(*pair) for shape, pair in shares.items()}
    assert share["regulariser"] > 1.05 * share["none"]
    assert share["level"] > 1.6 * share["none"]


def test_level_is_that_of_the_boundary(shares):
    """What is proved reaches the least V on the boundary of the box, which shaping looks at."""
    made, certificate = shares["level"]
    V, domain, z = reference.lyapunov(made), made.domain, made.z_star
    side = np.linspace(-2, 2, 161)
    edge = [
        V(np.array([z[0] + a, 0.0, z[2] + b]))
        for a, b in np.concatenate([[(s, t), (t, s)] for s in (-2.0, 2.0) for t in side])
    ]
    assert domain.lo[0] == pytest.approx(z[0] - 2)
    height = certificate.level - V(z)
    assert 0.85 * (min(edge) - V(z)) <= height <= 1.05 * (min(edge) - V(z))
    assert height <= 2.0  # the momentum stays in the domain


def test_shaped_certificate_is_proved_again(tmp_path, shares):
    made, certificate = shares["level"]
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert all(result.holds for result in check(tmp_path))
    text = certificate.to_json().replace(repr(certificate.level), repr(certificate.level + 0.3))
    assert text != certificate.to_json()
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    assert not all(result.holds for result in check(tmp_path))


def test_shaping_is_reproducible(pendulum, level_design):
    again = solve(pendulum, Options(shape="level"))
    assert np.array_equal(again.weights, level_design.weights)
    assert np.array_equal(again.xi_star, level_design.xi_star)


def test_published_form_can_be_shaped(pendulum):
    plain, shaped = (
        solve(pendulum, replace(paper_options(1), shape=shape)) for shape in ("none", "level")
    )
    certificates = certify(plain), certify(shaped)
    assert certificates[1].certified
    assert sampled_share(shaped, certificates[1]) > 1.2 * sampled_share(plain, certificates[0])


def test_several_inputs_and_casimirs(crane):
    made = solve(crane, Options(shape="level", hidden_k=(8,), hidden_h=(6,)))
    assert made.starts[-1].mode == "shaped"
    assert loss(made) <= 1e-9


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
    made = solve(pendulum, Options(shape="level", quadratic=False, hidden_k=(1,), hidden_h=(1,)))
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
    assert data["certificate"]["domain_share"] > 0.55
    assert [start["form"] for start in data["design"]["starts"]] == ["shaped"]
    assert '"shaped"' in (tmp_path / "out" / "design.json").read_text(encoding="utf-8")


def test_help_explains_the_options(tmp_path):
    done = process(DESIGN, "--help", cwd=tmp_path)
    assert done.returncode == 0
    section = done.stdout.split("Region of attraction:")[1].split("Solver and damping:")[0]
    assert "--shape [none|regulariser|level]" in section
    assert "--gamma" in section
    assert "[default: none]" in " ".join(section.split())
