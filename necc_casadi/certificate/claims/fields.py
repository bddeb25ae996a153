"""certificate.json as objects that know which of their entries the checker has asked for."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["Fields", "read_fields"]


class Fields(Mapping[str, Any]):
    """A JSON object; what nobody asked for was not proved either."""

    def __init__(self, data: Mapping[str, Any], name: str = "") -> None:
        self._name, self._asked = name, set[str]()
        self._data = {
            key: Fields(value, f"{name}{key}.") if isinstance(value, dict) else value
            for key, value in data.items()
        }

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
            result += value.unread() if isinstance(value, Fields) else []
        return result


def read_fields(text: str) -> Fields:
    """The object in a JSON text.

    Raises
    ------
    ValueError
        When the text is no JSON object, or names an entry twice.
    """
    data = json.loads(text, object_pairs_hook=_without_twins)
    if not isinstance(data, dict):
        raise ValueError("not a JSON object")
    return Fields(data)


def _without_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("an entry is named twice")
    return result
