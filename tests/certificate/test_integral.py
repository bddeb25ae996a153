"""Integral action: W and its fall, the box that is proved, and no offset in simulation."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, verdicts, written
from helpers.velocity import arm, arm_with_payload, pendulum

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.arithmetic.intervals import point
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.integral import IntegralTerms, prove_integral
from necc_casadi.designs.design import Design
from necc_casadi.designs.integral import Integral
from necc_casadi.designs.plant_file import plant_text
from necc_casadi.errors import ModelError, OptionError, OutputError
from necc_casadi.export.integral_margin import integral_margin
from necc_casadi.model.lagrangian import Plants, lagrangian
from necc_casadi.model.model_file import load_model
from necc_casadi.model.parametric import Parametric
from necc_casadi.simulation.responses import simulate
from necc_casadi.simulation.saturated import disturbed_field
from necc_casadi.synthesis.integral import with_integral


@pytest.fixture(scope="module")
def pendulum_with():
    return with_integral(pendulum())


@pytest.fixture(scope="module")
def folder(pendulum_with, tmp_path_factory):
    return written(pendulum_with, tmp_path_factory.mktemp("integral"))


def inertia(design, q):
    function = sp.lambdify(design.loop.plant.x[: len(q)], sp.Matrix(design.loop.plant.inertia))
    return np.array(function(*q), float)


def W(design, terms, w, d):
    """W at (q, p, ξ, ζ) with a constant d, in the units of the model, and its parts."""
    n, m = design.loop.plant.n, design.loop.plant.m
    q, p, xi, zeta = w[:m], w[m:n], w[n : n + m], w[n + m :]
    tau, gain = design.integral.tau, design.integral.gain
    e, M = q - design.z_star[:m], inertia(design, q)
    rate = np.linalg.solve(M, p) + e / tau
    B = np.array(sp.Matrix(design.loop.plant.G[m:, :]).evalf(), float)
    at = dict(zip(design.loop.plant.x, design.z_star[:n], strict=True))
    slope = np.array([float(v.subs(at)) for v in design.loop.plant.grad_H[:m, 0]])
    xi_bar = terms.xi_bar.mid
    pull = design.lyapunov.control_law(design.z_star[:n], xi_bar)[0]  # −Gcᵀ∇Hc(ξ̄) at rest
    zeta_star = d - np.linalg.solve(B, slope) + pull
    E = float(terms.energy(point(np.concatenate([e, xi - xi_bar])[None])).mid[0])
    return rate @ M @ rate / 2 + E + ((zeta - zeta_star) ** 2 / gain).sum() / (2 * tau)


@pytest.mark.parametrize("make", [pendulum, arm], ids=["pendulum", "arm"])
def test_W_falls_by_the_form_S(make):
    """dW/dt along the loop, by differences, is −(q̇, e, ω)ᵀS(q̇, e, ω) with the prover's S."""
    design = make()
    m = design.loop.plant.m
    design = replace(
        design, integral=Integral(1.7, np.linspace(2, 3, m), np.full(m, 9.0))
    )  # any gain, any τ
    terms, field = terms_of(design), disturbed_field(design)
    rng, n = np.random.default_rng(0), design.loop.plant.n
    B = np.array(sp.Matrix(design.loop.plant.G[m:, :]).evalf(), float)
    for _ in range(6):
        d = rng.uniform(-1, 1, m)
        w = np.concatenate([rng.uniform(-0.8, 0.8, n + m), rng.uniform(-2, 2, m)])
        rate = np.asarray(field(w, d), float).ravel()
        step = 1e-5
        slope = (W(design, terms, w + step * rate, d) - W(design, terms, w - step * rate, d)) / (
            2 * step
        )
        q, p, xi = w[:m], w[m:n], w[n : n + m]
        e, away = q - design.z_star[:m], xi - terms.xi_bar.mid
        h, k = (np.diag(design.weights[at : at + m]) for at in (m + 1, 4 * m + 2))
        omega = h @ away - k @ (B.T @ e - away)
        v = np.concatenate([np.linalg.solve(inertia(design, q), p), e, omega])
        S = terms._form(point(np.concatenate([e, away])[None]))
        assert S.rad.max() < 0.6  # mean slopes are enclosed
        low, high = (float(v @ M[0] @ v) for M in (S.lo, S.hi))
        slack = float(np.abs(v) @ S.rad[0] @ np.abs(v)) + 1e-6 * (1 + abs(slope))
        assert -slope == pytest.approx((low + high) / 2, abs=slack)


