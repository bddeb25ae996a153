"""A certificate of the sampled loop with few boxes, for the whole folder."""

from dataclasses import replace

import pytest
from helpers.sampled import quick_proofs
from helpers.velocity import crank

from necc_casadi.certificate.claims.disturbed import Disturbances
from necc_casadi.certificate.prover.certify import certify, with_sampled_loop

#: A small part of Ω and short periods: few boxes.
T = 0.01


def _written(design, certificate, part, borne, made):
    """With what is proved of the sampled loop within a level."""
    design.save(made / "design.json")
    with quick_proofs():
        within = replace(certificate, level_above_minimum=part)
        found = with_sampled_loop(design, within, T, "heun", borne)
    found = replace(found, level_above_minimum=certificate.level_above_minimum)
    (made / "certificate.json").write_text(found.to_json(), encoding="utf-8")
    return made


@pytest.fixture(scope="session")
def sampled_folder(default_design, tmp_path_factory):
    certificate, made = certify(default_design), tmp_path_factory.mktemp("sampled")
    borne = Disturbances("float", {"q": 1e-5}, {"u": 1e-6})
    part = certificate.level_above_minimum / 5
    return _written(default_design, certificate, part, borne, made)


@pytest.fixture(scope="session")
def velocity_folder(tmp_path_factory):
    """The same of a plant that measures q̇ and whose inertia moves."""
    design, made = crank(), tmp_path_factory.mktemp("velocity")
    borne = Disturbances("float", {"q": 1e-5, "q_dot": 1e-4})
    return _written(design, certify(design), 0.05, borne, made)
