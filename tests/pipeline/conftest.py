"""One run with everything in it."""

import pytest
from helpers.problems import PENDULUM
from helpers.runs import SMALL, run
from helpers.sampled import quick_proofs


@pytest.fixture(scope="package")
def everything(tmp_path_factory):
    """One run of the pendulum with every further deliverable: (exit code, JSON, folder)."""
    out = tmp_path_factory.mktemp("everything") / "out"
    with quick_proofs():
        code, data = run(
            PENDULUM, "--target", "pi/4", *SMALL, "--out", out, "--no-plots", "--fmu", "--mex",
            "--sample-time", "0.01", "--sweep-a", "0.2:0.8:3",
        )  # fmt: skip
    return code, data, out