def test_the_margin_is_that_of_the_largest_W(ranged, pendulum_with):
    """1 − W/c with ζ* at its limits, and with every end of what is not known of the plant."""
    made, certificate = pendulum_with, certify(pendulum_with)
    margin, terms = integral_margin(made, certificate), terms_of(made)
    rng = np.random.default_rng(0)
    pull = made.lyapunov.control_law(made.z_star[:2], terms.xi_bar.mid)[0]
    for _ in range(5):
        w = np.array([0.75, 0.0, 0.0, 0.0]) + rng.uniform(-1, 1, 4) * [1, 1, 1, 0.5]
        ends = (-made.integral.limit, made.integral.limit)
        pushes = [zeta + np.sin(0.75) - pull for zeta in ends]
        wanted = 1 - max(W(made, terms, w, d) for d in pushes) / margin.level
        assert margin(w[:2], w[2:3], w[3:]) == pytest.approx(wanted, abs=1e-9)
    many = plants(m=("9/10", "11/10"), g=("4/5", "6/5"), d=("0", "3/10"))
    varied = Design.load(ranged)
    data = json.loads((ranged / "certificate.json").read_text(encoding="utf-8"))
    proved = Certificate.from_json(json.dumps(data))
    assert integral_margin(varied, proved) is None
    wide = integral_margin(varied, proved, many.parametric)
    at = [0.75 + 0.3, 0.4]
    e, v = 0.3, 0.4 + 0.3 / varied.integral.tau
    tau, D = varied.integral.tau, varied.damping[0, 0]
    parts = [
        m * v**2 / 2 + e**2 * (D + d - m / tau) / (2 * tau)
        - g * (np.cos(1.05) - np.cos(0.75) + np.sin(0.75) * e)
        for m in (0.9, 1.1) for g in (0.8, 1.2) for d in (0.0, 0.3)
    ]  # fmt: skip
    shape = 4 * 0.1**2 / 2 + 4 * (e - 0.1) ** 2 / 2
    zeta = varied.integral.limit[0] ** 2 / (2 * tau * varied.integral.gain[0])
    wanted = 1 - (max(parts) + shape + zeta) / wide.level
    assert wide(at, varied.xi_star + 0.1, [0.0]) == pytest.approx(wanted, abs=1e-9)
    assert wide([np.nan, 0], varied.xi_star, [0.0]) == -1


def test_the_box_is_proved_and_proved_again(folder, pendulum_with):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    found = claim(data, "integral")
    assert found["holds"]
    assert found["data"]["level"] > 0.2
    assert all(verdicts(folder).values())
    assert Design.load(folder).hash == pendulum_with.hash


@pytest.mark.parametrize("key", ["level", "half_widths"])
def test_a_looser_box_is_not(folder, tmp_path, pendulum_with, key):
    """A level too high for the sides, and a box in which W does not fall, are found out."""
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    held = claim(data, "integral")
    if key == "level":
        held["data"]["level"] *= 1.3
    else:
        held["data"]["half_widths"] = [v / 4 for v in held["data"]["half_widths"]]
    units, states = pendulum_with.units, pendulum_with.loop.states
    box = {
        states[i]: w * float(units.state[i])
        for i, w in zip((0, 2), held["data"]["half_widths"], strict=True)
    }
    limit = [float(v) for v in pendulum_with.integral.limit]
    held["statement"] = statements.integral(held["data"]["level"] * units.energy, box, limit, {})
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert verdicts(tmp_path)["integral"] is False


