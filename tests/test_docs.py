"""The documents say what the program does: labels, codes, options, JSON, formats, examples."""

import ast
import doctest
import importlib
import inspect
import json
import re
import shlex
import sys
from pathlib import Path
from typing import get_args

import click
import jsonschema
import pytest
from helpers.sources import PACKAGE, TREES

import necc_casadi
from necc_casadi.certificate.claims import regions
from necc_casadi.certificate.claims.claim import CERTIFICATE_FORMAT
from necc_casadi.certificate.claims.curved import CurvedRegion, Faces
from necc_casadi.certificate.claims.motions import Follows, Solutions, Step
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.cli.design import _design
from necc_casadi.cli.montecarlo import _montecarlo
from necc_casadi.cli.simulate import _simulate
from necc_casadi.cli.sweep import _sweep
from necc_casadi.cli.terminal import run
from necc_casadi.designs.layout import DESIGN_FORMAT

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = {
    path: path.read_text("utf-8")
    for path in (*sorted(DOCS.glob("*.md")), ROOT / "README.md", ROOT / "benchmarks" / "README.md")
}
CONTRACT = PAGES[DOCS / "contract.md"]
#: The model file of the README, which the documents call the pendulum.
PENDULUM = PAGES[ROOT / "README.md"].split("```python\n")[1].split("```")[0]
#: The arm in URDF of the page on mechanical plants.
URDF = PAGES[DOCS / "how-to-mechanical.md"].split("```xml\n")[1].split("```")[0]


def section(page: str, title: str) -> str:
    """The text under a heading, up to the next one of its level or above."""
    level, start = next(
        (len(m[1]), m.end())
        for m in re.finditer(r"^(#+) (.*)$", page, re.MULTILINE)
        if m[2] == title
    )
    rest = page[start:]
    end = re.search(rf"^#{{1,{level}}} ", rest, re.MULTILINE)
    return rest[: end.start()] if end else rest


