"""Constant target structures: found with exact proofs, refused only with exact proofs."""

import random

import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import load
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.methods.constant import constant_structure
from necc_casadi.methods.mechanical import mechanical_structures
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.methods.refutation import (
    no_constant_structure,
    nothing_is_conserved,
    uncontrollable_growth,
)
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.matching import Matching
from necc_casadi.model.plant import make_plant
from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.verdict.judge import judge

R = sp.Rational


def levitation():
    """A ball below a magnet, flux-driven through a coil with resistance."""
    phi, q, p = x = sp.symbols("phi q p", real=True)
    k, c, m, g, r = R(1, 20), R(1, 2), R(1, 10), R("9.81"), 2
    f = [-r * phi * (c + q) / k, p / m, m * g - phi**2 / (2 * k)]
    return f, [1, 0, 0], x, (sp.sqrt(2 * k * m * g), R(1, 10), 0)


def synchronous_motor():
    """Fluxes and momentum, with losses and a constant load torque, at 100 rad/s."""
    psi_d, psi_q, p = x = sp.symbols("psi_d psi_q p", real=True)
    L, Rs, Phi, inertia, b, tau, poles = (
        R("8.5e-3"), R("2.875"), R("0.175"), R("8e-4"), R("1e-3"), 1, 4
    )  # fmt: skip
    w, i_d, i_q = p / inertia, psi_d / L, psi_q / L
    f = [
        -Rs * i_d + poles * w * psi_q,
        -Rs * i_q - poles * w * (psi_d + Phi),
        poles * (i_q * (psi_d + Phi) - i_d * psi_q) - b * w - tau,
    ]
    return f, [[1, 0], [0, 1], [0, 0]], x, (0, L * (100 * b + tau) / (poles * Phi), 100 * inertia)


def reactor():
    """Conversion and temperature of a stirred tank at its unstable point; no energy is known."""
    c, theta = x = sp.symbols("c theta", real=True)
    rate = R("0.072") * (1 - c) * sp.exp(theta)
    k = R("0.072") * sp.exp(2)
    return [-c + rate, -theta + 8 * rate - R("0.3") * theta], [0, 1], x, (k / (1 + k), 2)


def flexible_joint(stiffness=2):
    """A link held upright by a motor behind a soft spring; friction on both sides."""
    q, theta, p_q, p_t = x = sp.symbols("q theta p_q p_theta", real=True)
    pull = stiffness * (q - theta)
    f = [p_q, 5 * p_t, 5 * sp.sin(q) - pull - p_q / 10, pull - p_t]
    return f, [0, 0, 0, 1], x, (0, 0, 0, 0)


def generator():
    """A generator with flux decay, driven through its excitation."""
    delta, omega, E = x = sp.symbols("delta omega E", real=True)
    f = [omega, 5 * (R("0.8") - E * sp.sin(delta) - omega / 10), -R("0.6") * E + sp.cos(delta) / 2]
    return f, [0, 0, 1], x, (sp.pi / 6, 0, R("1.6"))


def logarithms():
    """Two logarithms that are one function: B = [−1 2 −3; 1 −3 9] solves (i), (ii), (iii)."""
    x1, x2, x3 = x = sp.symbols("x1:4", real=True)
    f = [sp.log(1 + x1) + x2, x3 - sp.log(2 + 2 * x1) + sp.log(2), 0]
    return f, [0, 0, 1], x, (0, 0, 0)


def pendulum_by_torque():
    q, p = x = sp.symbols("q p", real=True)
    return [p, sp.sin(q) - p / 5], [0, 1], x, (0, 0)


def predator_and_prey():
    a, b = x = sp.symbols("a b", positive=True)
    return [a - a * b, a * b - b], [0, 1], x, (1, 1)


CASES = [
    levitation, synchronous_motor, reactor, flexible_joint, generator, logarithms,
    pendulum_by_torque, predator_and_prey,
]  # fmt: skip


def structure_of(f, G, x, star, **options):
    target = dict(zip(x, map(sp.sympify, star), strict=True))
    return constant_structure(sp.Matrix(f), sp.Matrix(G), x, target, **options), target


@pytest.fixture(scope="module")
def found():
    """What each case gives, computed once."""
    known = {}

    def of(case):
        if case not in known:
            known[case] = structure_of(*case())
        return known[case]

    return of


