"""Fill the C texts of ``templates/``."""

from __future__ import annotations

import re
from importlib import resources

__all__ = ["comment", "fill", "indent"]


def fill(template: str, **values: object) -> str:
    """The text of a template with every ``@name@`` replaced by ``values[name]``."""
    text = resources.files(f"{__package__}.templates").joinpath(template).read_text("utf-8")
    filled = re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), text)
    return re.sub(r"\n{3,}", "\n\n", filled)


def indent(text: str, by: str = "    ") -> str:
    """`text` with every line that is not empty moved right."""
    return "\n".join(by + line if line else "" for line in text.rstrip("\n").split("\n"))


def comment(text: str) -> str:
    """`text` on one line and harmless inside a C comment."""
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    return line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
