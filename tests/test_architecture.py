"""The plan of the house: who imports whom, who prints, what is public, what --help costs."""

import ast
import subprocess
import sys
from functools import cache

import pytest
from helpers import sources
from helpers.sources import PACKAGE

import necc_casadi

#: Folders and top-level files in the order of the theory. Each imports from lines above its own
#: only; what shares a line does not know each other.
ORDER = (
    ("errors", "arrays", "cases", "interrupts", "texts"),
    ("files",),
    ("folders",),
    ("symbolic",),
    ("model",),
    ("casimirs",),
    ("verdict",),
    ("methods",),
    ("lyapunov",),
    ("designs",),
    ("simulation", "certificate"),
    ("export", "performance"),
    ("synthesis",),
    ("choice",),
    ("report",),
    ("pipeline",),
    ("study",),
    ("cli",),
    ("__main__",),
)
#: The same within certificate/: the prover and the checker know the claims, never each other.
CERTIFICATE_ORDER = (("claims",), ("prover", "checker"))
#: sympy up to here, CasADi from the next line on; these alone know both.
SYMBOLIC = {"symbolic", "model", "casimirs", "verdict", "methods"}
BOTH = {"lyapunov/sympy2casadi", "synthesis/sample_box"}

FILES = {
    name.removesuffix(".py").removesuffix("/__init__"): PACKAGE / name for name in sources.TREES
}
TREES = dict(zip(FILES, sources.TREES.values(), strict=True))
MODULES = {f"necc_casadi.{name.replace('/', '.')}": name for name in FILES if name != "__init__"}


def _type_checking(node) -> bool:
    return isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"


def imported(tree) -> set[str]:
    """Names of imported modules, within functions too, without those for the type checker alone."""
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
        todo += ast.iter_child_nodes(node)
    return found


@cache
def inside(name) -> set[str]:
    """Files of the package that a file imports."""
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


def check_order(order, names, part) -> None:
    """`part` is where in a file's name its folder stands."""
    rank = {folder: level for level, line in enumerate(order) for folder in line}
    for name in names:
        home = name.split("/")[part]
        for other in inside(name):
            parts = other.split("/")
            if len(parts) > part and other in names and parts[part] != home:
                assert rank[parts[part]] < rank[home], f"{name} imports {other}"


def test_the_order_of_the_house():
    listed = {folder for line in ORDER for folder in line}
    assert {name.split("/")[0] for name in FILES} - {"__init__"} == listed
    check_order(ORDER, set(FILES) - {"__init__"}, 0)


def test_the_order_within_the_certificate():
    names = {name for name in FILES if name.startswith("certificate/")}
    assert {name.split("/")[1] for name in names} == {"claims", "prover", "checker"}
    check_order(CERTIFICATE_ORDER, names, 1)


def test_data_flows_one_way():
    """No file reaches itself through its imports."""
    for name in FILES:
        assert name not in everything_below(name), name


def test_at_most_eight_files_at_the_top():
    top = {name for name in FILES if "/" not in name and "__" not in FILES[name].stem}
    assert len(top) <= 7


def test_errors_and_outcomes_rest_on_nothing():
    assert inside("errors") == inside("cases") == set()
    assert inside("designs/outcome") == {"cases"}
    assert foreign("errors") <= {"__future__"}


def test_sympy_ends_where_casadi_begins():
    for name in FILES:
        both = {"sympy", "casadi"} <= foreign(name)
        assert both == (name in BOTH), name
        if name.split("/")[0] in SYMBOLIC:
            assert "casadi" not in foreign(name), name


def test_a_design_rests_on_values_only():
    """Simulating, exporting or certifying a saved design loads no search and no solver."""
    makers = {"casimirs/find", "casimirs/ansatz", "casimirs/involution", "verdict/judge"}
    for name in ("designs/design", "simulation/responses", "export/c_project", "cli/simulate"):
        below = everything_below(name)
        assert not below & makers, name
        assert not {other for other in below if other.startswith("synthesis/")}, name


#: What the checker may share with the prover: data and words, and symbolic algebra.
TRUSTED = {"errors", "arrays", "files", "texts", "symbolic", "certificate/claims"}


def test_the_checker_rests_on_the_trusted_base_alone():
    for name in FILES:
        if name.startswith("certificate/checker/"):
            for other in everything_below(name) - {"certificate"}:
                folder = other.split("/")[0]
                home = "/".join(other.split("/")[:2]) if folder == "certificate" else folder
                assert home in TRUSTED | {"certificate/checker"}, f"{name} reaches {other}"


