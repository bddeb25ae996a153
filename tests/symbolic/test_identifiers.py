"""Names of states for C and Python."""

import keyword

from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.symbolic.expressions import (
    FUNCTIONS,
)
from necc_casadi.symbolic.identifiers import identifiers


@given(st.lists(st.text(min_size=1, max_size=12), max_size=6))
def test_identifiers_are_valid_unique_and_one_per_name(names):
    result = identifiers(names)
    assert len(result) == len(set(result)) == len(names)
    for name in result:
        assert name.isascii()
        assert name.isidentifier()
        assert not keyword.iskeyword(name)
        assert name not in FUNCTIONS


def test_good_names_stay_and_reserved_ones_change():
    assert identifiers(["q", "p_1", "double", "lambda", "pi", "1x", "θ"])[:2] == ["q", "p_1"]
    assert not {"double", "lambda", "pi", "1x"} & set(identifiers(["double", "lambda", "pi", "1x"]))
