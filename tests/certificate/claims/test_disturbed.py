"""What is said of noise: of which quantities, and in which units."""

from types import SimpleNamespace

from helpers.velocity import crank

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.disturbed import Core, DisturbedRegion
from necc_casadi.certificate.claims.rounding import Program
from necc_casadi.certificate.claims.units import Units
from necc_casadi.report.to_json import _disturbed_region

UNITS = Units((2.0, 4.0, 1.0), 1.0, 0.5)


def region(noise):
    none, core = Program(3, (), ()), Core(((0.0, 1.0),) * 3, 1.0)
    return DisturbedRegion(
        0.1, 1.0, "float", noise, (0.0,), None, none, none, ((1.0,),), 1.0, 1.0, 1.0, 1.0, "",
        (core,), 1.0, (0.25, 0.25, 0.25),
    )  # fmt: skip


def words(noise, velocities):
    return statements.disturbed(region(noise), ("q", "p", "xi1"), ("u",), UNITS, [1], velocities)


def test_noise_of_velocities_is_in_their_unit_and_radii_are_of_momenta():
    """1 of q̇ is 2/0.5 in the model, 1 of p is 4."""
    text = words((0.125, 0.125), True)
    assert "measured q within ±0.25, q_dot within ±0.5, then rounded" in text
    radii = "within q ± 0.5, p ± 1, xi1 ± 0.25 of z̄"
    assert f"{radii}, states of the model: p = M(q)q̇ of the plant, without noise. Assumed" in text
    assert "q, q_dot measured without error but rounded" in words((0.0, 0.0), True)


def test_noise_of_states_is_in_theirs():
    text = words((0.125, 0.125), False)
    assert "measured q within ±0.25, p within ±0.5, then rounded" in text
    assert "of z̄. Assumed" in text
    assert "x measured without error but rounded" in words((0.0, 0.0), False)


def test_the_json_names_what_is_measured():
    certificate = SimpleNamespace(disturbed=region((0.125, 0.25)), units=UNITS)
    found = _disturbed_region(crank(), certificate)
    assert found["noise"] == {"q": 0.25, "q_dot": 1.0}
    assert found["radius"] == {"q": 0.5, "p_q": 1.0, "xi1": 0.25}
