"""Docstrings on the site: names of pages become links, values are shown without their fields."""

from __future__ import annotations

import re

from sphinx.application import Sphinx

_PAGE = re.compile(r"docs/([\w-]+)\.md(#[\w-]+)?")

#: The one value that a user builds by hand; functions make the others.
_BUILT = "necc_casadi.Options"


def _linked(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]):
    """``docs/contract.md#json`` in the lines of a docstring leads to that page."""
    lines[:] = [_PAGE.sub(r"`\g<0> <\1.html\2>`__", line) for line in lines]


def _unsigned(
    app: Sphinx,
    what: str,
    name: str,
    thing: object,
    options: object,
    signature: str | None,
    *_: object,
) -> tuple[str, None] | None:
    """No signature for a class that no user calls."""
    return ("", None) if what == "class" and signature and name != _BUILT else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to autodoc."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _linked)
    app.connect("autodoc-process-signature", _unsigned)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
