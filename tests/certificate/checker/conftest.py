"""A certificate of the sampled loop with few boxes, for the whole folder."""

from dataclasses import replace

import pytest

from necc_casadi.certificate.claims.disturbed import Disturbances
from necc_casadi.certificate.prover.certify import certify, with_sampled_loop
from necc_casadi.certificate.prover.sampled import prove

#: A small part of Ω and short periods: few boxes.
T = 0.01


@pytest.fixture(scope="session")
def sampled_folder(default_design, tmp_path_factory):
    made = tmp_path_factory.mktemp("sampled")
    default_design.save(made / "design.json")
    certificate = certify(default_design)
    part = replace(certificate, level_above_minimum=certificate.level_above_minimum / 5)
    heights = {"level_above_minimum": certificate.level_above_minimum}
    borne = Disturbances("float", {"q": 1e-5}, {"u": 1e-6})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        found = with_sampled_loop(default_design, part, T, "heun", borne)
    certificate = replace(found, **heights)
    (made / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    return made
