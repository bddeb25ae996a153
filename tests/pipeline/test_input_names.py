"""Inputs that the model names, wherever they are shown; and claims about them, proved again."""

import re
import zipfile

import pytest

from necc_casadi.certificate.checker.check import check
from necc_casadi.designs.design import Design
from necc_casadi.designs.layout import to_dict
from necc_casadi.pipeline.call import run
from necc_casadi.report.named_axes import named_input
from necc_casadi.report.responses_figure import shown_over_time

MODEL = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / 2 + 1 - sp.cos(q)
target = {q: 0.5}
inputs = ("torque",)
units = {q: "rad", "torque": "N m"}
sizes = {"torque": 2}
disturbance = [(-0.01, 0.01)]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("named")
    (folder / "own.py").write_text(MODEL, encoding="utf-8")
    result = run(folder / "own.py", out=folder / "out", fmu=True)
    return result, folder / "out"


def test_sizes_figures_and_texts(made):
    result, out = made
    design = result.design
    assert design.named_sizes["torque"] == 2
    assert result.to_dict()["sizes"]["torque"] == 2
    assert "torque" in shown_over_time(design, result.responses)
    assert named_input(design, 0) == ("torque", "N m")
    assert "torque" in (out / "report.html").read_text(encoding="utf-8")


def test_c_code_and_the_fmi_unit(made):
    _, out = made
    assert re.search(r"u\[0\] +torque \[N m\]", (out / "c/necc.h").read_text(encoding="utf-8"))
    assert "`u` = (torque [N m])" in (out / "c/README.md").read_text(encoding="utf-8")
    with zipfile.ZipFile(next(out.rglob("*.fmu"))) as unit:
        description = unit.read("modelDescription.xml").decode()
    variable = description.split('name="torque"')[1].split("</ScalarVariable>")[0]
    assert 'causality="output"' in variable
    assert 'unit="N m"' in variable
    assert '<Unit name="N m"' in description


def test_what_is_saved_is_loaded_and_proved_again(made):
    result, out = made
    assert Design.load(out / "design.json").loop.plant.input_names == ("torque",)
    assert '"d_torque"' in (out / "family.json").read_text(encoding="utf-8")
    assert all(claim.holds for claim in check(out))
    held = next(response for response in result.responses)
    assert held.csv(["q", "p", "xi1"], result.design.loop.plant.inputs).startswith(
        "t,q,p,xi1,torque,V\n"
    )


def test_a_design_without_names_is_written_as_before(default_design):
    assert "inputs" not in to_dict(default_design)["model"]
    assert default_design.loop.plant.input_names == ("u",)
