"""What the sampled loop is asked to bear: read, and refused in two lines."""

from dataclasses import replace
from pathlib import Path

import pytest
import sympy as sp

from necc_casadi.errors import OptionError
from necc_casadi.model.model_file import load_model
from necc_casadi.pipeline.disturbances import check_disturbances, read_disturbances
from necc_casadi.pipeline.given import request_of
from necc_casadi.pipeline.request import Request

EXAMPLE = Path(__file__).parent.parent.parent / "examples" / "pendulum.py"


@pytest.fixture(scope="module")
def plant():
    return load_model(EXAMPLE).loop.plant


def asked(**options):
    return Request(EXAMPLE, **options)


def test_sizes_are_read_by_name(plant):
    request = asked(sample_time=0.01, noise="q=1e-3, p=1/8", input_error="u=0", real="float")
    check_disturbances(request, plant)
    found = read_disturbances(request, plant)
    assert found.noise == {"q": 1e-3, "p": 0.125}
    assert (found.input_error, found.precision, found.delayed) == ({"u": 0.0}, "float", False)


def test_noise_is_named_by_what_is_measured(plant):
    """Of a plant that is given q̇ no momentum is."""
    fed = replace(plant, inertia=sp.ImmutableMatrix([[1]]))
    found = read_disturbances(asked(sample_time=0.01, noise="q=1e-3,q_dot=0.1"), fed)
    assert found.noise == {"q": 1e-3, "q_dot": 0.1}
    with pytest.raises(OptionError, match="p=1 is not NAME=SIZE of q, q_dot"):
        check_disturbances(asked(sample_time=0.01, noise="p=1"), fed)


def test_python_says_the_same(plant):
    options = {"sample_time": 0.01, "noise": {"q": 1e-3}, "delay": True, "min_sample_time": 1e-4}
    request = request_of(EXAMPLE, "pi/4", None, options)
    found = read_disturbances(request, plant)
    assert (found.noise, found.shortest, found.delayed) == ({"q": 1e-3}, 1e-4, True)


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"noise": "q=1"}, "--noise is about the sampled loop"),
        ({"delay": True}, "--delay is about the sampled loop"),
        ({"sample_time": 0.1, "min_sample_time": 0.2}, "--min-sample-time 0.2 is above"),
        ({"sample_time": 0.1, "noise": "r=1"}, "--noise r=1 is not NAME=SIZE of q, p"),
        ({"sample_time": 0.1, "noise": "q=1,q=2"}, "--noise q=2 is not NAME=SIZE"),
        ({"sample_time": 0.1, "noise": "q"}, "--noise q is not NAME=SIZE"),
        ({"sample_time": 0.1, "input_error": "u=-1"}, "--input-error u=-1 is no size"),
        ({"sample_time": 0.1, "noise": "q=oo"}, "--noise: the name"),
    ],
)
def test_what_cannot_be_asked_is_refused(plant, options, fault):
    with pytest.raises(OptionError) as refused:
        check_disturbances(asked(**options), plant)
    assert str(refused.value).startswith(fault)
