"""Words from which Casimirs are composed."""

import sympy as sp

from necc_casadi.casimirs.vocabulary import MOST_WORDS, products, trig_products, unique

x = sp.symbols("x1:61", real=True)


def test_products_of_several_degrees():
    a, b = x[:2]
    assert products([a, b], (2,)) == [a**2, a * b, b**2]
    assert set(products([a, b], (2, 3))) == {a**2, a * b, b**2, a**3, a**2 * b, a * b**2, b**3}


def test_too_many_products_are_none_and_not_a_list():
    assert products(x, (3,)) is None
    assert products(x, (2, 3)) is None
    assert len(products(x, (2,))) > MOST_WORDS


def test_each_angle_occurs_at_most_once():
    a, b = x[:2]
    words = trig_products([a, b])
    assert len(words) == 8
    assert words[0] in (sp.cos(a), sp.sin(a), sp.cos(b), sp.sin(b))
    assert trig_products(x) == []


def test_words_without_a_state_are_dropped():
    assert unique([x[0], sp.pi, x[0]]) == [x[0]]
