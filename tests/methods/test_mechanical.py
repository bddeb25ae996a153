"""Mechanical target structures: exact matching, Casimirs and verdicts of what is refused today."""

from itertools import islice

import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import canonical, load

from necc_casadi import certify, design
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.methods.mechanical import mechanical_structures
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.matching import Matching
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.judge import judge

#: Plant, target, families that give a structure, families that give none.
CASES = {
    "cart_pole": ({"x": 1, "theta": 0}, 2, ["M_d constant off one coordinate"]),
    "inertia_wheel": (
        {},
        1,
        ["M_d of one coordinate", "M_d constant off one coordinate"],
    ),
    "vtol": ({}, 2, ["M_d constant off one coordinate"]),
    "ball_and_beam": ({}, 1, ["constant M_d", "M_d of one coordinate"]),
    "furuta": ({}, 1, ["constant M_d", "M_d constant off one coordinate"]),
}


def at(plant, values):
    """A target: 0 where no value is given."""
    return {s: sp.sympify(values.get(str(s), 0)) for s in plant.x}


@pytest.fixture(scope="module")
def found():
    """What each plant gives, computed once."""
    known = {}

    def of(name):
        if name not in known:
            plant = load(name)[0]
            target = at(plant, CASES[name][0])
            known[name] = plant, target, list(mechanical_structures(plant, target))
        return known[name]

    return of


LONG_AND_SHORT = [
    pytest.param(n, marks=[pytest.mark.slow] * (n in ("vtol", "furuta"))) for n in CASES
]


@pytest.mark.parametrize("name", LONG_AND_SHORT)
def test_every_family_gives_a_structure_or_a_reason(found, name):
    _, count, without = CASES[name]
    *_, results = found(name)
    assert sum(isinstance(result, Matching) for result in results) == count
    missing = [result for result in results if isinstance(result, NoStructure)]
    assert [result.family for result in missing] == without
    assert all(result.reason and not result.proved for result in missing)


@pytest.mark.parametrize("name", LONG_AND_SHORT)
def test_the_structure_moves_as_the_plant_does(found, name):
    """In floating point, with ẋ from the plant alone."""
    plant, target, results = found(name)
    rng = np.random.default_rng(0)
    v = sp.symbols(f"v1:{plant.m + 1}", real=True)
    for matching in (result for result in results if isinstance(result, Matching)):
        assert matching.holds
        u = matching.u0 + matching.gain * sp.Matrix(v)
        true = (plant.J - plant.R) * plant.grad_H + plant.G * u
        structure = matching.plant
        seen = (structure.J - structure.R) * structure.grad_H + structure.G * sp.Matrix(v)
        both = sp.lambdify((*plant.x, *v), [list(true), list(seen)])
        for _ in range(10):
            point = [float(target[s]) + rng.uniform(-0.7, 0.7) for s in plant.x]
            rates = np.array(both(*point, *rng.uniform(-1, 1, plant.m)), dtype=float)
            scale = np.abs(rates).max(axis=0) + 1e-3
            assert np.all(np.abs(rates[0] - rates[1]) < 1e-9 * scale)


@pytest.mark.parametrize("name", CASES)
def test_the_casimirs_are_those_of_the_published_loop(found, name):
    plant, target, results = found(name)
    for matching in (result for result in results if isinstance(result, Matching)):
        loop = interconnect(matching.plant, default_controller(matching.plant))
        supplied = [xi - c for xi, c in zip(loop.controller.xi, matching.shaping, strict=True)]
        casimirs = find_casimirs(loop, supplied, target)
        assert len(casimirs.functions) == casimirs.generic_count == plant.m
        verdict = judge(loop, casimirs, target)
        assert (verdict.reason, verdict.stability) == ("ok", "asymptotic")


@pytest.mark.parametrize("name", CASES)
def test_the_plant_itself_is_refused_there(found, name):
    plant, target, _ = found(name)
    loop = interconnect(plant, default_controller(plant))
    assert judge(loop, find_casimirs(loop, (), target), target).assignable is False


def test_the_structure_keeps_names_units_and_domain_of_the_plant():
    plant, _, target = load("inertia_wheel")
    named = make_plant(
        plant.x, plant.J, plant.R, plant.G, plant.H, name="wheel",
        units={"theta": "rad"}, domain={"theta": (sp.Integer(-1), sp.Integer(1))},
    )  # fmt: skip
    matching = next(mechanical_structures(named, target))
    kept = matching.plant
    assert (kept.x, kept.name, kept.units, kept.domain) == (
        named.x, named.name, named.units, named.domain
    )  # fmt: skip


def cart_pole(damping=None, gravity=1):
    """A cart-pole of unit masses and length."""
    q, th, p_q, p_th = sp.symbols("q theta p_q p_theta", real=True)
    M = sp.Matrix([[2, sp.cos(th)], [sp.cos(th), 1]])
    p = sp.Matrix([p_q, p_th])
    H = (p.T * M.inv() * p)[0] / 2 + gravity * sp.cos(th)
    R = sp.zeros(4, 4) if damping is None else sp.diag(0, 0, *damping)
    return make_plant((q, th, p_q, p_th), canonical(2), R, sp.Matrix([0, 0, 1, 0]), H)