def test_without_enough_damping_nothing_is_proved(pendulum_with):
    """D + R ≻ M/τ fails at rest itself."""
    damping = np.diag([0.1, 0.5])
    slow = replace(pendulum_with, damping=damping)
    assert 1 / slow.integral.tau > 0.2
    found = prove_integral(slow)
    assert (found.holds, found.statement) == (False, statements.NO_INTEGRAL)
    coupled = replace(pendulum_with, damping=pendulum_with.damping + np.array([[0, 0.01], [0, 0]]))
    assert prove_integral(coupled).statement == statements.INTEGRAL_IS_NOT_COVERED


@pytest.mark.parametrize("make", [pendulum, arm], ids=["pendulum", "arm"])
def test_no_offset_is_left(make):
    """Under a constant force, and on a plant with other masses and weights."""
    made, m = make(), make().loop.plant.m
    with_it, force = with_integral(made), np.full(m, 0.3)
    start = np.concatenate([made.z_star[:m] + 0.3, np.full(m, 0.2)])
    plain = simulate(made, start, disturbance=force, time=80.0)
    assert np.abs(plain.z[-1, :m] - made.z_star[:m]).max() > 1e-3
    response = simulate(with_it, start, disturbance=force, time=80.0)
    assert np.abs(response.z[-1, :m] - made.z_star[:m]).max() < 1e-9
    plant = with_it.loop.plant
    p = plant.x[m:]
    heavier = replace(
        plant,
        H=plant.H.subs(dict.fromkeys(p, 0)) * sp.Rational(5, 4)
        + (plant.H - plant.H.subs(dict.fromkeys(p, 0))) / sp.Rational(3, 2),
        inertia=sp.ImmutableMatrix(plant.inertia * sp.Rational(3, 2)),
    )
    other = replace(with_it, loop=replace(with_it.loop, plant=heavier))
    response = simulate(other, start, disturbance=force, time=80.0)
    assert np.abs(response.z[-1, :m] - made.z_star[:m]).max() < 1e-9


def test_starts_in_the_proved_set_stay_in_it_and_W_falls(pendulum_with):
    """From random starts with W ≤ c, ζ at its limits among them."""
    terms, proof = terms_of(pendulum_with), prove_integral(pendulum_with).data
    rng = np.random.default_rng(1)
    natural, half = pendulum_with.natural, np.array(proof["half_widths"])
    field, done = disturbed_field(natural), 0
    for _ in range(400):
        d = rng.uniform(-0.5, 0.5, 1)
        e, away = rng.uniform(-1, 1, 2) * half
        p, zeta = rng.uniform(-1, 1), rng.uniform(-1, 1) * natural.integral.limit[0]
        w = np.array([natural.z_star[0] + e, p, terms.xi_bar.mid[0] + away, zeta])
        level = W(natural, terms_of(natural), w, d)
        if level > proof["level"] or abs(d[0]) > natural.integral.limit[0]:
            continue
        done += 1
        for _ in range(40):  # Heun's method
            k1 = np.asarray(field(w, d), float).ravel()
            k2 = np.asarray(field(w + 0.02 * k1, d), float).ravel()
            w = w + 0.01 * (k1 + k2)
            w[3] = np.clip(w[3], -natural.integral.limit[0], natural.integral.limit[0])
            now = W(natural, terms_of(natural), w, d)
            assert now <= level + 1e-4 * proof["level"]
            assert np.all(np.abs([w[0] - natural.z_star[0], w[2] - terms.xi_bar.mid[0]]) < half)
            level = now
        if done == 8:
            break
    assert done == 8


_KNOWN = {}


def terms_of(design):
    if id(design) not in _KNOWN:
        _KNOWN[id(design)] = design, IntegralTerms(design, lagrangian(design.loop, design.units))
    return _KNOWN[id(design)][1]


def test_limits_are_half_of_what_the_inputs_have_left():
    made = with_integral(pendulum(limits=((-1.0, 3.0),)))
    held = made.lyapunov.control_law(made.z_star[:2], made.xi_star)[0][0]
    assert made.integral.limit[0] == pytest.approx(0.5 * min(held + 1, 3 - held), rel=1e-2)
    with pytest.raises(OptionError, match="beyond u_limits"):
        with_integral(pendulum(limits=((-1.0, 0.5),)))


