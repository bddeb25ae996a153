"""Integral action with fewer inputs than coordinates: local, proved, proved again, simulated."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, verdicts
from helpers.sampled import with_limits
from helpers.velocity import crane

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.arithmetic.intervals import point
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.integral import IntegralTerms, prove_integral
from necc_casadi.certificate.prover.local_integral import linearised, prove_local_integral
from necc_casadi.designs.plant_file import plant_text
from necc_casadi.errors import OptionError
from necc_casadi.model.lagrangian import lagrangian
from necc_casadi.simulation.responses import simulate
from necc_casadi.simulation.saturated import disturbed_field
from necc_casadi.synthesis.integral import with_integral

PUSH = ((sp.Rational(-1, 5), sp.Rational(1, 5)),)


@pytest.fixture(scope="module")
def loaded():
    made, many = crane(m=("1/2", "2"))
    return with_integral(made, plants=many, disturbance=PUSH), many


@pytest.fixture(scope="module")
def folder(loaded, tmp_path_factory):
    made, many = loaded
    at, held = tmp_path_factory.mktemp("local"), prove_local_integral(made, many, PUSH)
    proof = certify(made, region=False)
    made.save(at / "design.json")
    text = replace(proof, claims=(*proof.claims, held)).to_json()
    (at / "certificate.json").write_text(text, encoding="utf-8")
    (at / "plant.json").write_text(plant_text(made, many.parametric), encoding="utf-8")
    return at


def test_it_is_local_and_proved_and_proved_again(loaded, folder):
    made, many = loaded
    assert prove_integral(made, many, PUSH) is None
    held = claim(json.loads((folder / "certificate.json").read_text("utf-8")), "local_integral")
    assert held["holds"]
    assert held["statement"].startswith("locally, with integral action")
    assert "no region is claimed" in held["statement"]
    assert (
        "for every constant disturbance of the inputs in [-1/5, 1/5], m in [1/2, 2], ζ* strictly"
        in (held["statement"])
    )
    assert all(verdicts(folder).values())


def test_the_linearisation_is_that_of_the_loop(loaded):
    """Its spectrum is that of differences of the field in (q, p, ξ, ζ), under a disturbance."""
    made = loaded[0].natural
    terms = IntegralTerms(loaded[0], lagrangian(loaded[0].loop, loaded[0].units))
    field, d = disturbed_field(made), np.array([0.1])
    rest = np.concatenate([made.z_star, d])
    assert np.abs(np.asarray(field(rest, d))).max() < 1e-12
    step, columns = 1e-6, []
    for row in np.eye(len(rest)):
        ends = [np.asarray(field(rest + s * step * row, d), float).ravel() for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * step))
    wanted = np.sort_complex(np.linalg.eigvals(np.array(columns).T))
    A = linearised(terms, point(np.zeros((1, 0)))).mid[0]
    assert np.sort_complex(np.linalg.eigvals(A)) == pytest.approx(wanted, abs=1e-7)


def test_inputs_that_cannot_hold_a_disturbance_are_not_said_to(loaded):
    """Clipped at rest, u leaves an offset though ζ has the room."""
    made, many = loaded
    at_end = with_limits(made, [(-0.2, 0.2)])
    found = prove_local_integral(at_end, many, PUSH)
    assert (found.holds, found.statement) == (False, statements.INTEGRAL_IS_TOO_SMALL)
    found = prove_local_integral(with_limits(made, [(-0.25, 0.2001)]), many, PUSH)
    assert found.holds
    assert "u at rest strictly within [-0.25, 0.2001]" in found.statement
    found = prove_local_integral(at_end, many)  # of those disturbances alone that leave u room
    assert found.holds
    assert "u at rest strictly within [-0.2, 0.2]" in found.statement
    start = made.z_star[:4]
    end = simulate(with_limits(made, [(-0.1, 0.1)]), start, disturbance=[0.15], time=200.0).z[-1]
    assert abs(end[0] - made.z_star[0]) > 0.1


@pytest.mark.parametrize(("limits", "holds"), [((-0.25, 0.25), True), ((-0.2, 0.25), False)])
def test_inputs_at_rest_are_proved_again_to_be_within_limits(
    loaded, folder, tmp_path, limits, holds
):
    made, many = loaded
    limited = with_limits(made, [limits])
    limited.save(tmp_path / "design.json")
    (tmp_path / "plant.json").write_text(plant_text(limited, many.parametric), encoding="utf-8")
    data = json.loads((folder / "certificate.json").read_text("utf-8"))
    sides = {"m": ("1/2", "2")}, [("-1/5", "1/5")], [limits]
    claim(data, "local_integral")["statement"] = statements.local_integral(
        made.integral.limit, *sides
    )
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    assert verdicts(tmp_path)["local_integral"] is holds


@pytest.mark.parametrize("fault", ["resting", "uncertain", "gain"])
def test_what_was_not_proved_is_found_out(folder, tmp_path, fault):
    texts = {f: (folder / f).read_text("utf-8") for f in ("certificate.json", "plant.json")}
    data, design = (
        json.loads(texts["certificate.json"]),
        (folder / "design.json").read_text("utf-8"),
    )
    held = claim(data, "local_integral")
    if fault == "resting":
        held["data"]["resting"] = [[-0.1, 0.1]]
    elif fault == "uncertain":
        held["data"]["uncertain"]["w"] = ["-1/10", "1/10"]
        held["statement"] = held["statement"].replace(
            "m in [1/2, 2]", "m in [1/2, 2], w in [-1/10, 1/10]"
        )
    else:
        stored = json.loads(design)
        stored["integral"] |= {"gain": [(100.0).hex()], "tau": (1e-3).hex()}
        design, held["data"]["uncertain"] = json.dumps(stored), {}
        held["statement"] = held["statement"].replace(", m in [1/2, 2]", "")
    (tmp_path / "design.json").write_text(design, encoding="utf-8")
    (tmp_path / "plant.json").write_text(texts["plant.json"], encoding="utf-8")
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    assert verdicts(tmp_path)["local_integral"] is False


def test_a_loop_that_does_not_decay_is_not_proved(loaded):
    made = loaded[0]
    quick = replace(made, integral=replace(made.integral, tau=1e-3, gain=np.array([100.0])))
    found = prove_local_integral(quick)
    assert (found.holds, found.statement) == (False, statements.NO_LOCAL_INTEGRAL)


@pytest.mark.parametrize("m", [sp.Rational(1, 2), sp.Integer(2)])
def test_no_offset_is_left_of_what_inputs_move(loaded, m):
    """Under a constant force, with another load than the model's; without ζ one is left."""
    made, many = loaded
    H = many.parametric.H.subs({sp.Symbol("m", real=True): m, sp.Symbol("w", real=True): 0})
    plant = replace(made.loop.plant, H=H)
    p = plant.x[2:]
    inertia = sp.ImmutableMatrix(sp.hessian(plant.H, p).inv())
    plant = replace(plant, inertia=inertia)
    start = made.z_star[:4] + np.array([0.2, 0.1, 0.0, 0.0])
    varied = replace(made, loop=replace(made.loop, plant=plant))
    end = simulate(varied, start, disturbance=[0.15], time=400.0).z[-1, :2]
    assert np.abs(end - made.z_star[:2]).max() < 1e-9
    end = simulate(replace(varied, integral=None), start, disturbance=[0.15], time=400.0).z[-1, :2]
    assert abs(end[0] - made.z_star[0]) > 1e-2


def test_what_no_input_holds_is_refused():
    """A wind of unknown strength moves the load, which no input acts on."""
    made, many = crane(w=("-1/10", "1/10"))
    with pytest.raises(OptionError, match="no input holds the target"):
        with_integral(made, plants=many)
