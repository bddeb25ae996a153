"""Other plants of each kind, which no method was made for: what holds them, and what is proved."""

from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from necc_casadi.certificate.checker.check import check
from necc_casadi.choice.choose import choose
from necc_casadi.methods.find import find_method
from necc_casadi.model.model_file import load_model

ASIDE = Path(__file__).parent / "kept_aside"
HELD = {
    "two_stage_filter": "shaping",
    "salient_poles": "shaping",
    "stepper_motor": "shaping",
    "torsion_mirror": "shaping",
    "half_bridge": "modulated",
    "sepic_converter": "modulated",
    "three_phase_rectifier": "modulated",
    "separately_excited": "modulated",
    "one_cubic_damper": "interconnection",
    "balancing_robot": "mechanical",
    "ball_on_a_wheel": "mechanical",
    "cubli": "mechanical",
    "constant_power_load": "constant",
    "magnetic_bearing": "constant",
    "middle_state_reactor": "constant",
    "soft_drive": "constant",
    "two_tanks": "constant",
}
#: Found within a second or two, one of each method.
QUICK = {"salient_poles", "half_bridge", "one_cubic_damper", "cubli", "constant_power_load"}


def found(name):
    model = load_model(ASIDE / f"{name}.py")
    momenta = dict.fromkeys(model.system.x, sp.Integer(0))
    target = momenta | {s: model.target[str(s)] for s in model.system.x if str(s) in model.target}
    return model, target, find_method(model, target).chosen


def test_every_plant_is_expected_to_be_held():
    assert {path.stem for path in ASIDE.glob("*.py")} == set(HELD)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in HELD]
)
def test_another_plant_of_the_kind_is_held_by_the_same_method(name):
    _, _, method = found(name)
    assert method is not None
    assert method.name == HELD[name]
    assert method.verdict.stability == "asymptotic"


def test_what_a_shift_adds_to_the_energy_is_the_force_at_the_target():
    """H₀ of a converter is ½‖x − x*‖² in its energies, whatever roots the target has."""
    model, target, method = found("three_phase_rectifier")
    H, x = method.loop.plant.H, model.system.x
    away = sp.hessian(model.system.H, x)
    error = sp.Matrix([s - target[s] for s in x])
    rest = sp.expand(H - (error.T * away * error)[0] / 2)
    assert not rest.free_symbols
    assert sum(len(e.args) for e in sp.Add.make_args(H)) < 40


@pytest.mark.slow
def test_another_method_is_found_for_a_motor_whose_shifted_loop_is_hard_to_train():
    model, target, method = found("separately_excited")
    assert method.name == "modulated"
    others = find_method(model, target, most=3).alternatives
    assert "constant" in [other.name for other in others]
    assert all(other.verdict.assignable for other in others)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["salient_poles", "half_bridge", "one_cubic_damper", "cubli", "constant_power_load"]
)
def test_what_is_proved_of_another_plant_holds_on_the_plant_of_its_file(name, tmp_path):
    """V̇ ≤ 0 at 300 states of the region, and solutions that stay, with f and G of the file."""
    model, target, method = found(name)
    kept = choose(method.loop, method.casimirs, method.verdict, target)
    design, certificate = kept.design, kept.certificate
    assert certificate.certified
    assert certificate.stability == "asymptotic"
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert [r.statement for r in check(tmp_path) if not r.holds and r.name != "code"] == []
    plant = model.system
    drift = sp.lambdify([plant.x], list(plant.drift), "numpy")
    directions = sp.lambdify([plant.x], plant.directions.tolist(), "numpy")
    n = plant.n

    def rate(z):
        u, xi_dot = design.lyapunov.control_law(z[:n], z[n:])
        x_dot = np.array(drift(z[:n]), float) + np.array(directions(z[:n]), float) @ u
        return x_dot, np.concatenate([x_dot, xi_dot])

    rng, states = np.random.default_rng(5), []
    while len(states) < 300:
        spread = design.sizes.state * rng.normal(size=design.loop.n) * rng.uniform(0, 1)
        z = design.z_bar + spread
        if certificate.is_global or certificate.contains(design.V, z):
            states.append(z)
    scale = max(design.V(z) - design.V(design.z_bar) for z in states)
    for z in states:
        slope = np.asarray(design.lyapunov.gradient(z), float).ravel()
        _, z_dot = rate(z)
        assert slope @ z_dot <= 1e-9 * scale / design.units.time
    horizon = 3 * design.units.time
    for z in states[:5]:
        path = solve_ivp(lambda _, w: rate(w)[1], (0, horizon), z, method="LSODA", rtol=1e-8)
        V = [design.V(w) for w in path.y.T]
        assert np.diff(V).max() <= 1e-6 * scale
        assert certificate.is_global or certificate.contains(design.V, path.y[:, -1])