def test_zeta_keeps_its_limits_under_a_force_beyond_them(pendulum_with):
    made = replace(pendulum_with, integral=replace(pendulum_with.integral, limit=np.array([0.2])))
    response = simulate(made, made.z_star[:2], disturbance=[1.0], time=20.0)
    assert np.abs(response.zeta).max() < 0.2 + 1e-4
    assert response.zeta[-1, 0] == pytest.approx(0.2, abs=1e-4)
    assert abs(response.z[-1, 0] - made.z_star[0]) > 1e-2


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda plant: replace(plant, inertia=None), "does not measure velocities"),
        (
            lambda plant: replace(plant, R=sp.ImmutableMatrix(sp.diag(0, plant.x[1] ** 2))),
            "not constant",
        ),
    ],
)
def test_what_is_not_covered_is_refused(change, reason):
    made = pendulum()
    other = replace(made, loop=replace(made.loop, plant=change(made.loop.plant)))
    with pytest.raises(OptionError, match=reason):
        with_integral(other)
    given = replace(other, integral=Integral(1.0, np.ones(1), np.ones(1)))
    assert prove_integral(given).statement == statements.INTEGRAL_IS_NOT_COVERED


# --- parameters that are not known ---------------------------------------------------------------


def plants(**ranges):
    """The pendulum with its mass, weight and friction as symbols."""
    plant = pendulum().loop.plant
    q, p = plant.x
    m, g, d, k = sp.symbols("m g d k", real=True)
    values = {"m": 1, "g": 1, "d": sp.Rational(1, 10), "k": 1}
    formal = Parametric(
        plant.J,
        sp.ImmutableMatrix(sp.diag(0, d)),
        plant.G * (k if "k" in ranges else 1),
        p**2 / (2 * m) + g * (1 - sp.cos(q)),
        {name: sp.sympify(v) for name, v in values.items()},
    )
    return Plants(formal, {name: tuple(map(sp.sympify, side)) for name, side in ranges.items()})