@pytest.mark.parametrize("case", CASES)
def test_the_structure_is_proved(found, case):
    matching, _ = found(case)
    assert isinstance(matching, Matching)
    assert matching.holds
    plant = matching.plant
    assert not (plant.J.free_symbols | plant.R.free_symbols | plant.G.free_symbols)
    assert all(entry.is_Rational for entry in (*plant.J, *plant.R))
    assert definiteness(sp.Matrix(plant.R))[0] in ("positive", "flat")


@pytest.mark.parametrize("case", CASES)
def test_the_energy_has_its_minimum_at_the_target(found, case):
    matching, target = found(case)
    slope = np.array(matching.plant.grad_H.subs(target).evalf(30), dtype=float)
    assert np.abs(slope).max() < 1e-12
    assert (
        definiteness(sp.hessian(matching.plant.H, matching.plant.x).subs(target))[0] == "positive"
    )


@pytest.mark.parametrize("case", CASES)
def test_the_structure_moves_as_the_plant_does(found, case):
    f, G, x, star = case()
    matching, _ = found(case)
    G = sp.Matrix(G)
    v = sp.symbols(f"v1:{G.cols + 1}", real=True)
    plant = matching.plant
    u = matching.u0 + matching.gain * sp.Matrix(v)
    true = sp.Matrix(f) + G * u
    seen = (plant.J - plant.R) * plant.grad_H + plant.G * sp.Matrix(v)
    both = sp.lambdify((*x, *v), [list(true), list(seen)])
    rng = np.random.default_rng(0)
    for _ in range(10):
        point = [float(s) + 0.3 * rng.uniform(-1, 1) for s in star]
        rates = np.array(both(*point, *rng.uniform(-1, 1, G.cols)), dtype=float)
        assert np.allclose(*rates, rtol=1e-8, atol=1e-8 * (1 + np.abs(rates).max()))


@pytest.mark.parametrize("case", CASES)
def test_the_shaping_functions_are_linear_and_of_the_ports(found, case):
    matching, target = found(case)
    plant = matching.plant
    assert len(matching.shaping) == plant.m
    slopes = sp.Matrix([[sp.diff(c, s) for c in matching.shaping] for s in plant.x])
    assert not slopes.free_symbols
    rest = ((plant.J - plant.R) * slopes + plant.G).applyfunc(sp.simplify)
    assert rest.is_zero_matrix
    assert all(sp.simplify(c.subs(target)) == 0 for c in matching.shaping)


@pytest.mark.parametrize("case", CASES)
def test_the_linearised_structure_is_stable_with_damping_at_its_ports(found, case):
    matching, target = found(case)
    plant = matching.plant
    F = float_matrix(sp.Matrix(plant.J - plant.R - plant.G * plant.G.T))
    Q = float_matrix(sp.hessian(plant.H, plant.x).subs(target))
    assert np.linalg.eigvals(F @ Q).real.max() < 0


def test_sizes_and_units_of_the_plant_are_kept():
    f, G, x, star = pendulum_by_torque()
    domain = {"q": (-sp.pi, sp.pi)}
    matching, _ = structure_of(
        f, G, x, star, sizes={x[1]: 0.5}, name="rod", units={"q": "rad"}, domain=domain
    )
    plant = matching.plant
    assert (plant.name, plant.units, plant.domain) == ("rod", {"q": "rad"}, domain)


def test_two_states_in_other_units_give_the_same_energy():
    f, G, x, star = pendulum_by_torque()
    q, p = x
    scale = 2**10
    scaled = [e.subs(p, p * scale) for e in map(sp.sympify, f)]
    scaled[1] /= scale
    sizes = {q: 1.0, p: 1.0}
    one, _ = structure_of(f, G, x, star, sizes=sizes)
    other, _ = structure_of(scaled, G, x, star, sizes={q: 1.0, p: 1.0 / scale})
    same = sp.expand(other.plant.H.subs(p, p / scale) / one.plant.H)
    assert sp.simplify(same).is_number


integers = st.integers(-3, 3)


@given(st.lists(integers, min_size=9, max_size=9))
@settings(max_examples=40, deadline=None)
def test_one_unactuated_direction_is_decided_by_its_mode(entries):
    """ẋ₃ = a·x is the row without an input: no structure iff a ~ e₃ and a₃ > 0."""
    x = sp.symbols("x1:4", real=True)
    f = sp.Matrix(3, 3, entries) * sp.Matrix(x)
    G = sp.Matrix([[1, 0], [0, 1], [0, 0]])
    result, _ = structure_of(f, G, x, (0, 0, 0))
    *coupling, own = entries[6:]
    if any(coupling) or own < 0:
        assert isinstance(result, Matching)
    else:
        assert result.proved == (own > 0)


