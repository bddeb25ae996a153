"""One run with everything in it."""

import pytest
from helpers.problems import PENDULUM
from helpers.runs import SMALL, run

from necc_casadi.certificate.prover.sampled import prove


@pytest.fixture(scope="package")
def everything(tmp_path_factory):
    """One run of the pendulum with every further deliverable: (exit code, JSON, folder).

    No longer periods than the one that is asked for are tried.
    """
    out = tmp_path_factory.mktemp("everything") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        code, data = run(
            PENDULUM, "--target", "pi/4", *SMALL, "--out", out, "--no-plots", "--fmu", "--mex",
            "--sample-time", "0.01", "--sweep-a", "0.2:0.8:3",
        )  # fmt: skip
    return code, data, out