@pytest.fixture(scope="module")
def ranged(tmp_path_factory):
    """Proved for a box of masses, weights and frictions."""
    many = plants(m=("9/10", "11/10"), g=("4/5", "6/5"), d=("0", "3/10"))
    made, folder = with_integral(pendulum(), plants=many), tmp_path_factory.mktemp("ranged")
    made.save(folder / "design.json")
    certificate = certify(made, plants=many)
    (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    (folder / "plant.json").write_text(plant_text(made, many.parametric), encoding="utf-8")
    return folder


def test_no_offset_is_proved_for_a_box_of_plants(ranged):
    data = json.loads((ranged / "certificate.json").read_text(encoding="utf-8"))
    found = claim(data, "integral")
    assert found["holds"]
    assert found["data"]["uncertain"]["m"] == ["9/10", "11/10"]
    assert "d in [0, 3/10]" in found["statement"]
    assert all(verdicts(ranged).values())


@pytest.mark.parametrize("fault", ["wider", "missing", "other"])
def test_ranges_and_plants_that_were_not_proved_are_found_out(ranged, tmp_path, fault):
    for name in ("design.json", "certificate.json", "plant.json"):
        (tmp_path / name).write_bytes((ranged / name).read_bytes())
    data = json.loads((ranged / "certificate.json").read_text(encoding="utf-8"))
    held = claim(data, "integral")
    if fault == "wider":
        held["data"]["uncertain"]["m"] = ["9/10", "9"]
        held["statement"] = held["statement"].replace("m in [9/10, 11/10]", "m in [9/10, 9]")
        (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        assert verdicts(tmp_path)["integral"] is False
    elif fault == "other":
        plant = json.loads((tmp_path / "plant.json").read_text(encoding="utf-8"))
        plant["H"] = f"2*({plant['H']})"
        (tmp_path / "plant.json").write_text(json.dumps(plant), encoding="utf-8")
        assert verdicts(tmp_path)["integral"] is False
    else:
        (tmp_path / "plant.json").unlink()
        with pytest.raises(OutputError, match=r"plant\.json is missing"):
            verdicts(tmp_path)


def test_what_is_affine_in_a_parameter_is_looked_at_at_its_ends():
    """E between those at the ends, and S not below the lower of theirs, for θ anywhere between."""
    many = plants(m=("9/10", "11/10"), g=("4/5", "6/5"), d=("0", "3/10"))
    made = with_integral(pendulum(), plants=many)
    terms = IntegralTerms(made, lagrangian(made.loop, made.units, many))
    corners, rng = terms.corners, np.random.default_rng(0)
    assert corners.shape == (8, 3)
    assert corners.rad.max() < 1e-12
    for _ in range(20):
        at, theta = rng.uniform(-1, 1, 2), rng.uniform(terms.theta.lo, terms.theta.hi)
        rows = np.array([[*at, *end] for end in (*corners.mid, theta)])
        *E, between = terms.energy(point(rows)).mid
        assert min(E) - 1e-12 <= between <= max(E) + 1e-12
        least = np.linalg.eigvalsh(terms._form(point(rows)).mid)[:, 0]
        assert least[-1] >= least[:-1].min() - 1e-12


def test_a_parameter_that_is_not_affine_keeps_its_range():
    """A pitch of the potential is an axis of the cells, beside a mass at its ends."""
    own, pitch = plants(m=("9/10", "11/10")), sp.Symbol("b", real=True)
    q = pendulum().loop.plant.x[0]
    formal = replace(
        own.parametric,
        H=own.parametric.H + sp.cos(pitch * q) / 10 - sp.Rational(1, 10),
        values={**own.parametric.values, "b": sp.Integer(0)},
    )
    ranges = {**own.ranges, "b": (sp.Integer(0), sp.Rational(1, 2))}
    made = pendulum()
    plant = lagrangian(made.loop, made.units, Plants(formal, ranges))
    assert [str(s) for s in plant.affine] == ["m"]
    with_it = with_integral(made, plants=Plants(formal, ranges))
    corners = IntegralTerms(with_it, plant).corners
    assert corners.shape == (2, 2)
    assert (corners.rad > 0.1).tolist() == [[False, True]] * 2


@pytest.mark.slow
def test_no_offset_of_the_arm_for_any_payload(tmp_path):
    """0 to 1 kg, anything up to 1 N m, from a box of more than a radian, proved again."""
    made, many = arm_with_payload()
    push = [(sp.Integer(-1), sp.Integer(1))] * 2
    closed = with_integral(made, plants=many, disturbance=push)
    held, proof = prove_integral(closed, many, push), certify(closed, region=False)
    assert held.holds
    assert min(held.data["half_widths"]) > 1
    assert "mp in [0, 1]" in held.statement
    found = replace(proof, claims=(*proof.claims, held))
    closed.save(tmp_path / "design.json")
    (tmp_path / "plant.json").write_text(plant_text(closed, many.parametric), encoding="utf-8")
    (tmp_path / "certificate.json").write_text(found.to_json(), encoding="utf-8")
    assert verdicts(tmp_path)["integral"] is True


def test_a_gain_that_is_not_known_is_refused():
    with pytest.raises(OptionError, match="stand in J or G"):
        with_integral(pendulum(), plants=plants(k=("9/10", "11/10")))


@pytest.mark.parametrize(
    ("line", "piece"),
    [
        ("uncertain = {l: (1, 2)}", "names l, which is no parameter"),
        ("uncertain = {m: (2, 3)}", "is not a pair (lo, hi) around 1"),
        ("uncertain = {m: 2}", "is not a pair"),
    ],
)
def test_ranges_that_are_none(tmp_path, line, piece):
    text = (
        "import sympy as sp\nq, m, l = sp.symbols('q m l')\nM, V, B = m, -sp.cos(q), 1\n"
        f"params = {{m: 1}}\n{line}\n"
    )
    (tmp_path / "own.py").write_text(text, encoding="utf-8")
    with pytest.raises(ModelError) as fault:
        load_model(tmp_path / "own.py")
    assert (fault.value.code, piece in str(fault.value)) == ("param", True)


def test_a_design_with_integral_action_is_not_sound_without_its_claim(folder, tmp_path):
    """What else is claimed of solutions is of the loop with ζ = 0, as this claim alone says."""
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    data["claims"] = [c for c in data["claims"] if c["name"] != "integral"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert verdicts(tmp_path)["integral"] is False
