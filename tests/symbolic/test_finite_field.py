"""Expressions over a finite field."""

import numpy as np
import sympy as sp

from necc_casadi.symbolic.finite_field import values


def test_values_respect_the_identities_of_functions():
    x, y = sp.symbols("x y", positive=True)
    identities = [
        sp.sin(x) ** 2 + sp.cos(x) ** 2 - 1,
        sp.sin(x + 2 * y) - sp.sin(x) * sp.cos(2 * y) - sp.cos(x) * sp.sin(2 * y),
        sp.sqrt(x * y) - sp.sqrt(x) * sp.sqrt(y),
        sp.log(x * y) - sp.log(x) - sp.log(y),
        sp.exp(x / 2) ** 2 - sp.exp(x),
    ]
    assert not np.any(values(identities, 5))
