"""What a run on the pendulum found."""

import pytest

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.methods.find import Found
from necc_casadi.methods.method import Method
from necc_casadi.report.findings import Findings


@pytest.fixture(scope="package")
def found(pendulum, default_design) -> Findings:
    method = Method("interconnection", pendulum.loop, pendulum.casimirs, pendulum.verdict)
    return Findings(
        pendulum.model.system, pendulum.x_star, Found(method, method), default_design,
        certify(default_design), domain_share=0.415, simulated_share=0.995,
    )  # fmt: skip
