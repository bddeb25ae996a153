"""The documentation site: what its pages promise is there, and what they show works."""

import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from necc_casadi import run
from necc_casadi.export.c_project import export_c
from necc_casadi.export.fmu import export_fmu
from necc_casadi.model.model_file import load_model

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def blocks(name: str, language: str) -> list[str]:
    """Code blocks of a page."""
    fenced = re.findall(r"^```([{}\w]*)\n(.*?)^```$", page(name), re.DOTALL | re.MULTILINE)
    return [text for found, text in fenced if found == language]


# --- the glossary --------------------------------------------------------------------------------


def letters(text: str) -> set[str]:
    """Words without regard to capitals; Greek letters count, exponents of numbers do not."""
    return {word.lower() for word in re.findall(r"[^\W\d]\w*̄?", re.sub(r"\de-?\d", "", text))}


#: English that a summary puts between its words.
PLAIN = letters("""a add all and are as at best class every exist far for found from in is its large
    of off or random s than that the they to were where with within""")


def test_the_glossary_explains_every_word_of_the_summary(tmp_path):
    """Those of the plant, and plain English, aside: of a design with and one without notes."""
    model = load_model(ROOT / "examples" / "pendulum.py")
    own = {"pendulum", "pi", "rad", "kg", "m²", "json", "html", "report", "c", "v", "u"}
    own |= {word.lower() for word in (*model.system.states, "xi1", "written")}
    result = run(model, "pi/4", out=tmp_path / "out")
    text = result.summary()
    assert len(text.splitlines()) < 25
    terms = {
        line for block in blocks("glossary.md", "{glossary}") for line in block.splitlines()
        if line and not line.startswith(" ")
    }  # fmt: skip
    known = letters(" ".join(terms))
    plural = {f"{word}s" for word in known} | {word.removesuffix("s") for word in known}
    missing = letters(text) - known - plural - PLAIN - own
    assert not missing


# --- the FAQ -------------------------------------------------------------------------------------


def contract_rows() -> list[list[str]]:
    part = page("contract.md").split("\n## Errors")[1].split("\n## ")[0]
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in part.splitlines() if "|" in line]
    return [[cell.strip().replace(r"\|", "|") for cell in row] for row in rows if len(row) == 5][2:]


@pytest.mark.parametrize("row", contract_rows(), ids=lambda row: row[0].strip("`"))
def test_the_faq_has_every_code_with_an_example_and_what_to_do(row):
    """The contract's examples are run by tests/test_docs.py: these are the same."""
    code, _, provoked, message, remedy = row
    entry = page("faq.md").split(f"\n## {code}\n")[1].split("\n## ")[0]
    shown = re.findall(r"^```\w*\n(.*?)\n^```$", entry, re.DOTALL | re.MULTILINE)
    answer = f"error [{code.strip('`')}]: {message}\n  {remedy}"
    if provoked == "–":
        assert shown == [answer]
    else:
        example, said = shown
        assert example.endswith(provoked.strip("`"))
        assert said == answer
    advice = entry.split("```")[-1].strip()
    assert len(advice.split()) > 4, "nothing says what to do"


def test_the_faq_has_no_code_that_the_contract_lacks():
    shown = re.findall(r"^## (`\w+`)$", page("faq.md"), re.MULTILINE)
    assert shown == [row[0] for row in contract_rows()]


# --- code on the pages ---------------------------------------------------------------------------


def test_the_model_of_the_data_sheet_is_that_of_the_example(tmp_path):
    (text,) = blocks("how-to-data-sheet.md", "python")
    (tmp_path / "joint.py").write_text(text, encoding="utf-8")
    own, example = load_model(tmp_path / "joint.py"), load_model(ROOT / "examples/robot_joint.py")
    changed = dict(zip(own.system.x, example.system.x, strict=True))
    assert (own.system.H.xreplace(changed) - example.system.H).simplify() == 0
    assert own.system.R.xreplace(changed) == example.system.R
    assert own.system.u_limits == example.system.u_limits
    assert run(own, check=True).status == "assignable"