@given(st.lists(integers, min_size=9, max_size=9))
@settings(max_examples=20, deadline=None)
def test_linear_plants_are_refused_only_where_a_mode_is_out_of_reach(entries):
    x = sp.symbols("x1:4", real=True)
    A, G = sp.Matrix(3, 3, entries), sp.Matrix([0, 0, 1])
    result, _ = structure_of(A * sp.Matrix(x), G, x, (0, 0, 0))
    controllable = sp.Matrix.hstack(G, A * G, A * A * G).rank() == 3
    if controllable:
        assert isinstance(result, Matching)
    if isinstance(result, NoStructure) and result.proved:
        assert not controllable


def test_a_mode_that_no_input_reaches_and_that_grows_is_found():
    A = sp.Matrix([[0, 1, 0], [-2, R(1, 100), 0], [1, 0, -1]])
    G = sp.Matrix([0, 0, 1])
    assert uncontrollable_growth(A, G)
    assert not uncontrollable_growth(A - sp.diag(0, R(1, 50), 0), G)
    assert uncontrollable_growth(sp.zeros(2, 2), sp.Matrix([0, 1]))
    assert not uncontrollable_growth(sp.zeros(2, 2), sp.Matrix([0, 1]), conserved=True)
    assert uncontrollable_growth(sp.diag(1, 0), sp.Matrix([0, 1]), conserved=True)
    assert not uncontrollable_growth(A, sp.Matrix([1, 0, 0]))


def test_pivot_friction_of_a_wheel_pendulum_leaves_no_constant_structure_and_that_is_proved():
    """The dual certificate is on a face: rounded without that, it is none."""
    theta, _, p, r = x = sp.symbols("theta phi p r", real=True)
    speed = sp.Rational(5, 2) * (p - r)
    f = [speed, 4 * r - speed, sp.sin(theta) - speed / 50, 0]
    result, _ = structure_of(f, [0, 0, 0, 1], x, (0, 0, 0, 0))
    assert isinstance(result, NoStructure)
    assert result.proved
    free, _ = structure_of([*f[:2], sp.sin(theta), 0], [0, 0, 0, 1], x, (0, 0, 0, 0))
    assert isinstance(free, Matching)


def test_a_nonlinearity_that_no_constant_structure_fits_is_refused_with_a_proof():
    """b₁₁ = 0 by symmetry, then b₁₂ + b₂₁ = 0 by dissipation, and S₁₁ = b₁₂ = 0."""
    x1, x2, x3 = x = sp.symbols("x1:4", real=True)
    f = [x2 + x1**2, x3 + x1 * x2, 0]
    result, _ = structure_of(f, [0, 0, 1], x, (0, 0, 0))
    assert result.proved
    assert "in these coordinates" in result.reason


@pytest.mark.parametrize("case", [flexible_joint, levitation, logarithms])
def test_no_certificate_is_found_against_what_exists(case):
    f, G, x, star = case()
    annihilator = sp.Matrix.hstack(*sp.Matrix(G).T.nullspace()).T
    target = dict(zip(x, map(sp.sympify, star), strict=True))
    slopes = (annihilator * sp.Matrix(f)).jacobian(x)
    assert not no_constant_structure(slopes, annihilator, target)


@pytest.mark.parametrize(
    ("change", "piece", "proved"),
    [
        ({"star": (1, 0)}, "equilibrium", True),
        ({"G": [[0], [1 + sp.Symbol("q", real=True) ** 2]]}, "G depends", False),
        ({"G": [[1, 0], [0, 1]]}, "input of its own", False),
    ],
)
def test_what_is_not_covered_is_told(change, piece, proved):
    _, G, x, star = pendulum_by_torque()
    given = {"f": [sp.sin(x[0]) + x[1], 0], "G": G, "x": x, "star": star} | change
    result, _ = structure_of(*given.values())
    assert isinstance(result, NoStructure)
    assert piece in result.reason
    assert result.proved == proved


def test_friction_of_an_inertia_wheel_leaves_a_constant_structure():
    """Where no mechanical one is found."""
    plant, _, target = load("inertia_wheel")
    R2 = sp.diag(0, 0, R(1, 1000), R(1, 1000))
    damped = make_plant(plant.x, plant.J, R2, plant.G, plant.H)
    (none,) = mechanical_structures(damped, target)
    assert isinstance(none, NoStructure)
    matching = constant_structure((plant.J - R2) * plant.grad_H, plant.G, plant.x, target)
    assert matching.holds
    assert definiteness(sp.hessian(matching.plant.H, plant.x).subs(target))[0] == "positive"


