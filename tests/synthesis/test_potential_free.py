"""Plants whose Casimirs see nothing of their energy: where ξ* goes, and what K and Hc become."""

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from helpers.constructed import EXAMPLES

from necc_casadi import Options, design, find_casimirs, judge, load_model
from necc_casadi.casimirs.find import find_casimirs as found_for
from necc_casadi.lyapunov.lyapunov import make_terms
from necc_casadi.model.sizes import natural_sizes
from necc_casadi.model.target import target_from_model
from necc_casadi.synthesis.potential_free import (
    POTENTIAL_FREE_STIFFNESS,
    best_coordinates,
    is_potential_free,
)


@pytest.fixture(scope="module")
def satellite():
    model = load_model(EXAMPLES / "satellite.py")
    x_star = target_from_model(model.loop.plant, model.target)
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    return model.loop, casimirs, x_star


def worth(terms, x, xi) -> float:
    """Log det ∂c/∂xᵀ∂c/∂x with sizes 1, by CasADi's own determinant of numbers."""
    z = ca.MX.sym("z", terms.n + terms.nc)
    slopes = ca.Function("N", [z], [ca.jacobian(terms.c(z), z)[:, : terms.n]])
    N = np.asarray(slopes(np.concatenate([x, xi])), float)
    return float(np.linalg.slogdet(N @ N.T)[1])


def condition(loop, xi) -> float:
    """Log ‖Gc‖²‖Gc⁻¹‖² by NumPy."""
    numbers = loop.controller.Gc.subs(dict(zip(loop.controller.xi, xi, strict=True)))
    Gc = np.array(numbers.evalf(), float)
    return float(np.log(np.linalg.norm(Gc) ** 2 * np.linalg.norm(np.linalg.inv(Gc)) ** 2))


def test_a_satellite_is_neutral_and_a_pendulum_is_not(satellite):
    loop, casimirs, _ = satellite
    assert is_potential_free(loop, casimirs)
    for name in ("pendulum", "cart_pole"):  # the latter's Casimir is linear
        loop = load_model(EXAMPLES / f"{name}.py").loop
        assert not is_potential_free(loop, found_for(loop))


def test_the_controller_rests_where_the_casimirs_are_good_coordinates(satellite):
    """A stationary point of log det less a share of Gc's condition, better than the verdict's ξ*.

    The controller's own singularity, ξ2 = ±90°, is farther than from the best coordinates alone.
    """
    loop, casimirs, x_star = satellite
    terms = make_terms(loop, casimirs)
    x = np.array([float(x_star[s]) for s in loop.plant.x])
    guess = np.zeros(3)
    scales = natural_sizes(loop, casimirs.functions, x_star)
    found = best_coordinates(terms, x, guess, scales)
    size = 1e-4 * np.eye(3)

    def value(xi) -> float:
        return worth(terms, x, xi) - 0.1 * condition(loop, xi)

    slopes = [(value(found + h) - value(found - h)) / 2e-4 for h in size]
    assert np.abs(slopes).max() < 1e-3
    assert value(found) > value(guess) + 0.1
    assert abs(found[1]) < 0.55  # the best coordinates alone are at 0.574


def test_the_best_place_is_kept_where_all_are_alike():
    """∂c/∂x does not depend on ξ: nothing is gained by moving."""
    loop = load_model(EXAMPLES / "maglev.py").loop
    casimirs = found_for(loop)
    terms = make_terms(loop, casimirs)
    x, guess = np.array([0.1, 0.0]), np.array([0.02])
    x_star = dict(zip(loop.plant.x, (sp.Rational(1, 10), sp.Integer(0)), strict=True))
    scales = natural_sizes(loop, casimirs.functions, x_star, guess)
    assert best_coordinates(terms, x, guess, scales) == pytest.approx(guess)


@pytest.mark.slow
def test_k_is_stiffer_than_hc_by_the_reference(satellite):
    loop, casimirs, x_star = satellite
    made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star, Options())
    weights = made.form.split(made.weights)
    hc, k = (net.quadratic_part(w)[0] for net, w in zip(made.form.networks, weights, strict=True))
    assert k.min() > hc.max()
    assert hc.min() > 0.5 * POTENTIAL_FREE_STIFFNESS[0] * 0.7
    assert max(start.loss for start in made.starts) < 1e-9


def test_casimirs_are_written_with_few_terms(satellite):
    """Addition theorems shorten what an ansatz of monomials finds; both are Casimirs."""
    loop, casimirs, _ = satellite
    assert max(len(sp.Add.make_args(c)) for c in casimirs.functions) <= 3
    rng = np.random.default_rng(0)
    for c in casimirs.functions:
        rates = sp.lambdify(loop.z, [sp.diff(c, s) for s in loop.z])
        M = sp.lambdify(loop.z, loop.M)
        for z in rng.uniform(-0.9, 0.9, (5, len(loop.z))):
            assert np.abs(np.array(rates(*z)) @ np.array(M(*z), float)).max() < 1e-12
