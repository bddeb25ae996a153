"""What a run on the pendulum found."""

import pytest

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.report.findings import Findings


@pytest.fixture(scope="package")
def found(pendulum, default_design) -> Findings:
    return Findings(
        pendulum.loop, pendulum.x_star, pendulum.casimirs, pendulum.verdict, default_design,
        certify(default_design), domain_share=0.415, simulated_share=0.995,
    )  # fmt: skip
