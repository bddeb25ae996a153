"""Integral action under disturbances within bounds, and bounds of momenta that boxes keep."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, verdicts
from helpers.velocity import arm, pendulum

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.arithmetic.intervals import point
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.integral import IntegralTerms, prove_integral
from necc_casadi.certificate.prover.setpoints import SetPointTerms, prove_setpoints
from necc_casadi.errors import OptionError
from necc_casadi.model.lagrangian import lagrangian
from necc_casadi.model.setpoints import moved, set_points
from necc_casadi.simulation.saturated import disturbed_field
from necc_casadi.synthesis.integral import with_integral

WIDE = ((sp.Rational(-1, 5), sp.Rational(3, 10)),)


def save(design, certificate, folder):
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def pushed():
    made = with_integral(pendulum(), disturbance=WIDE)
    return made, certify(made, disturbance=WIDE)


def test_every_disturbance_of_the_box_is_proved_and_proved_again(pushed, tmp_path):
    made, certificate = pushed
    found = next(c for c in certificate.claims if c.name == "integral")
    assert found.holds
    assert "for every constant disturbance in [-1/5, 3/10], ζ* within" in found.statement
    assert all(verdicts(save(made, certificate, tmp_path)).values())


def narrow(data):
    data["resting"] = [[v / 2 for v in side] for side in data["resting"]]


def strong(data):
    data["disturbance"] = [["-1/5", "2"]]
    data["resting"] = [[-0.21, 2.01]]


def one_sided(data):
    data["disturbance"] = [["1/10", "3/10"]]


@pytest.mark.parametrize("change", [narrow, strong, one_sided])
def test_what_zeta_is_not_proved_to_hold_is_found_out(pushed, tmp_path, change):
    made, certificate = pushed
    folder = save(made, certificate, tmp_path)
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    held = claim(data, "integral")
    change(held["data"])
    widths = dict(zip(("q", "xi1"), held["data"]["half_widths"], strict=True))
    limit, level = made.integral.limit.tolist(), held["data"]["level"] * made.units.energy
    pushes = held["data"]["disturbance"]
    held["statement"] = statements.integral(level, widths, limit, {}, pushes)
    (folder / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    assert verdicts(folder)["integral"] is False


@pytest.mark.parametrize("make", [pendulum, arm], ids=["pendulum", "arm"])
def test_zeta_comes_to_rest_where_it_is_proved_to(make):
    """Where the loop rests by Newton's method, for disturbances of the box; and without offset."""
    made = make()
    m = made.loop.plant.m
    sides = WIDE * m
    with_it = with_integral(made, disturbance=sides)
    terms = IntegralTerms(with_it, lagrangian(with_it.loop, with_it.units))
    low, high = terms.resting(sides).lo, terms.resting(sides).hi
    field, rng = disturbed_field(with_it), np.random.default_rng(0)

    def at(w, d):
        return np.asarray(field(w, d), float).ravel()

    for _ in range(5):
        d, rest = rng.uniform(-0.2, 0.3, m), np.zeros(len(made.z_star) + m)
        for _ in range(30):
            slopes = [at(rest + step, d) - at(rest - step, d) for step in 1e-6 * np.eye(len(rest))]
            rest = rest - np.linalg.solve(np.array(slopes).T / 2e-6, at(rest, d))
        assert np.abs(at(rest, d)).max() < 1e-9
        assert rest[:m] == pytest.approx(made.z_star[:m], abs=1e-9)
        zeta = rest[-m:] / with_it.units.input
        assert np.all((low < zeta) & (zeta < high))


def test_limits_that_are_too_small_for_it(pushed):
    made, _ = pushed
    small = replace(made, integral=replace(made.integral, limit=np.array([0.25])))
    found = prove_integral(small, disturbance=WIDE)
    assert (found.holds, found.statement) == (False, statements.INTEGRAL_IS_TOO_SMALL)
    limited = pendulum(limits=((-0.9, 0.9),))  # sin(3/4) = 0.68 hold the target
    assert with_integral(limited, disturbance=[(-0.2, 0.2)]).integral.limit > 0.2
    with pytest.raises(OptionError, match="not all disturbances"):
        with_integral(limited, disturbance=[(-0.3, 0.1)])  # 0.98 against them


