"""Planes of two states: the pair, the slice of Ω and its shadow, each by a second route."""

import numpy as np
import pytest
from helpers.problems import problem, solve
from matplotlib.path import Path as Curve
from scipy.optimize import minimize

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.model_file import load_model
from necc_casadi.report.slices import (
    Window,
    domain_window,
    shadow,
    slice_boundary,
    slice_values,
    telling_pair,
)
from necc_casadi.simulation.responses import simulate

#: Hanging pole: one shaped position, one that is not, two momenta.
CART = """
import sympy as sp
s, t, ps, pt = sp.symbols("s t ps pt", real=True)
x = (s, t, ps, pt)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 1, 0])
H = ps**2 / 2 + pt**2 + ps * pt / 2 * sp.cos(t) + 2 * (1 - sp.cos(t - 1))
"""


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "cart.py"
    path.write_text(CART, encoding="utf-8")
    return solve(problem(load_model(path), "s=1,t=1,ps=0,pt=0"))


@pytest.fixture(scope="module")
def region(default_design):
    """(design, its certificate, window around Ω's shadow, shadow)."""
    certificate = certify(default_design)
    whole = domain_window(default_design)
    edge = shadow(default_design, certificate.level, whole)
    return default_design, certificate, whole.around(edge), edge


def test_positions_come_before_momenta(cart, default_design):
    """Without a second position the momentum is shown."""
    assert telling_pair(cart) == (0, 1)
    assert telling_pair(default_design) == (0, 1)
    assert default_design.loop.states[:2] == ("q", "p")


def test_values_are_those_of_V(cart):
    window = domain_window(cart)
    A, B, values = slice_values(cart, window)
    for row, column in ((0, 0), (80, 40), (120, 120)):
        z = cart.z_star.copy()
        z[list(window.pair)] = A[row, column], B[row, column]
        assert values[row, column] == pytest.approx(cart.V(z) - cart.V(cart.z_bar), abs=1e-12)


def test_the_slice_lies_on_the_level(region):
    made, certificate, window, _ = region
    curve = slice_boundary(made, certificate.level, window)
    height = certificate.level - made.V(made.z_bar)
    for a, b in curve[::20]:
        z = made.z_star.copy()
        z[list(window.pair)] = a, b
        assert made.V(z) == pytest.approx(certificate.level, abs=2e-3 * height)


@pytest.mark.parametrize("height", [1e-6, 1e-2, 0.5])
def test_on_the_shadows_edge_the_least_V_is_the_level(cart, height):
    """The least V over the other states by another optimiser, also for couplings in H."""
    window = domain_window(cart)
    pair, rest = list(window.pair), [i for i in range(5) if i not in window.pair]
    bottom = cart.V(cart.z_bar)
    for point in shadow(cart, bottom + height, window)[::16]:

        def lowest(free, point=point):
            z = np.empty(5)
            z[pair], z[rest] = point, free
            return (cart.V(z) - bottom) / height

        found = minimize(lowest, cart.z_bar[rest], method="BFGS").fun
        on_the_edge = (point <= window.lo + 0.05).any() or (point >= window.hi - 0.05).any()
        assert found <= 1 + 1e-6
        assert found >= 0.98 or on_the_edge


def test_the_shadow_of_a_long_region_has_no_long_edges(cart):
    """Rays are added where they end far apart, as they do where V bends unevenly."""
    window = domain_window(cart)
    far = Window(window.pair, 30 * window.lo, 30 * window.hi)
    edge = shadow(cart, cart.V(cart.z_bar) + 300.0, far)
    gaps = np.abs(np.roll(edge, -1, axis=0) - edge) / np.ptp(edge, axis=0)
    assert gaps.max() < 0.13
    assert Curve(edge).contains_point(tuple(cart.z_bar[list(window.pair)]))


def test_the_shadow_holds_the_proved_region(region):
    """Random states of Ω, by its own membership test, all lie over it; so does the slice."""
    made, certificate, window, edge = region
    outline = Curve(edge).interpolated(8)
    middle = made.z_bar[list(window.pair)]
    rng = np.random.default_rng(0)
    states = made.z_star + rng.uniform(-2, 2, (3000, 3))
    inside = np.array([z for z in states if certificate.contains(made.V, z)])
    assert len(inside) > 200
    for points in (inside[:, list(window.pair)], slice_boundary(made, certificate.level, window)):
        assert outline.contains_points(middle + 0.98 * (points - middle)).all()


def test_responses_from_the_slice_stay_in_the_shadow(region):
    made, certificate, window, edge = region
    outline, middle = Curve(edge), made.z_bar[list(window.pair)]
    for start in slice_boundary(made, certificate.level, window)[::60]:
        path = simulate(made, start).z[:, list(window.pair)]
        assert outline.contains_points(middle + 0.98 * (path - middle)).all()