def test_the_arm_in_urdf_is_a_model_and_one_that_a_model_file_may_read(tmp_path):
    (text,), (_, own) = (
        blocks("how-to-mechanical.md", "xml"),
        blocks("how-to-mechanical.md", "python"),
    )
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    (tmp_path / "own.py").write_text(own, encoding="utf-8")
    alone, model = load_model(tmp_path / "arm.urdf"), load_model(tmp_path / "own.py")
    assert model.system.H == alone.system.H
    assert list(model.ranges.uncertain) == ["m_lower"]
    assert run(tmp_path / "arm.urdf", "shoulder=0.5,elbow=1", check=True).status == "assignable"


def test_commands_on_the_pages_have_options_that_exist():
    """Every line that begins with a command of ours is parsed by it, and run no further."""
    from click import Command

    from necc_casadi.cli.commands import COMMANDS, every_command

    seen = set()
    for path in (*DOCS.glob("*.md"), ROOT / "README.md"):
        if path.name == "faq.md":  # its commands are mistakes
            continue
        for line in re.findall(r"^(necc-.*|.* && necc-.*)$", path.read_text("utf-8"), re.MULTILINE):
            name, *arguments = shlex.split(line.split(" && ")[-1].rstrip("`"))
            command = every_command.get_command(None, name.removeprefix("necc-"))
            assert isinstance(command, Command), line
            command.make_context(name, arguments)
            seen.add(name)
    assert seen == {f"necc-{name}" for name in COMMANDS}


@pytest.mark.slow
def test_the_code_of_the_tuning_page_runs(tmp_path, monkeypatch):
    (text,) = blocks("how-to-tuning.md", "python")
    monkeypatch.chdir(tmp_path)
    Path("pendulum.py").write_text(blocks("start.md", "python")[0], encoding="utf-8")
    space: dict = {}
    exec(text, space)
    assert space["fast"].design.abscissa < space["soft"].design.abscissa < 0


def test_the_code_of_the_fmu_page_runs(default_design, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot_joint-design").mkdir()
    export_fmu(default_design, Path("robot_joint-design/robot_joint.fmu"), sample_time=0.001)
    space: dict = {}
    exec(blocks("how-to-fmu.md", "python")[0], space)
    assert np.isfinite(space["result"]["u1"]).all()
    assert space["result"]["flags"].max() == 0


#: As much of ROS 2 as the node of the page uses, in one file for all its headers.
ROS = """
#pragma once
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <vector>
namespace sensor_msgs::msg { struct JointState { std::vector<double> position, velocity; }; }
namespace std_msgs::msg { struct Float64MultiArray { std::vector<double> data; }; }
#define RCLCPP_WARN(logger, text) std::puts(text)
namespace rclcpp {
struct SensorDataQoS {};
template <class M> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    void publish(const M & m) { std::printf("%.17g\\n", m.data.at(0)); }
};
template <class M> struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription>;
    std::function<void(const M &)> call;
};
struct Node {
    explicit Node(const std::string &) {}
    int get_logger() { return 0; }
    template <class M> typename Publisher<M>::SharedPtr create_publisher(const char *, int)
    { return std::make_shared<Publisher<M>>(); }
    template <class M, class F>
    typename Subscription<M>::SharedPtr create_subscription(const char *, SensorDataQoS, F call)
    {
        auto made = std::make_shared<Subscription<M>>(Subscription<M>{call});
        spun() = [made] {
            made->call({{}, {}});
            made->call({{0.5}, {0.25}});
            made->call({{0.5}, {1.0 / 0.0}});
        };
        return made;
    }
    static std::function<void()> & spun() { static std::function<void()> f; return f; }
};
inline void init(int, char **) {}
inline void spin(std::shared_ptr<Node>) { Node::spun()(); }
inline void shutdown() {}
}
"""


def test_the_ros_node_compiles_and_publishes_what_the_controller_says(default_design, tmp_path):
    """With a stand-in for ROS 2: three messages, one without a state, one that is not finite."""
    design = default_design
    export_c(design, tmp_path, sample_time=0.001, measured=False)
    (node,) = blocks("how-to-ros2.md", "cpp")
    (tmp_path / "node.cpp").write_text(node, encoding="utf-8")
    for header in re.findall(r"#include <(\w+(?:/\w+)*\.hpp)>", node):
        (tmp_path / header).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / header).write_text(f'#include "{tmp_path}/ros.h"\n', encoding="utf-8")
    (tmp_path / "ros.h").write_text(ROS, encoding="utf-8")
    cc = ["-Wall", "-Wextra", "-Werror", f"-I{tmp_path}"]
    subprocess.run(["gcc", "-std=c99", *cc, "-c", "necc.c", "-o", "n.o"], cwd=tmp_path, check=True)
    subprocess.run(
        ["g++", "-std=c++17", *cc, "node.cpp", "n.o", "-lm", "-o", "node"], cwd=tmp_path, check=True
    )
    done = subprocess.run([tmp_path / "node"], capture_output=True, text=True, check=True)
    first, warning, stopped = done.stdout.splitlines()
    x = np.array([0.5, 1.2 * 0.25])
    u, _ = design.control(x, design.xi_at_start(x))
    assert float(first) == pytest.approx(u[0], rel=1e-9)
    assert "not finite" in warning
    assert float(stopped) == 0


