"""The stubs name nothing that the installed libraries do not have."""

import ast
import importlib
from pathlib import Path

import pytest
import sympy as sp

STUBS = Path(__file__).parents[1] / "stubs"
FILES = sorted(STUBS.rglob("*.pyi"))
#: Where members belong to an instance.
EXAMPLES = {
    "MatrixBase": sp.Matrix([0]),
    "Matrix": sp.Matrix([0]),
    "ImmutableMatrix": sp.ImmutableMatrix([0]),
    "SparseMatrix": sp.SparseMatrix([0]),
}


def defined(body) -> set[str]:
    """Names of what a stub defines, but for its own helpers."""
    names = {getattr(node, "name", "") for node in body}
    names |= {node.target.id for node in body if isinstance(node, ast.AnnAssign)}
    return {name for name in names if name and (not name.startswith("_") or name.endswith("__"))}


def members(name: str, classes: dict[str, ast.ClassDef]) -> set[str]:
    """What a class has by the stub, with what it inherits."""
    found = defined(classes[name].body)
    for base in classes[name].bases:
        found |= members(base.id, classes) if getattr(base, "id", "") in classes else set()
    return found


def has(owner, member: str) -> bool:
    """Whether it has a member; what has places can be iterated over."""
    return hasattr(owner, "__getitem__" if member == "__iter__" else member)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(STUBS)))
def test_stubs_name_only_what_is_there(path):
    module = importlib.import_module(".".join(path.relative_to(STUBS).parent.parts))
    if path.stem != "__init__":
        module = importlib.import_module(f"{module.__name__}.{path.stem}")
    tree = ast.parse(path.read_text("utf-8"))
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    missing = {name for name in defined(tree.body) if not hasattr(module, name)}
    for name in defined(classes.values()) - missing:
        missing |= {
            f"{name}.{member}"
            for member in members(name, classes)
            if not has(EXAMPLES.get(name, getattr(module, name)), member)
        }
    assert not missing


def test_there_are_stubs_of_each_library():
    assert {path.parent.name for path in FILES} >= {"flint", "casadi", "sympy"}
