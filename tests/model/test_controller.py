"""Controllers: the default one, and structures that are refused."""

import pytest
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.controller import default_controller, make_controller


def test_the_default_controller_is_one_integrator_per_input(crane):
    controller = default_controller(crane.loop.plant)
    assert controller.states == ("xi1", "xi2")
    assert controller.Jc.is_zero_matrix
    assert controller.Rc.is_zero_matrix
    assert sp.eye(2) == controller.Gc


@pytest.mark.parametrize(
    ("code", "matrices"),
    [
        ("jc_not_skew", ([[1]], [[0]], [[1]])),
        ("rc_not_psd", ([[0]], [[-1]], [[1]])),
        ("gc_rank", ([[0]], [[0]], [[0]])),
        ("shape", ([[0, 0], [0, 0]], [[0]], [[1]])),
        ("shape", ([[0]], [[0]], [[1, 1]])),
        ("undefined_symbol", ([[0]], [[sp.Symbol("q", real=True) ** 2]], [[1]])),
    ],
)
def test_bad_controllers(pendulum, code, matrices):
    """The controller's structure may depend on ξ only, not on the plant's states."""
    xi = (sp.Symbol("s", real=True),)
    with pytest.raises(ModelError) as caught:
        make_controller(pendulum.loop.plant, xi, *map(sp.Matrix, matrices))
    assert caught.value.code == code