def rows(text: str) -> list[list[str]]:
    """Cells of the body rows of every table in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    marks = [i for i, line in enumerate(lines) if re.fullmatch(r"[|\s:-]+", line)]
    heads = {i - 1 for i in marks}
    return [
        [cell.strip().replace(r"\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        for i, line in enumerate(lines)
        if i not in heads and i not in marks
    ]


def words(cell: str) -> list[str]:
    """What stands in backticks."""
    return re.findall(r"`([^`]+)`", cell)


def docstrings(tree: ast.AST) -> str:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    found = [ast.get_docstring(node) for node in ast.walk(tree) if isinstance(node, kinds)]
    return "\n\n".join(text for text in found if text)


def anchors(page: str) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", page, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


# --- the paper -----------------------------------------------------------------------------------

#: Labels of the paper's source that say something which a program can do.
LABELS = {
    "eq. Plant", "eq. CasimirCondition", "eq. Controller", "eq. PlantControllerInterconnection",
    "eq. ClosedLoopSystem", "eq. LocalMinimumCondition", "Lemma EnergyCasimirControl",
    "eq. NonParameterizedCostMinimization", "eq. casimir_parameterization",
    "eq. CasimirConditionFunctionCase", "eq. Loss", "eq. FinalTrainLoss", "eq. ErrorUpperBound",
}  # fmt: skip


def test_every_equation_of_the_paper_has_a_home_that_says_so():
    page = PAGES[DOCS / "paper.md"].split("\n## ")[0]
    table = {label: words(home)[0] for label, _, home in rows(page)}
    assert set(table) == LABELS
    for label, home in table.items():
        assert re.search(rf"{re.escape(label)}(?!\w)", docstrings(TREES[home])), (label, home)


# --- the contract --------------------------------------------------------------------------------


def code_positions() -> dict[str, set[str]]:
    """Callable -> names of its parameters that take a code word; errors by their class."""
    errors = {
        node.name
        for node in TREES["errors.py"].body
        if isinstance(node, ast.ClassDef) and node.name != "NeccError"
    }
    found = {name: ["code"] for name in errors}
    for tree in TREES.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name != "__init__":
                names = [a.arg for a in (*node.args.args, *node.args.kwonlyargs)]
                if any(name.startswith("code") for name in names):
                    found[node.name] = names
    return found


def codes_in_the_package() -> tuple[set[str], set[str]]:
    """Code words that reach an error, and patterns of those that are put together."""
    takes, plain, patterns = code_positions(), set(), set()
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name in takes:
                given = node.args.args[len(node.args.args) - len(node.args.defaults) :]
                pairs = zip(given, node.args.defaults, strict=True)
                values = [v for a, v in pairs if a.arg.startswith("code")]
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in takes:
                parameters = takes[node.func.id]
                values = [
                    v for a, v in zip(parameters, node.args, strict=False) if a.startswith("code")
                ] + [k.value for k in node.keywords if (k.arg or "").startswith("code")]
            else:
                continue
            for value in values:
                match value:
                    case ast.Constant(value=str(word)):
                        plain.add(word)
                    case ast.JoinedStr(values=parts):
                        fixed = (p.value if isinstance(p, ast.Constant) else r"\w+" for p in parts)
                        patterns.add("".join(fixed))
                    case ast.Name(id=passed) | ast.Attribute(attr=passed):
                        assert passed.startswith("code"), (name, ast.unparse(value))
                    case _:
                        pytest.fail(f"{name}: no code word can be told from {ast.unparse(value)}")
    return plain, patterns


ERRORS = rows(section(CONTRACT, "Errors"))


def test_the_contract_lists_every_error_code():
    documented = [words(row[0])[0] for row in ERRORS]
    assert len(set(documented)) == len(documented)
    plain, patterns = codes_in_the_package()
    assert plain == set(documented)
    for pattern in patterns:
        assert any(re.fullmatch(pattern, code) for code in plain), pattern


@pytest.mark.parametrize("row", [r for r in ERRORS if r[2] != "–"], ids=lambda row: row[0])
def test_bad_input_is_answered_as_the_contract_shows(row, tmp_path, monkeypatch, capsys):
    code, _, provoked, message, remedy = row
    (cause,) = words(provoked)
    options = shlex.split(cause) if cause.startswith("--") else []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["necc-design"])
    Path("own.py").write_text(PENDULUM + ("" if options else cause) + "\n", encoding="utf-8")
    target = [] if "--target" in options else ["--target", "q=pi/4"]
    assert run(_design, ["own.py", *target, *options, "--json"]) == 2
    shown = capsys.readouterr()
    assert shown.err.splitlines() == [f"error [{words(code)[0]}]: {message}", f"  {remedy}"]
    expected = {"code": words(code)[0], "message": f"{message} {remedy}"}
    assert json.loads(shown.out) == {"status": "error", "error": expected}


@pytest.mark.parametrize(
    ("problem", "code", "status"),
    [(RuntimeError("…"), "internal", 1), (KeyboardInterrupt(), "interrupted", 130)],
)
def test_faults_and_interrupts_are_answered_as_the_contract_shows(problem, code, status, capsys):
    @click.command()
    @click.option("--json", is_flag=True)
    def stops(json):
        raise problem

    row = next(row for row in ERRORS if row[0] == f"`{code}`")
    assert run(stops, ["--json"]) == status
    answer = json.loads(capsys.readouterr().out)["error"]
    assert answer["code"] == code
    assert answer["message"].startswith(row[3].removesuffix("…"))
    assert f"exit code {status}" in row[1]


def test_the_contract_names_every_exit_code():
    named = {int(row[0]) for row in rows(section(CONTRACT, "Exit codes"))}
    assert named == {0, 1, 2, 3, 4, 130}
    for code in named - {1}:
        assert f"\n  {code}  " in inspect.cleandoc(_design.help).replace("\b", "") or code == 130


def test_the_contract_names_every_option_of_every_command():
    text = section(CONTRACT, "Options")
    named = set(re.findall(r"--[a-z][a-z0-9-]*", text))
    commands = (_design, _certify, _simulate, _montecarlo, _sweep)
    real = {name for command in commands for p in command.params for name in p.opts}
    assert named == {name for name in real if name.startswith("--")} | {"--help"}
    for command in commands:
        part = text.split(f"`{command.name} ")[1].split("\n\n`necc-")[0]
        for parameter in command.params:
            for name in parameter.opts:
                assert not name.startswith("--") or name in part or name == "--version", name


def paths(schema: dict, prefix: str = "") -> set[str]:
    """Dotted names of everything that a schema describes; [] for entries of a list of objects."""
    found = set()
    for key, value in schema.get("properties", {}).items():
        found |= {prefix + key} | paths(value, f"{prefix}{key}.")
    if isinstance(schema.get("additionalProperties"), dict):
        found.add(prefix + "<>")
    if "items" in schema:
        found |= paths(schema["items"], f"{prefix.removesuffix('.')}[].")
    return found


SCHEMA = json.loads((DOCS / "schema" / "design-run.schema.json").read_text("utf-8"))


def test_the_schema_is_strict():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    todo = list(SCHEMA["$defs"].values())
    while todo:
        part = todo.pop()
        if "properties" in part:
            assert part["additionalProperties"] is False
            assert part["required"] == list(part["properties"])
            todo += part["properties"].values()
        todo += [part["items"]] if "items" in part else []


def test_the_contract_explains_every_key_of_the_json():
    explained = {words(row[0])[0] for row in rows(section(CONTRACT, "JSON"))}
    plain = {re.sub(r"<\w+>", "<>", key) for key in explained}
    described = paths(SCHEMA["$defs"]["result"])
    headings = {key for key in described if any(k.startswith(f"{key}.") for k in described)}
    assert plain <= described
    assert described - plain <= headings


RUNS = {
    "certified": (
        0,
        "q=pi/4",
        [
            "--sweep-a",
            "0.3:0.5:2",
            "--sample-time",
            "0.01",
            "--no-plots",
            "--rate",
            "0.3",
            "--compare",
        ],
    ),
    "assignable": (0, "q=pi/4", ["--check"]),
    "refused": (3, "0,1", []),
    "error": (2, "z=1", []),
}


@pytest.mark.parametrize(
    "status", [pytest.param(s, marks=[pytest.mark.slow] * (s == "certified")) for s in RUNS]
)
def test_what_a_run_prints_fits_the_schema(status, tmp_path, monkeypatch, capsys):
    code, target, options = RUNS[status]
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(PENDULUM, encoding="utf-8")
    assert run(_design, ["own.py", "--target", target, "--json", *options]) == code
    answer = json.loads(capsys.readouterr().out)
    jsonschema.validate(answer, SCHEMA)
    assert answer["status"] == status
    for name in answer.get("files", ()):
        assert (tmp_path / "own-design" / name).is_file()
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**answer, "more": 1}, SCHEMA)


# --- the formats ---------------------------------------------------------------------------------

FORMATS = PAGES[DOCS / "certificate-format.md"]


def keys(value: object) -> set[str]:
    """Names of all entries of a JSON value."""
    if isinstance(value, dict):
        return set(value) | {key for part in value.values() for key in keys(part)}
    if isinstance(value, list):
        return {key for part in value for key in keys(part)}
    return set()


def test_every_entry_of_a_design_is_explained(designs):
    text = section(FORMATS, "design.json")
    assert f"Format {DESIGN_FORMAT}." in text
    named = {part for word in words(text) for part in word.split(".")}
    for made in designs.values():
        data = json.loads(made.text)
        data |= {"versions": None}
        data["model"] |= {"units": None, "domain": None}
        assert keys(data) <= named


def test_every_entry_of_a_certificate_is_explained(default_design):
    text = section(FORMATS, "certificate.json")
    assert f"Format {CERTIFICATE_FORMAT}." in text
    named = set(words(text))
    data = json.loads(certify(default_design).to_json())
    entries = keys(data) - set(default_design.loop.states)
    assert entries <= named
    claims = {words(row[0])[0] for row in rows(text) if len(row) == 3}
    assert {claim["name"] for claim in data["claims"]} <= claims
    for kind in (regions.Region, regions.GlobalClaim, regions.Obstacle, regions.CellBox,
                 CurvedRegion, Faces, Solutions, Step):  # fmt: skip
        assert set(kind.__dataclass_fields__) - {"state"} <= named, kind
    for title, kind in (("Regions", regions.Region), ("Curved regions", CurvedRegion)):
        entries = {word for row in rows(section(FORMATS, title)) for word in words(row[0])}
        assert entries == set(kind.__dataclass_fields__)
    assert set(get_args(regions.ObstacleKind)) | set(get_args(Follows)) <= named


def imported_from_here(tree: ast.AST) -> set[str]:
    """Files of the package that a file imports."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("necc_casadi"):
            base = "/".join((node.module or "").split(".")[1:])
            found |= {f"{base}.py", *[f"{base}/{alias.name}.py" for alias in node.names]}
    return found & set(TREES)


