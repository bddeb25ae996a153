"""The published example: structure, form, and the closed loop of its figures."""

import numpy as np
import pytest
import sympy as sp
from helpers.problems import solve

from necc_casadi.designs.error_bound import loss, published_bound
from necc_casadi.simulation.responses import simulate
from necc_casadi.synthesis.options import paper_options


def test_structure_of_section_iv(pendulum):
    """eq. PendulumPlant: one Casimir q − ξ, a_max = 1 (row p), asymptotic."""
    assert [str(c) for c in pendulum.casimirs.functions] == ["q - xi1"]
    assert (pendulum.casimirs.kernel_rank, pendulum.casimirs.generic_count) == (1, 1)
    assert pendulum.verdict.assignable is True
    assert pendulum.verdict.a_max == 1.0
    assert pendulum.verdict.stability == "asymptotic"
    assert [sp.simplify(v + sp.sin(sp.pi / 4)) for v in pendulum.verdict.lam] == [0]


def test_the_published_form(paper_design):
    form = paper_design.form
    assert (form.k.hidden, form.hc.hidden) == ((64,), (32,))
    assert {form.k.activation, form.hc.activation} == {"tanh"}
    assert not form.k.quadratic
    assert not form.hc.quadratic
    assert form.size == 290 + sum(beta.size for beta in form.betas)
    assert form.phi is None
    assert (paper_design.a, paper_design.D[0, 0], paper_design.Dc[0, 0]) == (0.5, 5.0, 6.0)


def test_equilibrium_assignment_beats_the_published_figures(paper_design):
    """Published: ε = 0.0050, ‖z̄ − z*‖ = 0.0082, bound ε/(a − ε) = 0.0101."""
    epsilon = loss(paper_design)
    distance = np.linalg.norm(paper_design.z_bar - paper_design.z_star)
    assert epsilon <= 1e-9 < 0.0050
    assert distance <= 1e-8 < 0.0082
    assert distance <= published_bound(epsilon, 0.5) + 4e-16


def test_the_published_bound_on_its_own_numbers():
    assert published_bound(0.0050, 0.5) == pytest.approx(0.0101, abs=5e-5)
    assert published_bound(0.0, 0.5) == 0.0


def test_there_is_no_published_bound_from_the_curvature_on():
    """At ε = a the expression has its pole, beyond it is negative."""
    assert published_bound(0.5, 0.5) is None
    assert published_bound(0.6, 0.5) is None


def test_ten_responses_converge(paper_design):
    """Ten random initial states with D = 5, Dc = 6, as in the figure of responses."""
    rng = np.random.default_rng(0)
    for x0 in rng.uniform(-1, 1, (10, 2)):
        response = simulate(paper_design, x0, time=200.0, points=2001)
        assert response.complete
        assert response.converged
        assert np.all(np.diff(response.V) <= 1e-9)
        np.testing.assert_allclose(response.z[-1], paper_design.z_bar, atol=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_seeds_assign_the_same_target(pendulum, seed):
    import dataclasses

    made = solve(pendulum, dataclasses.replace(paper_options(1), seed=seed))
    assert loss(made) <= 1e-9
    np.testing.assert_allclose(made.z_bar[:2], [np.pi / 4, 0], atol=1e-8)
