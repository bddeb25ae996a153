"""certificate.json as objects that know which of their entries were asked for, and as dataclasses.

What nobody asks for is not proved either: :meth:`Fields.unread` names it. A dataclass asks for
its own fields and for nothing else.
"""

from __future__ import annotations

import dataclasses
import sys
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal, Self, TypeVar, Union, get_args, get_origin, get_type_hints

__all__ = ["Entries", "Fields", "read_as", "without_twins"]


T = TypeVar("T")


class Fields(Mapping[str, Any]):
    """A JSON object; what nobody asked for was not proved either."""

    def __init__(self, data: Mapping[str, Any], name: str = "") -> None:
        self._name, self._asked = name, set[str]()
        self._data = {key: _wrapped(value, f"{name}{key}.") for key, value in data.items()}

    def __getitem__(self, key: str) -> Any:
        self._asked.add(key)
        return self._data[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._data)

    def __len__(self) -> int:
        return len(self._data)

    def unread(self) -> list[str]:
        """Names of the entries that were never asked for, those within entries included."""
        result = [f"{self._name}{key}" for key in self._data if key not in self._asked]
        for key in self._asked & self._data.keys():
            value = self._data[key]
            for inner in value if isinstance(value, list) else [value]:
                result += inner.unread() if isinstance(inner, Fields) else []
        return result


def _wrapped(value: Any, name: str) -> Any:
    """Objects as Fields, those in a list too, which go by what they are called."""
    if isinstance(value, dict):
        return Fields(value, name)
    if isinstance(value, list):
        return [_wrapped(v, f"{v['name']}: " if _named(v) else name) for v in value]
    return value


def _named(value: Any) -> bool:
    return isinstance(value, dict) and "name" in value


def without_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object in which no name stands twice.

    Raises
    ------
    ValueError
        When one does.
    """
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("an entry is named twice")
    return result


def read_as(kind: type[T], data: Mapping[str, Any], **readers: Callable[[Any], Any]) -> T:
    """A dataclass from an object with an entry for each of its fields, of the field's type.

    `readers` are for fields whose type does not say how to read them; None stays None.

    Raises
    ------
    KeyError
        When an entry is missing.
    ValueError
        When an entry has another type.
    """
    if not isinstance(data, Mapping):
        raise ValueError(f"no object: {data!r:.60}")
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    values = {name: data[name] for name in names}
    return kind(
        **{
            name: _typed(hints[name], value, name)
            if value is None or name not in readers
            else readers[name](value)
            for name, value in values.items()
        }
    )


class Entries:
    """What is proved of a claim: a dataclass whose fields are its entries of certificate.json."""

    @property
    def data(self) -> dict[str, Any]:
        """The entries, by name."""
        return dataclasses.asdict(self)  # type: ignore[call-overload,no-any-return]

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> Self:
        """What is proved, from these entries.

        Raises
        ------
        KeyError, ValueError
            When an entry is missing or has another type.
        """
        return read_as(cls, data)


def _typed(hint: Any, value: Any, name: str) -> Any:
    """A value as the type says; JSON has lists for tuples."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType) and types.NoneType in parts:
        if value is None:
            return None
        (inner,) = (part for part in parts if part is not types.NoneType)
        return _typed(inner, value, name)
    if origin is tuple and isinstance(value, (list, tuple)):
        many = len(parts) == 2 and parts[1] is Ellipsis
        inner = parts[:1] * len(value) if many else parts
        if len(inner) == len(value):
            return tuple(_typed(h, v, name) for h, v in zip(inner, value, strict=True))
    if origin is Mapping and isinstance(value, Mapping):
        each = parts[1]
        return value if each is Any else {k: _typed(each, value[k], f"{name}.{k}") for k in value}
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return read_as(hint, value)
    if _is_plain(hint, value) or (origin is Literal and value in parts):
        return float(value) if hint is float else value
    raise ValueError(f"{name}: {value!r:.60}")


def _is_plain(hint: Any, value: Any) -> bool:
    """Whether a value is of a plain type; whole numbers are numbers, truth values are not."""
    if isinstance(value, bool) or hint is bool:
        return hint is bool and isinstance(value, bool)
    if hint is float:
        return isinstance(value, (int, float)) and abs(value) <= sys.float_info.max
    return hint in (int, str) and isinstance(value, hint)
