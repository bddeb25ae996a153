"""Names of states, for C and Python."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable

from sympy.printing.c import reserved_words, reserved_words_c99

from necc_casadi.symbolic.expressions import CONSTANTS, FUNCTIONS
from necc_casadi.texts import to_ascii

__all__ = ["identifiers"]


_C_WORDS = {*reserved_words, *reserved_words_c99, "main"}


def identifiers(names: Iterable[str]) -> list[str]:
    """Unique names that are valid in Python, in C and in :func:`parse`, one per name.

    Valid names stay as they are, so that stored designs and C code read like the model.
    """
    result: list[str] = []
    for name in names:
        candidate = re.sub(r"\W", "_", to_ascii(name), flags=re.ASCII).strip("_") or "s"
        if candidate[0].isdigit():
            candidate = "s" + candidate
        reserved = (
            keyword.iskeyword(candidate)
            or candidate in _C_WORDS
            or candidate in FUNCTIONS
            or candidate in CONSTANTS
        )
        unique = candidate = candidate + "_" if reserved else candidate
        count = 2
        while unique in result:
            unique, count = f"{candidate}_{count}", count + 1
        result.append(unique)
    return result