def test_the_firmware_of_the_sampling_page_compiles_and_controls(default_design, tmp_path):
    export_c(default_design, tmp_path, real="float", sample_time=0.001, measured=False)
    (code,) = blocks("how-to-sampling.md", "c")
    main = """
    #include <stdio.h>
    void control(float angle, float speed, float *torque);
    int main(void) { float u; control(0.5f, 0.25f, &u); printf("%.9g", (double)u); return 0; }
    """
    (tmp_path / "control.c").write_text(code, encoding="utf-8")
    (tmp_path / "call.c").write_text(textwrap.dedent(main), encoding="utf-8")
    subprocess.run(
        ["gcc", "-std=c99", "-Wall", "-Wextra", "-Wdouble-promotion", "-Werror",
         "-Wno-missing-prototypes", "control.c", "call.c", "necc.c", "-lm", "-o", "call"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    done = subprocess.run([tmp_path / "call"], capture_output=True, text=True, check=True)
    x = np.array([0.5, 1.2 * 0.25])
    u, _ = default_design.control(x, default_design.xi_at_start(x))
    assert float(done.stdout) == pytest.approx(u[0], rel=1e-4)


def test_the_tutorial_is_kept_without_outputs():
    book = json.loads(page("tutorial.ipynb"))
    cells = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 10
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)


# --- the site as it is built ---------------------------------------------------------------------

BUILT = os.environ.get("NECC_SITE")  # CI has built it already
TOOLS = all(importlib.util.find_spec(name) for name in ("sphinx", "furo", "myst_nb"))
CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome")
                 if (found := shutil.which(name))), None)  # fmt: skip


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The folder of the site, built with warnings as errors where nobody has."""
    if BUILT:
        return Path(BUILT)
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


built = pytest.mark.skipif(
    not (BUILT or TOOLS), reason="NO SITE: install '.[docs]', nobody looked at the pages"
)


@pytest.mark.slow
@built
def test_the_tutorial_shows_a_certificate_a_refusal_and_a_cure(site):
    text = (site / "tutorial.html").read_text(encoding="utf-8")
    for shown in ("the target is assignable", "arm: certified", "filter: ", "Dissipation obstacle",
                  "refused, with proof", "shaping: holds the target"):  # fmt: skip
        assert shown in text, shown
    assert "Traceback" not in text


@pytest.mark.slow
@built
@pytest.mark.skipif(CHROMIUM is None, reason="NO BROWSER: chromium is not installed, nobody looked")
@pytest.mark.parametrize(("width", "scheme"), [(400, "light"), (1400, "dark")])
def test_every_page_fits_the_window_and_asks_nobody(site, width, scheme):
    """No request to another place, no error, nothing beside the window, formulas typeset."""
    from playwright.sync_api import sync_playwright

    pages = sorted(path for path in site.glob("*.html"))
    assert len(pages) > 20
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        window = context.new_page()
        asked, said = [], []
        window.on("request", lambda request: asked.append(request.url))
        window.on("pageerror", lambda problem: said.append(str(problem)))
        for path in pages:
            window.goto(path.as_uri())
            assert window.evaluate("document.documentElement.scrollWidth") <= width, path.name
        window.goto((site / "tutorial.html").as_uri())
        formulas = (
            "[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect().height)"
        )
        heights = window.evaluate(formulas)
        browser.close()
    assert not [url for url in asked if not url.startswith(("file:", "data:"))]
    assert not said
    assert heights
    assert min(heights) > 5
