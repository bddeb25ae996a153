"""Commands and code of the README and of the pages that a new user reads, run as they stand."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from necc_casadi.model.model_file import load_model

ROOT = Path(__file__).parent.parent
BIN = Path(sys.executable).parent


def blocks(language: str, page: str = "README.md") -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return [text for name, text in fenced if name == language]


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    name, *arguments = shlex.split(command)
    arguments = [str(ROOT / a) if a.startswith("examples/") else a for a in arguments]
    return subprocess.run(
        [BIN / name, *arguments], cwd=folder, capture_output=True, text=True, timeout=120
    )


def labels(lines: list[str]) -> set[str]:
    """First words of the rows of a summary; continuation lines are indented further."""
    return {line.split()[0] for line in lines if re.match(r"  \S", line)}


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The main command of the README, run in an empty folder."""
    folder = tmp_path_factory.mktemp("readme")
    install, _, command = blocks("bash")[0].strip().partition(" && ")
    assert install == "python -m pip install ."
    return folder, run(command, folder)


def test_main_command_shows_what_the_readme_shows(designed):
    folder, done = designed
    assert done.returncode == 0, done.stderr
    for page in ("README.md", "docs/start.md"):
        shown = next(b for b in blocks("", page) if b.startswith("Pendulum")).splitlines()
        assert done.stdout.splitlines()[0] == shown[0]
        assert labels(shown) <= labels(done.stdout.splitlines())
    for name in ("design.json", "certificate.json", "c/necc.c", "figures/lyapunov.png"):
        assert (folder / "pendulum-design" / name).is_file()


def test_other_commands_of_the_readme(designed):
    folder, _ = designed
    assert run("necc-simulate pendulum-design --x0 0,0 --csv r.csv", folder).returncode == 0
    assert (folder / "r.csv").read_text().startswith("t,q,p,xi1,u1,V")
    certified = run("necc-certify pendulum-design", folder)
    assert certified.returncode == 0, certified.stdout + certified.stderr
    limits = blocks("", "docs/limits.md")
    upright = next(b for b in limits if b.startswith("necc-design examples/cart_pole"))
    command = upright.strip().splitlines()[0]
    held = run(f"{command} --check", folder)
    assert held.returncode == 0
    assert "method      mechanical: holds the target" in held.stdout
    refused = run(f"{command} --check --method interconnection", folder)
    assert refused.returncode == 3
    assert "invisible_negative_curvature: theta" in refused.stdout
    command, shown = (b for b in limits if "parallel_rlc" in b or b.startswith("Parallel"))
    obstacle = run(command, folder)
    assert obstacle.returncode == 3
    assert obstacle.stdout.split() == shown.split()


def test_model_and_python_code_of_the_readme(designed, monkeypatch):
    folder, _ = designed
    (model,) = blocks("python")
    assert model in blocks("python", "docs/start.md")
    arm, _ = blocks("python", "docs/how-to-mechanical.md")
    usage, notebook = blocks("python", "docs/python.md")
    (folder / "own.py").write_text(model)
    done = run("necc-design own.py --target q=pi/4 --check", folder)
    assert done.returncode == 0, done.stderr
    (folder / "arm.py").write_text(arm)
    done = run("necc-design arm.py --target q1=pi/4,q2=-pi/3 --check", folder)
    assert done.returncode == 0, done.stderr
    monkeypatch.chdir(folder)
    space: dict[str, object] = {}
    exec(usage, space)
    assert space["A"].shape == (3, 3)
    exec(notebook, space)
    assert space["result"].status == "certified"


def test_every_picture_is_there_and_shown():
    shown = set()
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        pictures = {page.parent / name for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)}
        assert not [str(path) for path in pictures if not path.is_file()]
        shown |= pictures
    assert shown == set((ROOT / "docs" / "images").glob("*.png"))


def test_the_gallery_says_of_every_example_whether_it_is_global():
    """One row per target; a reason wherever the answer is no."""
    text = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| [")]
    for example in (ROOT / "examples").glob("*.py"):
        name = load_model(example).system.name
        own = [row for row in rows if row[0].strip().startswith(f"[{name}]")]
        assert own, name
        for row in own:
            answer = row[-1].strip()
            refused = row[2].strip().startswith("refused")
            assert answer == "–" if refused else re.match(r"\*\*yes\*\*|no: \w", answer), row
    anchors = {
        line[3:].lower().replace(" ", "-") for line in text.splitlines() if line[:3] == "## "
    }
    assert {row[0].split("(#")[1].strip(" )") for row in rows} == anchors


def test_ci_runs_the_test_command_of_the_readme():
    command = blocks("bash")[-1].strip()
    script = (ROOT / ".ci" / "run").read_text()
    install, test = (part.strip() for part in command.split("&&"))
    assert test in script
    assert install in script
