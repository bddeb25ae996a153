"""The package's own source, parsed once for the tests that read it."""

import ast
from pathlib import Path

import necc_casadi

PACKAGE = Path(necc_casadi.__file__).parent
#: File within the package -> its tree; templates are left out.
TREES = {
    path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text("utf-8"))
    for path in sorted(PACKAGE.rglob("*.py"))
    if "templates" not in path.parts
}
