"""From verdict to design: options respected, damping chosen well, units do not matter."""

import dataclasses

import numpy as np
import pytest
from helpers.models import BASE
from helpers.problems import problem, solve

from necc_casadi.designs.error_bound import loss
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.model.model_file import load_model
from necc_casadi.model.sizes import natural_sizes
from necc_casadi.synthesis.options import Options, paper_options


def abscissa(made, D, Dc) -> float:
    V = made.lyapunov
    damped = LyapunovFunction(V.terms, V.form, V.weights, uncoupled(D, Dc))
    return float(np.linalg.eigvals(damped.linearisation(made.z_bar)).real.max())


def test_every_form_assigns_its_target(any_design):
    """KKT of the hard form: ∇V(z*) = 0 and ∇²V(z*) ⪰ aI, seen from the stored weights."""
    V, z = any_design.lyapunov, any_design.z_star
    assert loss(any_design) <= 1e-9
    assert np.linalg.norm(np.asarray(V.gradient(z))) <= 1e-9
    assert np.linalg.eigvalsh(np.asarray(V.hessian(z)))[0] >= any_design.a - 1e-9
    assert float(V.phi_slope(z)) > 0
    A = any_design.linearise()[0]
    assert np.linalg.eigvals(A).real.max() < 0


def test_chosen_damping_is_near_the_best_of_a_fine_search(default_design):
    """Decay within 20 % of the best over a grid ten times as wide; every damping is stable."""
    chosen = abscissa(default_design, default_design.D, default_design.Dc)
    grid = np.logspace(-2, 2, 13)
    rates = [abscissa(default_design, [[d]], [[dc]]) for d in grid for dc in grid]
    assert max(rates) < 0
    assert chosen <= 0.8 * min(rates)


def test_too_much_damping_slows_the_loop(default_design):
    assert abscissa(default_design, [[1e4]], [[1e4]]) > 0.01 * abscissa(
        default_design, default_design.D, default_design.Dc
    )


def test_given_damping_is_kept(pendulum):
    made = solve(pendulum, Options(D=np.array([[2.0]]), Dc=np.array([[3.0]])))
    assert (made.D[0, 0], made.Dc[0, 0]) == (2.0, 3.0)
    half = solve(pendulum, Options(D=np.array([[2.0]])))
    assert half.D[0, 0] == 2.0
    assert half.Dc[0, 0] > 0


def test_a_beyond_the_ceiling_is_lowered_unless_kept(pendulum):
    lowered = solve(pendulum, Options(a=1.5))
    assert (lowered.a, lowered.a_requested) == (pytest.approx(0.9), 1.5)
    assert loss(lowered) <= 1e-9
    kept = solve(pendulum, dataclasses.replace(paper_options(1), a=1.5, keep_a=True))
    assert kept.a == 1.5
    assert loss(kept) == pytest.approx(0.5, abs=1e-6)


def test_more_starts_are_never_worse(pendulum):
    runs = [solve(pendulum, Options(starts=n, hidden_k=(6,), hidden_h=(4,))) for n in (1, 4)]
    assert len(runs[1].starts) == 4
    objectives = [min(s.objective for s in made.starts if s.loss <= 1e-9) for made in runs]
    assert objectives[1] <= objectives[0] + 1e-9


def test_same_options_same_design(pendulum):
    first, second = (solve(pendulum, Options(seed=5)) for _ in range(2))
    assert np.array_equal(first.weights, second.weights)
    assert not np.array_equal(first.weights, solve(pendulum, Options(seed=6)).weights)


@pytest.mark.parametrize("mass", ["0.001", "1", "1000"])
def test_units_do_not_matter(tmp_path, mass):
    """A pendulum of any mass, with the domain of its momentum to match: same shape, scaled."""
    path = tmp_path / "pendulum.py"
    path.write_text(
        BASE
        + f"""
k = sp.Symbol("k")
H = p**2 / (2 * k) + k * (1 - sp.cos(q))
params = {{k: {mass}}}
domain = {{p: (-2 * {mass}, 2 * {mass})}}
"""
    )
    task = problem(load_model(path), "pi/4")
    made = solve(task)
    scale = float(mass)
    state = np.array([1.0, scale, 1.0])
    hessian = np.asarray(made.lyapunov.hessian(made.z_star)) * np.outer(state, state) / scale
    assert loss(made) <= 1e-9 * max(1.0, scale)
    spectrum = np.linalg.eigvalsh(hessian)
    assert spectrum[0] > 0.3
    assert spectrum[-1] < 10
    rate = -np.linalg.eigvals(made.linearise()[0]).real.max()
    assert 0.3 < rate < 3


def test_natural_sizes_follow_the_domain(pendulum):
    """One radian without a domain; a quarter of it with one, and the energy of that angle."""

    def sizes(loop):
        return natural_sizes(loop, pendulum.casimirs.functions, pendulum.x_star)

    plain = sizes(pendulum.loop)
    assert plain.state.tolist() == [1.0, pytest.approx(0.5**0.25), 1.0]
    assert plain.energy == pytest.approx(0.5**0.5)
    wide = dataclasses.replace(pendulum.loop.plant, domain={"q": (-6, 6)})
    found = sizes(dataclasses.replace(pendulum.loop, plant=wide))
    assert found.state.tolist() == [3.0, pytest.approx(3 * 0.5**0.25), 3.0]
    assert found.guessed == ("p", "xi1", "u")
