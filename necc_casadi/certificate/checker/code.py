"""Whether the C code of a folder is the one that was written for its design and certificate.

What the code computes is not proved: its own self-test compares it with computed values.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

from necc_casadi.certificate.checker.evidence import Checked
from necc_casadi.certificate.claims.claim import CERTIFICATE_FILE, DESIGN_FILE
from necc_casadi.certificate.claims.rounding import Number
from necc_casadi.files import hash_of, read_listing, read_text
from necc_casadi.texts import escaped

__all__ = ["check_code"]


_HEADER, _SOURCE = "c/necc.h", "c/necc.c"


_LARGEST = 1 << 28  # bytes


_NAMED = "c/necc.h and c/necc.c name this design, c/necc.h this certificate, and files.json each "


def check_code(
    folder: Path, design_text: str, precision: Number | None = None
) -> tuple[Checked, ...]:
    """The claim of c/: by hashes in its files, and of its files; none where there is no code.

    With a `precision` something is claimed of its rounding, which is that of this type.
    """
    listed = {
        path: digest for path, digest in (read_listing(folder) or {}).items() if path[:2] == "c/"
    }
    if not listed and not any(os.path.lexists(folder / path) for path in (_HEADER, _SOURCE)):
        return ()
    statement = f"{_NAMED}file of c/ as it is; what the code computes is left to c/selftest.c"
    try:
        header, source = (read_text(folder / path, _LARGEST) for path in (_HEADER, _SOURCE))
    except (OSError, UnicodeDecodeError) as problem:
        return (Checked("code", False, f"c/ cannot be read: {escaped(str(problem))[:200]}"),)
    design = hashlib.sha256(design_text.encode()).hexdigest()
    faults = [
        (
            precision is not None and _type(header) != precision,
            f"{_HEADER} does not compute in {precision}, whose rounding is claimed",
        ),
        (_defined(header, "DESIGN") != design, f"{_HEADER} is not of this {DESIGN_FILE}"),
        (
            _defined(header, "CERTIFICATE") != hash_of(folder / CERTIFICATE_FILE),
            f"{_HEADER} is not of this {CERTIFICATE_FILE}",
        ),
        (f"Design {design}." not in source[:200], f"{_SOURCE} is not of this {DESIGN_FILE}"),
        (not {_HEADER, _SOURCE} <= listed.keys(), "files.json does not list the code"),
        *(
            (hash_of(folder / path) != digest, f"{escaped(path)[:60]} was changed")
            for path, digest in listed.items()
        ),
    ]
    wrong = next((text for fails, text in faults if fails), None)
    return (Checked("code", wrong is None, statement if wrong is None else wrong),)


def _type(header: str) -> str | None:
    """Of the numbers of the code; None: the header does not say it once."""
    found = re.findall(r"^typedef (float|double) [A-Za-z]\w*_real;$", header, re.MULTILINE)
    return found[0] if len(found) == 1 else None


def _defined(header: str, name: str) -> str | None:
    """The hash that the header gives under a name, whatever its prefix; None unless it is one."""
    found = re.findall(rf'^#define [A-Za-z]\w*_{name} "([0-9a-f]{{64}})"$', header, re.MULTILINE)
    return found[0] if len(found) == 1 else None
