"""What the code takes for the states where q̇ is measured: by M(q) written out in NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from flint import arb
from helpers.velocity import arm, crank, pendulum

from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.sampled.measured import MeasuredProof
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.sampled.disturbance import Disturbed
from necc_casadi.certificate.prover.sampled.measured import Measured
from necc_casadi.certificate.prover.sampled.rounding import Rounding, programs
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.designs.layout import to_dict
from necc_casadi.export.compiled import compile_controller
from necc_casadi.model.sizes import Sizes

U = 2.0**-24


def inertia_of_crank(q):
    return 3 * (1 + np.cos(q[..., :1, None]) ** 2 / 2)


def inertia_of_arm(q):
    a = np.cos(q[..., 1])
    rows = [[5 / 3 + a, 1 / 3 + a / 2], [1 / 3 + a / 2, np.full_like(a, 1 / 3)]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def in_other_units(design):
    """The same in natural units that are none of the model's."""
    N, m, r = design.loop.n, design.loop.plant.m, len(design.casimirs.functions)
    state = 2.0 ** np.resize([-1, 0, 2, 1], N)
    units = Sizes(state, np.full(m, 2.0), 4.0, 0.25, np.full(r, 0.5))
    return replace(design, units=units)


CASES = {
    "crank": (crank(3.0), inertia_of_crank),
    "crank in other units": (in_other_units(crank(3.0)), inertia_of_crank),
    "arm": (in_other_units(arm()), inertia_of_arm),
}


def boxes(design, count, rng):
    """Boxes of (x, ξ) in the units of the model, from points to wide ones: middles and halves."""
    size = design.loop.n
    z = design.z_bar + rng.uniform(-0.7, 0.7, (count, size))
    return z, rng.uniform(0, 0.3, (count, size)) * 10.0 ** rng.integers(-4, 1, (count, 1))


def around(design, z, half):
    scale = design.units.state
    return Interval((z - half) / scale, (z + half) / scale)


@pytest.mark.parametrize("name", CASES)
def test_what_is_taken_is_within_its_bounds_and_fills_some_of_them(name):
    """y with noise at its bounds and rounded, then p = M(q)q̇; and u and ξ̇ by that."""
    (design, inertia), rng = CASES[name], np.random.default_rng(0)
    n, scale = design.loop.plant.n, design.units.state
    k, measured = n // 2, Measured(design)
    noise = np.full(n, 1e-3)
    z, half = boxes(design, 300, rng)
    Z = around(design, z, half)
    taken = measured.taken(Z, noise / measured.units[:n], U)
    x = z + rng.uniform(-1, 1, z.shape) * half
    y = x.copy()
    y[:, k:n] = np.linalg.solve(inertia(x[:, :k]), x[:, k:n, None])[..., 0]
    exact = measured.over(Z)
    own = y / measured.units
    assert ((exact.lo <= own + 1e-12) & (own <= exact.hi + 1e-12)).all()
    off = noise * rng.choice([-1.0, 1.0], (len(x), n))
    read = (y + np.hstack([off, np.zeros_like(y[:, n:])])).astype(np.float32).astype(float)
    there = read.copy()
    there[:, k:n] = (inertia(read[:, :k]) @ read[:, k:n, None])[..., 0]
    seen = there / scale
    assert ((taken.states.lo <= seen) & (seen <= taken.states.hi)).all()
    assert (abs(read - y) / measured.units <= taken.errors).all()
    slopes = slopes_of(design, taken.states)
    bound = taken.moved(slopes, taken.errors)
    law = design.natural.lyapunov.control_law
    error = np.hstack(law(seen[:, :n], seen[:, n:])) - np.hstack(
        law(x[:, :n] / scale[:n], x[:, n:] / scale[n:])
    )
    assert (abs(error) <= bound).all()
    narrow = half.max(1) < 1e-2
    assert (abs(error).max(0) >= 0.2 * bound[narrow].min(0)).all()  # and of that size


def slopes_of(design, Z):
    """Of the law of a design over boxes of states."""
    size, n, m = design.loop.n, design.loop.plant.n, design.loop.plant.m
    step, none = Step(Potential(design.natural), "heun"), np.zeros(m)
    loop = Disturbed(
        step, Measured(design), np.zeros((size, size)), np.eye(size), np.zeros(n), none, U,
        1.0, 1.0, None, none,
    )  # fmt: skip
    return loop._slopes(Z)


def test_what_an_error_of_q_does_through_the_inertia_cancels_in_a_law_without_one():
    """u of q and q̇: its slope in q at fixed q̇ is far less than those of its terms."""
    design = crank(3.0)
    z = np.array([[0.7, 8.0, 0.1]])
    taken = Measured(design).taken(Interval(z, z), np.array([1e-3, 0.0]), U)
    slopes = slopes_of(design, taken.states)
    apart = slopes.magnitude @ taken.turn.magnitude @ taken.errors[..., None]
    assert 100 * taken.moved(slopes, taken.errors)[0, 0] < apart[0, 0, 0]


@pytest.mark.parametrize("name", CASES)
def test_the_checker_takes_the_same(name):
    design, _ = CASES[name]
    z, half = boxes(design, 5, np.random.default_rng(1))
    Z, noise = around(design, z, half), np.full(design.loop.plant.n, 1e-3)
    own = Measured(design).taken(Z, noise, U)
    proof = MeasuredProof(StoredDesign(to_dict(design)))
    np.testing.assert_array_equal(proof.units, Measured(design).units)
    for i in range(len(z)):
        box = tuple(zip(Z.lo[i].tolist(), Z.hi[i].tolist(), strict=True))
        other = proof.taken(box, noise.tolist(), arb(U))
        np.testing.assert_allclose([float(v) for v in other.errors], own.errors[i], rtol=0.1)
        np.testing.assert_allclose(np.array(other.states)[:, 0], own.states.lo[i], atol=0.02)
        np.testing.assert_allclose(np.array(other.states)[:, 1], own.states.hi[i], atol=0.02)


@pytest.mark.parametrize("made", [pendulum, lambda: CASES["crank in other units"][0], arm])
def test_rounding_of_the_code_is_within_its_bounds(made):
    """Compiled in float, at (q, q̇); the momenta that it makes are rounded, too."""
    design, rng = made(), np.random.default_rng(2)
    n, m, units = design.loop.plant.n, design.loop.plant.m, design.units
    z = design.z_bar + rng.uniform(-1, 1, (400, design.loop.n))
    measured = Measured(design)
    box = around(design, design.z_bar, np.ones(design.loop.n))
    Y = measured.over(box[None])[0]
    bound = np.concatenate(Rounding(design, "float", *programs(design)).over(Y))
    x = design.lyapunov.measured(z[:, :n])
    y, xi = (v.astype(np.float32).astype(float) for v in (x, z[:, n:]))
    code = compile_controller(design, real="float")
    computed = np.array([np.concatenate(code.control(a, b)) for a, b in zip(y, xi, strict=True)])
    exact = np.hstack(design.control(y, xi))
    scale = np.concatenate([units.input, units.state[n:] / units.time])
    seen = np.abs(computed - exact).max(0) / scale
    assert (seen <= bound).all()
    assert (seen[:m] >= 1e-3 * bound[:m]).all()