def test_running_the_checker_loads_no_prover_and_no_casadi(tmp_path, default_design):
    """In a fresh process, by what is in sys.modules after a whole check."""
    from necc_casadi.certificate.prover.certify import certify

    default_design.save(tmp_path / "design.json")
    text = certify(default_design).to_json()
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    code = f"""
import sys
from pathlib import Path
from necc_casadi.certificate.checker.check import check
results = check(Path({str(tmp_path)!r}))
print(all(result.holds for result in results))
print("\\n".join(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    held, *loaded = done.stdout.splitlines()
    assert held == "True"
    assert "flint" in loaded
    assert not {"casadi", "matplotlib", "scipy"} & set(loaded)
    ours = {name for name in loaded if name.startswith("necc_casadi.")}
    for name in ours:
        assert not name.startswith("necc_casadi.certificate.prover"), name
        assert name.split(".")[1] in {
            "errors",
            "arrays",
            "files",
            "texts",
            "symbolic",
            "certificate",
        }, name


def test_only_the_shell_knows_click_prints_or_exits():
    for name in {name for name in FILES if not name.startswith("cli")}:
        assert not foreign(name) & {"click", "rich"}, name
        for node in ast.walk(TREES[name]):
            call = node.func if isinstance(node, ast.Call) else None
            assert getattr(call, "id", "") not in ("print", "exit", "input"), name


def test_habits_of_the_house():
    """No assert, eval or bare except; exec only for the user's model; no proof rests on scipy."""
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            assert not isinstance(node, ast.Assert), name
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, name
            if isinstance(node, ast.Call):
                called = getattr(node.func, "id", "")
                assert called != "eval", name
                assert called != "exec" or name == "model/model_file"
        assert not foreign(name) & {"pickle", "shelve", "marshal", "torch"}, name
        assert "scipy" not in foreign(name) or not name.startswith("certificate"), name


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
    "Result", "RunOptions", "Trajectory", "Verdict", "__version__", "certify", "choose", "design",
    "export_c", "find_casimirs", "interconnect", "judge", "load_model", "make_controller",
    "make_model", "make_plant", "paper_options",
    "parse_target", "read_urdf", "run", "simulate",
]  # fmt: skip


def test_the_public_names_are_pinned_and_documented():
    assert sorted(necc_casadi.__all__) == PUBLIC
    assert set(dir(necc_casadi)) >= set(PUBLIC)
    for name in set(PUBLIC) - {"__version__"}:
        assert getattr(necc_casadi, name).__doc__, name
    with pytest.raises(AttributeError, match="no_such_name"):
        necc_casadi.no_such_name


def test_public_names_stand_for_the_same_objects_in_tools_that_do_not_run_the_code():
    (block,) = [node for node in TREES["__init__"].body if _type_checking(node)]
    named = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert named == {name: f"necc_casadi.{home}" for name, home in necc_casadi._HOME.items()}


def test_importing_every_module_leaves_the_public_names_alone():
    """A folder with the name of a public function would replace it."""
    from importlib import import_module

    for module in MODULES:
        import_module(module)
    assert callable(necc_casadi.design)
    assert not {line for names in ORDER for line in names} & set(necc_casadi._HOME)


def test_every_name_that_a_file_offers_exists():
    from importlib import import_module

    for module in MODULES:
        offered = import_module(module)
        for name in getattr(offered, "__all__", ()):
            assert hasattr(offered, name), f"{module}.{name}"


HEAVY = ("sympy", "casadi", "numpy", "matplotlib", "flint", "scipy")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["--nonsense"]])
@pytest.mark.parametrize("command", ["design", "simulate", "certify", "montecarlo", "sweep"])
def test_help_imports_no_heavy_package(command, arguments):
    code = (
        f"import sys; from necc_casadi.cli.{command} import _{command}; "
        f"from necc_casadi.cli.terminal import run; run(_{command}, {arguments!r}); "
        f"sys.exit(len([m for m in {HEAVY!r} if m in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_importing_the_package_is_light():
    code = f"import sys, necc_casadi; sys.exit(any(m in sys.modules for m in {HEAVY!r}))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_verdict_loads_nothing_that_designs_need(tmp_path):
    """``--check`` answers at once: no CasADi, no prover, no figures."""
    code = (
        "import sys; from necc_casadi.cli.design import _design; "
        "from necc_casadi.cli.terminal import run; "
        "code = run(_design, sys.argv[1:]); "
        "print(*sys.modules, file=sys.stderr); sys.exit(code)"
    )
    arguments = [str(PACKAGE.parent / "examples" / "pendulum.py"), "--target", "pi/4", "--check"]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    loaded = set(done.stderr.split())
    assert "sympy" in loaded
    assert not loaded & {"casadi", "matplotlib", "scipy", "clarabel", "numpy.ma"}
    ours = {name.split(".")[1] for name in loaded if name.startswith("necc_casadi.")}
    assert not ours & {"lyapunov", "designs", "simulation", "certificate", "export", "performance"}
