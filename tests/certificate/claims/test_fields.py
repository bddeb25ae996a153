"""An object knows what was asked of it, and dataclasses take what their fields say."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import pytest

from necc_casadi.certificate.claims.fields import Fields, read_as


def test_an_object_knows_what_was_asked_for():
    fields = Fields({"a": 1, "b": {"c": 2, "d": 3}, "e": {"f": 4}})
    assert fields["a"] == 1
    assert fields["b"]["c"] == 2
    assert sorted(fields.unread()) == ["b.d", "e"]


@dataclass(frozen=True)
class Inner:
    name: str


@dataclass(frozen=True)
class Outer:
    number: float
    maybe: float | None
    count: int
    yes: bool
    word: Literal["this", "that"]
    many: tuple[float, ...]
    pair: tuple[tuple[int, ...], tuple[int, ...]]
    inner: tuple[Inner, ...]
    free: Mapping[str, Any]


GOOD = {
    "number": 1, "maybe": None, "count": 2, "yes": True, "word": "that", "many": [1, 2.5],
    "pair": [[1], [2, 3]], "inner": [{"name": "a"}], "free": {"x": [1, "y"]},
}  # fmt: skip


def test_a_dataclass_takes_what_its_fields_say():
    read = read_as(Outer, GOOD)
    assert read == Outer(
        1.0, None, 2, True, "that", (1.0, 2.5), ((1,), (2, 3)), (Inner("a"),), GOOD["free"]
    )
    assert isinstance(read.number, float)


BAD = {
    "number": [True, "1", None, float("nan"), float("inf"), 10**400], "maybe": ["1"],
    "count": [1.0, True], "yes": [1], "word": ["other", 1], "many": [[1, "2"], 1, [None]],
    "pair": [[[1]], [[1], [2.0]]], "inner": [["a"], [{"name": 1}]], "free": [[1]],
}  # fmt: skip


@pytest.mark.parametrize(
    ("field", "value"),
    [(f, v) for f, values in BAD.items() for v in values],
    ids=lambda v: f"{v!r:.20}",
)
def test_and_nothing_of_another_type(field, value):
    with pytest.raises(ValueError, match=r"\S"):
        read_as(Outer, GOOD | {field: value})


def test_a_missing_entry_is_missed_and_another_is_left_unread():
    with pytest.raises(KeyError):
        read_as(Outer, {k: v for k, v in GOOD.items() if k != "count"})
    fields = Fields(GOOD | {"more": 1, "inner": [{"name": "a", "beside": 2}]})
    read_as(Outer, fields)
    assert sorted(fields.unread()) == ["a: beside", "free.x", "more"]
