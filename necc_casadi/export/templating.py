"""Fill the C texts of ``templates/``."""

from __future__ import annotations

import re
from importlib import resources

from necc_casadi.texts import escaped, to_ascii

__all__ = ["PREFIX", "comment", "fill", "indent", "prefixed"]


#: The prefix that templates are written with.
PREFIX = "necc"


def fill(template: str, **values: object) -> str:
    """The text of a template with every ``@name@`` replaced by ``values[name]``."""
    text = resources.files(f"{__package__}.templates").joinpath(template).read_text("utf-8")
    filled = re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), text)
    return re.sub(r"\n{3,}", "\n\n", filled)


def indent(text: str, by: str = "    ") -> str:
    """`text` with every line that is not empty moved right."""
    return "\n".join(by + line if line else "" for line in text.rstrip("\n").split("\n"))


def comment(text: str) -> str:
    """`text` on one line of ASCII and harmless inside a C comment."""
    line = to_ascii(escaped(text))
    return line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def prefixed(code: str, prefix: str) -> str:
    """C code with another prefix to its names; file names and comments on them stay."""
    code = re.sub(rf"\b{PREFIX}_(?=\w)", f"{prefix}_", code)
    return re.sub(rf"\b{PREFIX.upper()}_(?=\w)", f"{prefix.upper()}_", code)