@pytest.mark.parametrize("case", [levitation, synchronous_motor, reactor, generator])
def test_the_plain_loop_accepts_the_structure(found, case):
    """H₀ has its minimum at the target already, so no Casimir is needed."""
    matching, target = found(case)
    loop = interconnect(matching.plant, default_controller(matching.plant))
    verdict = judge(loop, find_casimirs(loop, (), target), target)
    assert (verdict.reason, verdict.stability) == ("ok", "asymptotic")


@pytest.mark.parametrize("F", [[[0, 0], [0, -1]], [[0, -1, 1], [1, 0, 1], [-1, -1, 0]]])
def test_a_structure_that_conserves_something_is_not_refused(F):
    """F itself is constant and H₀ least at 0: with ℓF = 0 = ℓG a linear function stays."""
    F = sp.Matrix(F)
    x = sp.symbols(f"x1:{F.rows + 1}", real=True)
    H = sum(s**2 for s in x) + x[0] ** 3
    G = sp.Matrix([0, 1]) if len(x) == 2 else sp.Matrix([1, 1, 0])
    f = F * sp.Matrix([sp.diff(H, s) for s in x])
    result, _ = structure_of(f, G, x, [0] * len(x))
    assert not (isinstance(result, NoStructure) and result.proved)


def test_a_mode_at_rest_that_bends_later_is_refused():
    """ẋ₁ = x₁³ + x₁²: nothing is conserved, though the linearisation has λ = 0."""
    x1, x2 = x = sp.symbols("x1:3", real=True)
    result, _ = structure_of([x1**3 + x1**2, x2], [0, 1], x, (0, 0))
    assert result.proved


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_sizes_beyond_floating_point_are_told(size):
    f, G, x, star = pendulum_by_torque()
    result, _ = structure_of(f, G, x, star, sizes={x[0]: size, x[1]: 1 / size})
    assert not result.proved
    assert "sizes" in result.reason


def test_large_plants_and_poles_are_told():
    x = sp.symbols("x1:18", real=True)
    result, _ = structure_of([*x[1:], 0], [*[0] * 16, 1], x, [0] * 17)
    assert not result.proved
    assert "states" in result.reason
    q, p = sp.symbols("q p", real=True)
    result, _ = structure_of([p / q, 0], [0, 1], (q, p), (0, 0))
    assert not result.proved
    assert "finite" in result.reason


def test_an_energy_with_logarithms_is_real_and_in_partial_fractions():
    """A ball below a magnet with leakage: sᵢ is rational in the gap, and its primitive a log."""
    flux, q, p = x = sp.symbols("phi q p", real=True)
    k, coil, m, g, r = R("6.5e-5"), R("0.4"), R("0.068"), R("9.81"), 11
    current = flux * q / (coil * q + k)
    f = [-r * current, p / m, m * g - k * flux**2 / (2 * (coil * q + k) ** 2)]
    gap = R("0.006")
    x_star = dict(zip(x, ((coil + k / gap) * gap * sp.sqrt(2 * m * g / k), gap, 0), strict=True))
    domain = {"q": (R("0.002"), R("0.014"))}
    found = constant_structure(sp.Matrix(f), sp.Matrix([1, 0, 0]), x, x_star, domain=domain)
    assert not isinstance(found, NoStructure), found
    H = found.plant.H
    assert not H.has(sp.I)
    assert H.has(sp.log)
    assert all(is_real_there(e.args[0], x_star) for e in H.atoms(sp.log) if e.free_symbols)
    assert max(sp.denom(term).as_poly(q).degree() for term in H.args if sp.denom(term).has(q)) == 1


def is_real_there(inside, x_star) -> bool:
    return bool(inside.subs(x_star) > 0)


def interacting_tanks():
    """A pump into the first of two tanks; the flow between them is real where h₁ > h₂ only."""
    h1, h2 = x = sp.symbols("h1 h2", positive=True)
    area, outlet, g = R("0.0154"), R("2.5e-5"), R("9.81")  # m², m², m/s²
    between, out = (outlet * sp.sqrt(2 * g * h) for h in (h1 - h2, h2))
    return [-between / area, (between - out) / area], [1 / area, 0], x, (R("0.4"), R("0.2"))