def test_the_trusted_base_is_listed_file_by_file():
    todo = [name for name in TREES if name.startswith("certificate/checker/")]
    reached = set(todo)
    while todo:
        for other in imported_from_here(TREES[todo.pop()]) - reached:
            reached.add(other)
            todo.append(other)
    shared = {name for name in reached if not name.startswith("certificate/checker/")}
    part = rows(section(FORMATS, "What the checker trusts"))
    listed = {name for row in part for name in words(row[0])}
    assert shared <= listed
    assert listed <= set(TREES)


# --- links and references ------------------------------------------------------------------------


def test_documents_that_the_package_names_exist_with_their_sections():
    for name, tree in TREES.items():
        source = ast.unparse(tree)
        for page, anchor in re.findall(r"docs/([\w-]+\.md)(?:#([\w-]+))?", source):
            assert DOCS / page in PAGES, (name, page)
            assert not anchor or anchor in anchors(PAGES[DOCS / page]), (name, page, anchor)


def test_no_docstring_appeals_to_a_document_without_naming_it():
    for name, tree in TREES.items():
        text = (PACKAGE / name).read_text("utf-8")
        assert not re.search(r"the contract|[Cc]ontract('s)? word|\(theory", text), name
        assert "the contract" not in docstrings(tree), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", PAGES[page]):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), target
        if anchor:
            assert anchor in anchors(path.read_text("utf-8")), target


