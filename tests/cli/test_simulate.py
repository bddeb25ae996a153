"""necc-simulate: responses as text, JSON and CSV, and what it refuses."""

import json

import pytest
from helpers.commands import SIMULATE, check_refusal, here, process

from necc_casadi.cli.simulate import _simulate


def simulate(*arguments):
    return here(_simulate, *arguments)


def test_simulate_as_a_process(made, tmp_path):
    out = made[0] / "pendulum-design"
    done = process(SIMULATE, out, "--x0", "-1,0.5", "--time", "20", "--csv", "r.csv", "--json",
                   "--points", "11", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["states"] == ["q", "p", "xi1"]
    assert data["t_end"] == 20.0
    assert data["z_end"][0] == pytest.approx(0.7853981633974483, abs=1e-3)
    lines = (tmp_path / "r.csv").read_text().splitlines()
    assert lines[0] == "t,q,p,xi1,u1,V"
    assert len(lines) == 12
    assert [float(v) for v in lines[1].split(",")][:3] == [0.0, -1.0, 0.5]


def test_simulate_prints_csv_and_nothing_else(made):
    code, out, _ = simulate(made[0] / "pendulum-design", "--csv", "-", "--points", "5")
    assert code == 0
    assert out.startswith("t,q,p,xi1,u1,V\n")
    assert len(out.splitlines()) == 6


@pytest.mark.parametrize(
    "arguments",
    [["--x0", "1"], ["--x0", "nan,0"], ["--x0", "1,2,3"], ["--x0", ""], ["--xi0", "1,2"],
     ["--time", "0"], ["--time", "nan"], ["--time", "inf"], ["--points", "1"], ["--x0", "1e400,0"],
     ["--csv", "-"]],
    ids=" ".join,
)  # fmt: skip
def test_simulate_refuses(made, arguments):
    """`--csv -` beside `--json`: stdout can hold only one of them."""
    check_refusal(simulate(made[0] / "pendulum-design", "--json", *arguments), "usage")


def test_simulate_refuses_folders_and_files(made, tmp_path):
    (tmp_path / "file").write_text("{}")
    check_refusal(simulate(tmp_path, "--json"), "output")
    check_refusal(simulate(tmp_path / "file", "--json"), "output")
    out = made[0] / "pendulum-design"
    check_refusal(simulate(out, "--json", "--csv", tmp_path / "file" / "r.csv"), "output")
    check_refusal(simulate(out, "--json", "--plot", tmp_path / "file" / "r.png"), "output")


def test_a_response_that_diverges_is_an_outcome(made):
    """Far away the sums overflow: an outcome with its exit code, never a traceback."""
    code, out, err = simulate(made[0] / "pendulum-design", "--json", "--x0", "1e200,0")
    assert code in (0, 4), err
    json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
