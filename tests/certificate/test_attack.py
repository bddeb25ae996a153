"""An attack on what is claimed: random states of Ω, followed by another integrator."""

import numpy as np
import pytest
from helpers.constructed import EXAMPLES
from scipy.integrate import solve_ivp

from necc_casadi import Options, find_casimirs, judge, load_model
from necc_casadi import design as synthesised
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.target import parse_target, target_from_model

STATES, BATCH = 2000, 100
#: Horizons of the linearisation; V may rise by this share of its height through rounding.
HORIZONS, ROUNDING = 12.0, 1e-6


def made(name, target):
    model = load_model(EXAMPLES / f"{name}.py")
    plant = model.loop.plant
    x = parse_target(plant, target) if target else target_from_model(plant, model.target)
    casimirs = find_casimirs(model.loop, model.casimirs, x)
    return synthesised(model.loop, casimirs, judge(model.loop, casimirs, x), x, Options())


def states_of(design, certificate, count):
    """Random states of Ω, half of them just below the level."""
    rng = np.random.default_rng(0)
    lo, hi = np.array(list(certificate.reach.values())).T
    found = []
    while len(found) < count:
        for z in rng.uniform(lo, hi, (4096, len(lo))):
            if certificate.contains(design.V, z):
                found.append(z)
    z = np.array(found[:count])
    momenta = list(design.momenta)
    low, high = np.ones(count // 2), np.full(count // 2, 50.0)
    for _ in range(50):  # the momenta scaled until V reaches the level
        middle = (low + high) / 2
        trial = z[: count // 2].copy()
        trial[:, momenta] *= middle[:, None]
        inside = design.lyapunov.V(trial) <= certificate.level
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    z[: count // 2, momenta] *= low[:, None]
    return z


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target"), [("pendulum", "pi/4"), ("dc_motor", None), ("cart_pole", None)]
)
def test_no_state_of_the_region_leaves_it(name, target):
    """They stay, V never rises, and where it is claimed all converge."""
    design = made(name, target)
    certificate = certify(design)
    claim = next(c for c in certificate.claims if c.name == "region")
    assert claim.holds
    z = states_of(design, certificate, STATES)
    V, field, N = design.lyapunov.V, design.lyapunov.vector_field, design.loop.n
    height = certificate.level_above_minimum
    lo, hi = np.array(list(certificate.reach.values())).T
    slow = HORIZONS / -design.spectrum.real.max()
    for batch in np.split(z, STATES // BATCH):
        found = solve_ivp(
            lambda _, y: field(y.reshape(-1, N)).ravel(),
            (0.0, slow),
            batch.ravel(),
            method="DOP853",
            rtol=1e-9,
            atol=1e-10,
            t_eval=np.linspace(0.0, slow, 40),
        )
        assert found.success
        path = found.y.T.reshape(-1, BATCH, N)
        values = np.array([V(states) for states in path])
        assert (np.diff(values, axis=0) <= ROUNDING * height).all()
        assert (values <= certificate.level + ROUNDING * height).all()
        assert ((lo <= path + 1e-7) & (path <= hi + 1e-7)).all()
        if claim.data["follows"] == "converges":
            away = np.abs(path[-1] - design.z_bar) / design.sizes.state
            assert away.max() < 0.02