def test_the_site_leads_to_every_page_and_the_readme_to_what_a_user_needs():
    trees = re.findall(r"```{toctree}\n(.*?)```", PAGES[DOCS / "index.md"], re.DOTALL)
    index = {line for tree in trees for line in tree.splitlines()}
    for page in (*DOCS.glob("*.md"), *DOCS.glob("*.ipynb")):
        assert page.stem in index | {"index"}, page.name
    readme = PAGES[ROOT / "README.md"]
    for name in ("start", "limits", "glossary", "faq", "contract", "theory", "python", "gallery"):
        assert f"](docs/{name}.md)" in readme, name
    assert "](benchmarks/README.md)" in readme
    assert len(readme.splitlines()) < 70


def test_every_benchmark_is_explained():
    text = PAGES[ROOT / "benchmarks" / "README.md"]
    for script in (ROOT / "benchmarks").glob("*.py"):
        assert f"`{script.name}`" in text or f"`{script.name}`]" in text, script.name


def test_every_reference_of_a_docstring_stands_in_the_bibliography():
    """A surname and a year: both in one entry."""
    entries = PAGES[DOCS / "bibliography.md"].split("\n* ")[1:]
    cited = 0
    for name, tree in TREES.items():
        for text in re.findall(r"References\n-+\n(.*?)(?:\n\n|\Z)", docstrings(tree), re.DOTALL):
            for authors, year in re.findall(r"([^.;()]+) \((\d{4})\)", text):
                cited += 1
                surnames = re.findall(r"[^\W\d_]{4,}", authors.strip())
                capital = [s for s in surnames if s[0].isupper()]
                assert capital, (name, text)
                assert any(f"({year})" in e and all(s in e for s in capital) for e in entries), (
                    name,
                    authors,
                    year,
                )
    assert cited > 5


# --- public names --------------------------------------------------------------------------------

PUBLIC = [name for name in necc_casadi.__all__ if name != "__version__"]


@pytest.mark.parametrize("name", PUBLIC)
def test_examples_of_public_names_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("pendulum.py").write_text(PENDULUM, encoding="utf-8")
    Path("arm.urdf").write_text(URDF, encoding="utf-8")
    home = importlib.import_module(f"necc_casadi.{necc_casadi._HOME[name]}")
    found = doctest.DocTestFinder(recurse=False).find(getattr(home, name), name, home, globs={})
    (example,) = found
    assert example.examples
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    failed, _ = runner.run(example, out=report.append)
    assert not failed, "".join(report)


@pytest.mark.parametrize("name", PUBLIC)
def test_public_functions_explain_what_they_take_and_give(name):
    thing = getattr(necc_casadi, name)
    text = inspect.getdoc(thing) or ""
    assert "Examples\n--------" in text
    if inspect.isclass(thing):
        return
    assert "Returns\n-------" in text
    parameters = section_of(text, "Parameters")
    for parameter in inspect.signature(thing).parameters:
        assert re.search(rf"^(\w+, )*{parameter}(,| *$)", parameters, re.MULTILINE), parameter


def section_of(text: str, title: str) -> str:
    """A section of a NumPy docstring."""
    found = re.search(rf"{title}\n-+\n(.*?)(?=\n\n\w[\w ]*\n---|\Z)", text, re.DOTALL)
    assert found, title
    return found[1]
