"""What algebra cannot decide of a model is tried at points of its domain."""

import pytest
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.model.spot_checks import check_model_at

q, p = sp.symbols("q p", real=True)
CANONICAL = sp.Matrix([[0, 1], [-1, 0]])


def loop(R=0, G=1, H=p**2 / 2):
    plant = make_plant((q, p), CANONICAL, sp.diag(0, R), sp.Matrix([0, G]), H)
    return interconnect(plant, default_controller(plant))


def refused(model, target):
    with pytest.raises(ModelError) as caught:
        check_model_at(model, dict(zip((q, p), map(sp.sympify, target), strict=True)))
    return caught.value.code


def test_dissipation_that_turns_negative_is_found_by_points():
    model = loop(R=sp.cos(q) + sp.Rational(1, 2))
    assert [(k.kind, k.matrix) for k in model.properties if not k.proved] == [("psd", "R")]
    assert refused(model, (3, 0)) == "r_not_psd"


def test_dissipation_that_holds_at_every_point_passes():
    check_model_at(loop(R=sp.cos(q) + sp.Rational(3, 2)), {q: sp.Integer(0), p: sp.Integer(0)})


def test_what_is_not_defined_at_the_target():
    assert refused(loop(H=p**2 / 2 + 1 / q), (0, 0)) == "singular"
    assert refused(loop(H=p**2 / 2 + sp.log(q)), (-1, 0)) == "singular"
    assert refused(loop(G=q), (0, 0)) == "g_rank"