def test_friction_on_an_actuated_coordinate_is_cancelled():
    plant = cart_pole(damping=(3, 0))
    matching = next(mechanical_structures(plant, at(plant, {})))
    assert matching.holds
    assert matching.plant.R.is_zero_matrix
    assert sp.diff(matching.u0[0], plant.x[2]).subs(at(plant, {})) != 0


def test_pivot_friction_leaves_no_mechanical_structure_upright():
    plant = cart_pole(damping=(0, 1))
    (result,) = mechanical_structures(plant, at(plant, {}))
    assert result.proved
    assert result.reason.startswith("no mechanical structure: with friction on")
    assert "theta" in result.reason
    assert "stabil" not in result.reason


def test_pivot_friction_of_a_hanging_pendulum_is_only_not_covered():
    plant = cart_pole(damping=(0, 1))
    (result,) = mechanical_structures(plant, at(plant, {"theta": sp.pi}))
    assert not result.proved
    assert "not covered" in result.reason


def test_a_pendulum_that_hangs_has_a_structure_too():
    plant = cart_pole()
    target = at(plant, {"theta": sp.pi})
    none, matching = islice(mechanical_structures(plant, target), 2)
    assert none.reason.startswith("it is made for targets")
    assert matching.holds
    kinetic = sp.hessian(matching.plant.H, plant.x[2:]).subs(target)
    assert kinetic.is_positive_definite
    assert sp.diff(matching.plant.H, plant.x[1], 2).subs(target) > 0


def test_upright_without_coupling_has_no_mechanical_structure():
    q, th, p_q, p_th = sp.symbols("q theta p_q p_theta", real=True)
    H = (p_q**2 + p_th**2) / 2 + sp.cos(th)
    plant = make_plant((q, th, p_q, p_th), canonical(2), sp.zeros(4, 4), sp.Matrix([0, 0, 1, 0]), H)
    (result,) = mechanical_structures(plant, at(plant, {}))
    assert result.proved
    assert "no mechanical structure" in result.reason


def test_a_target_that_is_no_equilibrium_is_told():
    plant = cart_pole()
    (result,) = mechanical_structures(plant, at(plant, {"theta": 1}))
    assert result.proved
    assert "equilibrium" in result.reason


@pytest.mark.parametrize("name", ["pendulum", "series_rlc", "two_link_arm", "satellite"])
def test_other_plants_are_told_why_they_are_not_tried(name):
    plant = load(name)[0]
    (result,) = mechanical_structures(plant, at(plant, {}))
    assert isinstance(result, NoStructure)
    assert not result.proved
    assert "not tried" in result.reason


def test_forces_of_the_row_that_cannot_be_integrated_prove_nothing():
    """Two free coordinates in the row: Γ and s depend on both."""
    q1, q2, p1, p2 = sp.symbols("q1 q2 p1 p2", real=True)
    H = (p1**2 + p2**2) / 2 + sp.cos(q1) + q1 * q2
    plant = make_plant((q1, q2, p1, p2), canonical(2), sp.zeros(4, 4), sp.Matrix([0, 0, 0, 1]), H)
    results = list(mechanical_structures(plant, at(plant, {})))
    assert all(isinstance(result, NoStructure) and not result.proved for result in results)
    assert len(results) == 3


@pytest.mark.slow
def test_the_upright_cart_pole_is_certified(found):
    _, target, results = found("cart_pole")
    matching = results[0]
    loop = interconnect(matching.plant, default_controller(matching.plant))
    casimirs = find_casimirs(loop, [loop.controller.xi[0] - matching.shaping[0]], target)
    made = design(loop, casimirs, judge(loop, casimirs, target), target)
    claims = {claim.name: claim.holds for claim in certify(made).claims}
    assert all(
        claims[name] for name in ("casimir", "structure", "decrease", "attraction", "region")
    )


def test_no_direction_of_one_coordinate_lets_the_structure_fall_off_more_slowly():
    """(ln g⊥b)′ = 2(g⊥′k + Γk²)/(g⊥(1, k)ᵀ) for every k of q_r, whose least exponent is known."""
    t, c, gamma, w = sp.symbols("t c gamma w", positive=True)
    beta, k, g, G = (sp.Function(name)(t) for name in ("beta", "k", "g", "Gamma"))
    mu = 1 + g * k
    rate = 2 * (sp.diff(g, t) * k + G * k**2) / mu
    slope = sp.solve(sp.diff(beta * mu, t) - rate * beta * mu, sp.diff(beta, t))[0]
    kinetic = (
        beta * sp.diff(beta * mu, t) / 2 - beta * sp.diff(g, t) * k * beta - G * k**2 * beta**2
    )
    assert sp.simplify(kinetic.subs(sp.diff(beta, t), slope)) == 0
    given = {g: c * sp.cos(t), G: gamma * sp.sin(t) * sp.cos(t), k: -w / (c * sp.cos(t))}
    epsilon = gamma / c**2
    f = 2 * (epsilon * w**2 + w) / (w - 1)
    assert sp.simplify(rate.subs(given).doit() + f * sp.tan(t)) == 0
    best = 1 + sp.sqrt(1 + 1 / epsilon)
    assert sp.simplify(sp.diff(f, w).subs(w, best)) == 0
    furuta = f.subs(w, best).subs({c: sp.Rational(85, 86), gamma: 1})
    assert float(furuta) == pytest.approx(11.85, abs=0.01)
