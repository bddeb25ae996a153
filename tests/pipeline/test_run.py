"""Options of necc-design end to end: what is asked for is done, noted, and written."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import design, here
from helpers.problems import PENDULUM
from helpers.runs import EXAMPLES, SMALL, run

from necc_casadi.cli.certify import _certify
from necc_casadi.designs.design import Design
from necc_casadi.model.model_file import load_model


def test_a_beyond_the_ceiling_is_lowered_with_a_note(tmp_path):
    code, data = run(
        EXAMPLES / "two_link_arm.py", "--a", "2", "--no-plots", *SMALL, "--out", tmp_path / "o"
    )
    ceiling, made = data["verdict"]["a_max"], data["design"]
    assert 0.4 < ceiling < 0.45
    assert made["a_requested"] == 2
    assert 0.5 * ceiling < made["a"] < ceiling
    assert made["loss"] <= 1e-9
    assert made["a"] - 1e-9 <= made["hessian_min_eig"] <= ceiling + 1e-9
    (note,) = [note for note in data["notes"] if "a_max" in note]
    assert "a = 2 " in note
    assert f"a = {made['a']:.4g} is used" in note
    assert (code, data["status"]) == (0, "certified")


def test_files_of_other_tools(everything):
    code, data, out = everything
    assert (code, data["status"]) == (0, "certified")
    assert {"pendulum.fmu", "matlab/necc_control.c"} <= set(data["files"])
    with zipfile.ZipFile(out / "pendulum.fmu") as unit:
        assert unit.testzip() is None
        assert "modelDescription.xml" in unit.namelist()
    assert "mexFunction" in (out / "matlab" / "necc_control.c").read_text(encoding="utf-8")


def test_no_plots_draws_nothing(everything):
    _, data, out = everything
    assert not (out / "figures").exists()
    assert not [name for name in data["files"] if name.endswith(".png")]
    assert "figures" not in data["timings"]


def test_the_sampled_loop_is_reported(everything):
    """Spectral radius at the sample time, by the matrix exponential of Heun's neighbourhood."""
    _, data, out = everything
    sampling = data["sampling"]
    assert sampling["sample_time"] == 0.01
    made = Design.load(out)
    slowest = np.linalg.eigvals(made.lyapunov.linearisation(made.z_bar)).real.max()
    assert sampling["spectral_radius"] == pytest.approx(np.exp(0.01 * slowest), abs=5e-4)
    assert sampling["spectral_radius"] < 1
    assert sampling["largest_stable"] is None or sampling["largest_stable"] > 0.01


def test_a_sample_time_that_is_too_long_is_noted(tmp_path):
    _, data = run(
        PENDULUM, "--target", "pi/4", *SMALL, "--no-plots", "--sample-time", "3",
        "--out", tmp_path / "o",
    )  # fmt: skip
    assert data["sampling"]["spectral_radius"] > 1
    assert data["sampling"]["largest_stable"] < 3
    assert data["sampling"]["warning"] in data["notes"]


@pytest.mark.slow
def test_casimirs_are_kept_where_asked_for(tmp_path):
    """Nothing is proved of that sampled loop, and header and notes do not say otherwise."""
    out = tmp_path / "o"
    code, data = run(
        PENDULUM, "--target", "pi/4", *SMALL, "--no-plots", "--sample-time", "0.05",
        "--integrator", "casimir", "--out", out,
    )  # fmt: skip
    assert code == 0
    assert data["sampling"]["proved"] is None
    assert data["sampling"]["spectral_radius"] < 1
    header, source = ((out / "c" / name).read_text("utf-8") for name in ("necc.h", "necc.c"))
    assert "Nothing is proved of this sampled loop" in header
    assert "Proved of the sampled loop" not in header
    assert "static void arrive(" in source
    assert here(_certify, out)[0] == 0


def test_what_was_not_asked_for_is_null(tmp_path):
    code, data = run(PENDULUM, "--target", "pi/4", "--check")
    assert code == 0
    for block in ("design", "certificate", "responses", "sampling", "sweep"):
        assert data[block] is None


def test_a_mistyped_optional_name_is_noted(tmp_path):
    """Nothing reads it, so a domain or a limit would be missing without a word."""
    path = tmp_path / "plant.py"
    own = PENDULUM.read_text(encoding="utf-8")
    path.write_text(f"{own}\ndomian = {{q: (-1, 2)}}\nlength = 1\ntargets = ()\n")
    code, data = run(path, "--target", "pi/4", "--check")
    assert code == 0
    (domain,) = (note for note in data["notes"] if "domian" in note)
    assert domain.endswith("did you mean domain?")
    assert any("targets" in note and "target?" in note for note in data["notes"])
    assert not any("length" in note for note in data["notes"])
    for example in EXAMPLES.glob("*.py"):
        assert load_model(example).notes == ()


def long_chain(tmp_path) -> Path:
    text = (EXAMPLES / "mass_spring_chain.py").read_text(encoding="utf-8")
    path = tmp_path / "chain.py"
    path.write_text(text.replace("N = 4", "N = 12"), encoding="utf-8")
    return path


@pytest.mark.slow
def test_the_summary_of_a_large_plant_is_short(tmp_path):
    """A page, whatever the number of states; the JSON has them all.

    Its 24 coupled states need no search: all are minimised out.
    """
    path = long_chain(tmp_path)
    code, text, _ = design(path, "-v", "--no-plots", *SMALL, "--out", tmp_path / "o")
    assert code == 0, text
    assert "globally asymptotically stable" in text
    assert here(_certify, tmp_path / "o")[0] == 0
    assert len(text.splitlines()) <= 55
    assert max(map(len, text.splitlines())) <= 110
    assert "zeros not listed" in text
    assert "p5 =" not in text
    code, data = run(path, "--check")
    assert code == 0
    assert len(data["target"]) == 24
