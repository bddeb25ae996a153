"""Random small matrices of integers."""

import sympy as sp
from hypothesis import strategies as st

entries = st.integers(-3, 3)


@st.composite
def matrices(draw, rows=(1, 5), columns=(1, 5)):
    r, c = draw(st.integers(*rows)), draw(st.integers(*columns))
    return sp.Matrix(r, c, draw(st.lists(entries, min_size=r * c, max_size=r * c)))
