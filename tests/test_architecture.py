"""The plan of the house: who imports whom, who prints, what is public, what --help costs."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import necc_casadi

PACKAGE = Path(necc_casadi.__file__).parent
FILES = {
    path.relative_to(PACKAGE).with_suffix("").as_posix().removesuffix("/__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if "templates" not in path.parts
}
TREES = {name: ast.parse(path.read_text("utf-8")) for name, path in FILES.items()}
MODULES = {f"necc_casadi.{name.replace('/', '.')}": name for name in FILES if name != "__init__"}


def _type_checking(node) -> bool:
    return isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"


def imported(tree, top_only=False) -> set[str]:
    """Names of imported modules, without those for the type checker alone."""
    found, todo = set(), list(ast.iter_child_nodes(tree))
    while todo:
        node = todo.pop()
        if _type_checking(node):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        if not (top_only and isinstance(node, ast.FunctionDef | ast.ClassDef)):
            todo += ast.iter_child_nodes(node)
    return found


def inside(name) -> set[str]:
    """Files of the package that a file imports, also within functions."""
    return {MODULES[module] for module in imported(TREES[name]) if module in MODULES} - {name}


def everything_below(name) -> set[str]:
    seen, todo = set(), [name]
    while todo:
        for other in inside(todo.pop()) - seen:
            seen.add(other)
            todo.append(other)
    return seen


def foreign(name) -> set[str]:
    return {module.split(".")[0] for module in imported(TREES[name])}


def test_data_flows_one_way():
    """No file reaches itself through its imports; a package's __init__ may name its own files."""
    for name in FILES:
        family = {other for other in FILES if other.startswith(f"{name}/")}
        assert name not in everything_below(name) or family & inside(name)


def test_errors_and_outcomes_rest_on_nothing():
    assert inside("errors") == set()
    assert inside("outcome") == set()
    assert foreign("errors") <= {"__future__"}


#: A finished design is proved, simulated, exported and drawn without whatever made it.
MAKERS = {"training", "synthesis", "damping", "pipeline", "cli"}


@pytest.mark.parametrize(
    "name", [n for n in FILES if n.split("/")[0] in ("certificate", "export", "simulation",
                                                    "figures", "artifact", "lyapunov")]
)  # fmt: skip
def test_what_uses_a_design_knows_no_solver(name):
    assert not everything_below(name) & MAKERS


CERTIFICATE = {name for name in FILES if name.startswith("certificate")}
CHECKERS = {
    name for name in CERTIFICATE if name.startswith(("certificate/ball", "certificate/check"))
}
#: Without arithmetic: both sides may know these.
NEUTRAL = {"certificate", "certificate/claim", "certificate/statements"}


def test_the_checker_shares_no_arithmetic_with_the_maker():
    """Every other file of the certificate belongs to one side, and neither reaches the other."""
    provers = CERTIFICATE - CHECKERS - NEUTRAL
    assert {"certificate/proof", "certificate/intervals"} <= provers
    assert {"certificate/checker", "certificate/balls"} <= CHECKERS
    for name in NEUTRAL - {"certificate"}:
        assert not inside(name) & (CHECKERS | provers), name
    for name in CHECKERS:
        assert not everything_below(name) & provers, name
    for name in provers:
        assert not everything_below(name) & CHECKERS, name


@pytest.mark.parametrize(
    "name", ["expressions", "exact", "plant", "loop", "target", "model_file", "casimirs",
             "assignability", "curvature", "detectability", "involution", "ansatz", "one_forms",
             "specialise", "wording", "sampling"]
)  # fmt: skip
def test_the_symbolic_side_does_not_call_casadi(name):
    assert "casadi" not in foreign(name)
    assert not inside(name) & MAKERS


@pytest.mark.parametrize("name", ["networks", "training", "lifting", "lyapunov", "simulation"])
def test_the_numeric_side_does_not_call_sympy(name):
    assert "sympy" not in foreign(name)


def test_sympy_and_casadi_meet_at_the_bridge():
    """artifact.py and convexity.py evaluate stored expressions, but translate none themselves."""
    both = {name for name in FILES if {"sympy", "casadi"} <= foreign(name)}
    assert both <= {"bridge", "artifact", "convexity"}


def test_only_the_shell_knows_click_prints_or_exits():
    for name in set(FILES) - {"cli", "terminal", "certificate/command"}:
        assert not foreign(name) & {"click", "rich"}, name
        for node in ast.walk(TREES[name]):
            call = node.func if isinstance(node, ast.Call) else None
            assert getattr(call, "id", "") not in ("print", "exit", "input"), name


def test_habits_of_the_house():
    """No assert, eval or bare except; exec only where the user's own model file runs."""
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            assert not isinstance(node, ast.Assert), name
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, name
            if isinstance(node, ast.Call):
                called = getattr(node.func, "id", "")
                assert called != "eval", name
                assert called != "exec" or name == "model_file"
        assert not foreign(name) & {"pickle", "shelve", "marshal", "scipy", "torch"}, name


def test_errors_are_a_tree_with_code_fault_and_remedy():
    from necc_casadi import errors

    for name in ("ModelError", "TargetError", "OptionError", "OutputError"):
        problem = getattr(errors, name)("code", "a fault\nin two lines", "a remedy")
        assert isinstance(problem, errors.InputError)
        assert isinstance(problem, errors.NeccError)
        assert (problem.code, problem.fault, problem.remedy) == (
            "code", "a fault in two lines", "a remedy"
        )  # fmt: skip
        assert str(problem) == "a fault in two lines\na remedy"


PUBLIC = [
    "Casimirs", "Certificate", "ClosedLoop", "Controller", "Design", "Model", "Options", "Plant",
    "Trajectory", "Verdict", "__version__", "certify", "design", "export_c", "find_casimirs",
    "interconnect", "judge", "load_model", "make_controller", "make_plant", "paper_options",
    "parse_target", "simulate",
]  # fmt: skip


def test_the_public_names_are_pinned_and_documented():
    assert sorted(necc_casadi.__all__) == PUBLIC
    assert set(dir(necc_casadi)) >= set(PUBLIC)
    for name in set(PUBLIC) - {"__version__"}:
        assert getattr(necc_casadi, name).__doc__, name
    with pytest.raises(AttributeError, match="no_such_name"):
        necc_casadi.no_such_name


def test_every_name_that_a_file_offers_exists():
    from importlib import import_module

    for module in MODULES:
        offered = import_module(module)
        for name in getattr(offered, "__all__", ()):
            assert hasattr(offered, name), f"{module}.{name}"


HEAVY = ("sympy", "casadi", "numpy", "matplotlib", "flint", "scipy")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["--nonsense"]])
@pytest.mark.parametrize("command", ["_design", "_simulate"])
def test_help_imports_no_heavy_package(command, arguments):
    code = (
        "import sys; from necc_casadi import cli; from necc_casadi.terminal import run; "
        f"run(cli.{command}, {arguments!r}); "
        f"sys.exit(len([m for m in {HEAVY!r} if m in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_importing_the_package_is_light():
    code = f"import sys, necc_casadi; sys.exit(any(m in sys.modules for m in {HEAVY!r}))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