def test_a_plant_that_is_real_on_half_of_its_space_is_held():
    """∂s/∂x has no real value at a point with h₁ < h₂, which tells nothing about what it is."""
    f, G, x, target = interacting_tanks()
    slopes = sp.Matrix([f[1]]).jacobian(x)
    there = dict(zip(x, target, strict=True))
    assert nothing_is_conserved(slopes, there)
    found = constant_structure(sp.Matrix(f), sp.Matrix(G), x, there)
    assert isinstance(found, Matching)
    assert found.holds
    H = sp.lambdify([x], found.plant.H)
    at_rest = np.array([float(v) for v in target])
    rng = np.random.default_rng(0)
    moved = at_rest + rng.uniform(-0.02, 0.02, (50, 2))
    assert min(H(point) for point in moved) > H(at_rest)


def test_what_is_conserved_is_found_to_be_so():
    """Two rows that are a multiple of one another at every point are dependent at all of them."""
    f, _, x, target = interacting_tanks()
    there = dict(zip(x, target, strict=True))
    assert not nothing_is_conserved(sp.Matrix([f[1], 3 * f[1]]).jacobian(x), there)
    assert nothing_is_conserved(sp.Matrix([f[1], 3 * f[0]]).jacobian(x), there)


def one_branch(s1):
    """ẋ = F_d∇H₀ near 0 with H₀ = ½(a² + b² + c²) + ⅓a³, where s₁ is −a − a² + b."""
    a, b, c = x = sp.symbols("a b c", real=True)
    return structure_of([s1(a, b), -a - a**2 - b + c, a - c], [0, 0, 1], x, [0] * 3)[0]


def test_what_another_branch_is_like_refuses_nothing_here():
    """√(a² + 2a + 1) is 1 + a near 0, and −1 − a beyond −1, where the same F_d would not do."""
    root = lambda a: sp.sqrt(a**2 + 2 * a + 1)  # noqa: E731
    assert isinstance(one_branch(lambda a, b: -(1 + a) * a + b), Matching)
    found = one_branch(lambda a, b: -root(a) * a + b)
    assert isinstance(found, Matching) or not found.proved
    # a stays as it is near 0, and nowhere beyond −1
    stays = one_branch(lambda a, b: (root(a) - 1 - a) * (1 - b))
    assert not stays.proved
    assert "may stay" in stays.reason


@pytest.mark.slow
def test_a_structure_that_is_there_is_never_refused():
    """Plants made of a known F_d, often singular, an H₀ and a feedback: found, or left open."""
    rng, seen = random.Random(4), set()
    for _ in range(15):
        f, G, x = made_of_a_structure(rng)
        found, _ = structure_of(f, G, x, [0] * len(x))
        assert isinstance(found, Matching) or not found.proved, (f, G)
        seen.add(isinstance(found, Matching))
    assert True in seen


def made_of_a_structure(rng):
    """F = K − LLᵀ, L of any rank, ∇²H₀(0) ≻ 0, f = F∇H₀ + Gu."""
    number = lambda: sp.Rational(rng.randint(-2, 2), rng.choice((1, 1, 2)))  # noqa: E731
    while True:
        n = rng.choice((2, 3, 3))
        x = sp.symbols(f"x1:{n + 1}", real=True)
        K = sp.Matrix(n, n, lambda i, j: number() if i > j else 0)
        L = sp.Matrix(n, rng.randint(1, n), lambda i, j: number() * rng.randint(0, 1))
        root = sp.eye(n) + sp.Matrix(n, n, lambda i, j: rng.randint(-1, 1) * rng.randint(0, 1))
        G = sp.Matrix(n, 1, lambda i, j: rng.randint(-1, 1))
        form = sum(number() * v for v in x)
        bend = rng.choice((form**3 / 3, form**4 / 4, 1 - sp.cos(form), sp.log(1 + form**2)))
        H = (sp.Matrix(x).T * root * root.T * sp.Matrix(x))[0] / 2 + bend
        if root.det() == 0 or G.is_zero_matrix or "zoo" in str(H):
            continue
        there = sp.hessian(H, x).subs(dict.fromkeys(x, 0))
        if not there.is_positive_definite:
            continue
        slope = sp.Matrix([sp.diff(H, v) for v in x])
        f = (K - K.T - L * L.T) * slope + G * rng.choice((0, x[0], x[-1] ** 2))
        return list(f.applyfunc(sp.expand)), list(G), x
