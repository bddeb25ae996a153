"""The choice of D and Dc: near the best of a finer search, given ones kept, dead modes ignored."""

from pathlib import Path

import numpy as np
import pytest
from helpers.problems import problem, solve

from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.model.model_file import load_model
from necc_casadi.synthesis.damping import choose_damping
from necc_casadi.synthesis.options import Options

EXAMPLES = Path(__file__).parents[2] / "examples"
CASES = {
    "pendulum": "pi/4",
    "series_rlc": "q=1",
    "maglev": None,
    "tora": "theta=0",
    "two_link_arm": "q1=pi/4,q2=-pi/3",
}
UNIT = Options(hidden_k=(8,), hidden_h=(6,))


@pytest.fixture(scope="module")
def made_for():
    made = {}

    def make(name: str, target: str | None):
        if name not in made:
            model = load_model(EXAMPLES / f"{name}.py")
            if target is None:
                target = ",".join(f"{s}={v}" for s, v in model.target.items())
            made[name] = solve(problem(model, target), UNIT)
        return made[name]

    return make


def spectra(made, dampings) -> np.ndarray:
    """Eigenvalues of the loop as it is built (control law and plant), one row per (D, Dc)."""
    V = made.lyapunov
    return np.array(
        [
            np.linalg.eigvals(
                LyapunovFunction(V.terms, V.form, V.weights, uncoupled(D, Dc)).linearisation(
                    made.z_bar
                )
            )
            for D, Dc in dampings
        ]
    )


def affine_linearisation(made):
    """(D, Dc) ↦ the linearised loop, read off the built loop: it is affine in D and Dc."""
    m = made.loop.plant.m
    V = made.lyapunov
    zero = np.zeros((m, m))

    def built(D, Dc):
        damped = LyapunovFunction(V.terms, V.form, V.weights, uncoupled(D, Dc))
        return damped.linearisation(made.z_bar)

    base = built(zero, zero)
    unit = [np.diag(row) for row in np.eye(m)]
    of_D = [built(u, zero) - base for u in unit]
    of_Dc = [built(zero, u) - base for u in unit]
    return lambda d, dc: (
        base
        + sum(w * A for w, A in zip(d, of_D, strict=True))
        + sum(w * A for w, A in zip(dc, of_Dc, strict=True))
    )


@pytest.mark.parametrize("name", CASES)
def test_the_rate_is_near_the_best_of_a_finer_search(made_for, name):
    """Every multiple of the same proportions, four times as fine and ten times as far."""
    made = made_for(name, CASES[name])
    A = affine_linearisation(made)
    d, dc = np.diag(made.D), np.diag(made.Dc)
    steps = np.logspace(-3, 3, 49)
    matrices = np.array([A(s * d, t * dc) for s in steps for t in steps])
    rates = -np.linalg.eigvals(matrices).real.max(axis=1)
    chosen = -np.linalg.eigvals(A(d, dc)).real.max()
    assert np.allclose(A(d, dc), made.lyapunov.linearisation(made.z_bar), atol=1e-9)
    assert rates.min() > 0  # D ≻ 0 never decides whether it is stable
    assert chosen >= 0.88 * rates.max()  # 90 % of the best on a grid of its own


def test_the_smallest_good_damping_is_taken(made_for):
    """A fifth of what is chosen is no longer near the best, in D or in Dc."""
    made = made_for("pendulum", "pi/4")
    A = affine_linearisation(made)
    d, dc = np.diag(made.D), np.diag(made.Dc)
    chosen, weak, weaker = (
        -np.linalg.eigvals(M).real.max() for M in (A(d, dc), A(d / 5, dc), A(d, dc / 5))
    )
    assert weak < 0.95 * chosen
    assert weaker < 0.95 * chosen


def test_given_damping_is_kept_and_the_other_fits_it(made_for):
    made = made_for("two_link_arm", CASES["two_link_arm"])
    given = np.array([[3.0, 0.5], [0.5, 2.0]])
    V = made.lyapunov
    both = choose_damping(V, made.loop, made.z_star, given, given.T)
    assert both[0] is given
    D, Dc = choose_damping(V, made.loop, made.z_star, D=given)
    assert np.array_equal(D, given)
    assert np.linalg.eigvalsh(Dc)[0] > 0
    D, Dc = choose_damping(V, made.loop, made.z_star, Dc=given)
    assert np.array_equal(Dc, given)
    (spectrum,) = spectra(made, [(D, Dc)])
    factors = np.logspace(-2, 2, 41)
    rates = -spectra(made, [(f * D, Dc) for f in factors]).real.max(axis=1)
    assert -spectrum.real.max() >= 0.9 * rates.max()


@pytest.mark.slow
def test_modes_that_no_damping_reaches_are_ignored(made_for):
    """Symmetric chain: the outer masses swing for ever; the other modes decay as fast as can be."""
    made = made_for("symmetric_chain", "q2=1")
    still = 2  # one undamped oscillation, a pair of eigenvalues

    def rate(spectrum) -> float:
        return float(np.sort(-spectrum.real)[still])

    chosen = spectra(made, [(made.D, made.Dc)])[0]
    assert np.sort(np.abs(chosen.real))[:still].max() < 1e-9
    assert rate(chosen) > 1e-3
    factors = np.logspace(-3, 3, 25)
    grid = spectra(made, [(s * made.D, t * made.Dc) for s in factors for t in factors])
    assert np.sort(np.abs(grid.real), axis=1)[:, :still].max() < 1e-6
    assert rate(chosen) >= 0.9 * max(map(rate, grid))
