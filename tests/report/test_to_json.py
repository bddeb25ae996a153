"""The JSON of a run: what stands in it is what was reached, and every number is finite."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from necc_casadi.designs.error_bound import loss, published_bound
from necc_casadi.files import to_json_text
from necc_casadi.report.to_json import to_json


def test_the_json_says_what_ends_the_region(found):
    certificate, obstacle = to_json(found)["certificate"], found.certificate.obstacle
    assert certificate["obstacle"] == {
        "kind": obstacle.kind,
        "at": dict(obstacle.at),
        "level_above_minimum": obstacle.level_above_minimum,
    }
    assert certificate["level_above_minimum"] < obstacle.level_above_minimum
    assert set(certificate["reach"]) == set(found.method.loop.states)
    assert certificate["domain_share"] == found.domain_share
    bare = replace(found.certificate, obstacle=None, reach=None, level_above_minimum=None)
    nothing = to_json(replace(found, certificate=bare))["certificate"]
    assert nothing["obstacle"] is nothing["reach"] is nothing["limited_by"] is None


def test_the_design_is_measured_from_its_weights(found):
    made, block = found.design, to_json(found)["design"]
    assert block["loss"] == loss(made)
    assert block["bound_paper"] == published_bound(loss(made), made.a)
    assert block["distance"] == np.linalg.norm(made.z_bar - made.z_star)
    curvatures = np.linalg.eigvalsh(made.lyapunov.hessian(made.z_bar))
    np.testing.assert_allclose(block["hessian_eigenvalues"], curvatures, rtol=1e-12)
    assert block["hessian_min_eig"] == min(block["hessian_eigenvalues"])
    spectrum = np.linalg.eigvals(made.lyapunov.linearisation(made.z_bar))
    found_spectrum = [complex(*parts) for parts in block["spectrum"]]
    np.testing.assert_allclose(
        np.sort_complex(found_spectrum), np.sort_complex(spectrum), rtol=1e-7, atol=1e-9
    )
    slowest_first = [part for part, _ in block["spectrum"]]
    assert slowest_first == sorted(slowest_first, reverse=True)
    assert block["spectral_abscissa"] == slowest_first[0] < 0


def test_what_was_not_reached_is_null(found):
    bare = to_json(replace(found, design=None, certificate=None))
    for block in ("design", "certificate", "sizes", "responses", "sampling", "sweep"):
        assert bare[block] is None
    assert bare["status"] == "assignable"
    assert bare["notes"] == bare["files"] == []


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_numbers_that_are_not_finite_are_null(found, value):
    data = to_json(replace(found, simulated_share=value, timings={"solve": value}))
    assert data["certificate"]["simulated_share"] is None
    assert data["timings"] == {"solve": None}
    assert json.loads(to_json_text(data)) == data