# --- momenta --------------------------------------------------------------------------------------


def bounded(made, **bounds):
    """The design in a domain."""
    sides = {name: tuple(map(sp.sympify, side)) for name, side in bounds.items()}
    plant = replace(made.loop.plant, domain=sides)
    return replace(made, loop=replace(made.loop, plant=plant))


def moving(made):
    return replace(made, setpoints={"q": (sp.Integer(-1), sp.Integer(1))})


@pytest.mark.slow
@pytest.mark.parametrize("make", [with_integral, moving], ids=["integral", "setpoints"])
def test_named_momenta_keep_their_bounds(make, tmp_path):
    """The level is lower than without them, and that one is not proved again with them."""
    name = "integral" if make is with_integral else "setpoints"
    free = make(pendulum())
    narrow = bounded(free, p_q=(-1, 2))
    certificate = certify(free)
    wide = next(c for c in certificate.claims if c.name == name)
    prove = prove_integral if make is with_integral else prove_setpoints
    found = prove(narrow)
    assert found.holds
    assert found.data["level"] < 0.8 * wide.data["level"]
    claims = tuple(c for c in certificate.claims if c.name not in ("region", "global", name))
    known = replace(
        certificate, design_hash=narrow.hash, claims=(*claims, found), region=None, level=None,
        level_above_minimum=None, obstacle=None, reach=None, is_global=False,
    )  # fmt: skip
    assert verdicts(save(narrow, known, tmp_path))[name]
    forged = replace(known, claims=(*claims, wide))
    assert verdicts(save(narrow, forged, tmp_path))[name] is False


@pytest.mark.parametrize("kind", ["integral", "setpoints"])
def test_no_momentum_is_on_its_bound_below_the_ceiling(kind):
    """Energy of motion and E at states with a momentum on its bound, beside the ceiling."""
    made = bounded(arm(), p_q1=(-1, 2), p_q2=(-3, sp.Rational(1, 2)))
    plant, m = made.loop.plant, 2
    if kind == "integral":
        made = with_integral(made)
        terms, tau = IntegralTerms(made, lagrangian(made.loop, made.units)), made.integral.tau
    else:
        made = replace(made, setpoints={"q1": (sp.Integer(-1), sp.Integer(1))})
        points, tau = set_points(plant, made.z_star[:m], {}), np.inf
        nominal = lagrangian(made.loop, made.units)
        terms = SetPointTerms(made, moved(nominal, points, made.units), nominal)
    assert made.units.are_ones
    inertia = sp.lambdify(plant.x[:m], sp.Matrix(plant.inertia))
    rng, least = np.random.default_rng(1), np.inf
    for _ in range(40):
        Z = rng.uniform(-0.3, 0.3, 2 * m)
        ceiling = terms.ceiling(point(Z[None]))[0]
        M = np.array(inertia(*(made.z_star[:m] + Z[:m])), float)
        E = terms.energy(point(Z[None])).mid[0]
        for i, bound in ((0, -1), (0, 2), (1, -3), (1, 0.5)):
            p = rng.uniform(-1, 1, m)
            p[i] = bound
            v = np.linalg.solve(M, p) + Z[:m] / tau
            least = min(least, v @ M @ v / 2 + E - ceiling)
            assert v @ M @ v / 2 + E >= ceiling - 1e-9
    assert least < 0.2  # and it is no lower than it has to be


def test_set_points_and_their_box_are_within_the_domain():
    """What is within bounds about the target is not about every set-point."""
    free = moving(pendulum())
    narrow = bounded(free, q=(sp.Rational(-3, 2), sp.Rational(3, 2)))
    found = prove_setpoints(narrow)
    assert found.holds
    assert 1 + found.data["half_widths"][0] * narrow.units.state[0] < 1.5
    assert not prove_setpoints(bounded(free, q=(-1, 1))).holds
