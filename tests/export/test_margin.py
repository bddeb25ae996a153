"""necc_margin: the region of the certificate, as the C code tells it."""

import dataclasses
import re
import subprocess
from functools import cache

import numpy as np
import pytest
from helpers.constructed import EXAMPLES
from helpers.export_cases import COMPILERS, STRICT, claiming, paper_design
from helpers.problems import problem, solve

from necc_casadi import certify, load_model
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.regions import packed
from necc_casadi.errors import OptionError
from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import compile_controller, load_controller
from necc_casadi.export.fmu import export_fmu

PLANTS = {
    "pendulum": "pi/4",
    "maglev": "q=0.7",
    "two_link_arm": None,
}


@cache
def certified(name):
    model = load_model(EXAMPLES / f"{name}.py")
    target = PLANTS[name] or ",".join(f"{k}={v}" for k, v in model.target.items())
    made = solve(problem(model, target))
    return made, certify(made)


def states(made, certificate, count=1000):
    """States around z̄, some well inside and some beyond the ends of the region."""
    rng = np.random.default_rng(0)
    lo, hi = (np.array([ends[i] for ends in certificate.reach.values()]) for i in (0, 1))
    z_bar = np.array(certificate.z_bar)
    away = rng.uniform(lo, hi, (count, len(lo))) - z_bar
    return z_bar + rng.uniform(0, 1.5, (count, 1)) * away


CASES = ["pendulum", "maglev", pytest.param("two_link_arm", marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_code_tells_the_region_that_is_proved(name, real):
    made, certificate = certified(name)
    compiled = compile_controller(made, real=real, certificate=certificate, flags=[*STRICT, "-O2"])
    n, region = made.loop.plant.n, certificate.region
    kept = [region.active[i] for i in region.kept]
    exact = {"double": 1e-10, "float": 1e-3}[real]
    number = {"double": np.float64, "float": np.float32}[real]
    inside = outside = 0
    for z in states(made, certificate).astype(number).astype(float):
        margin = compiled.margin(z[:n], z[n:])
        natural = z[kept] / made.units.state[kept]
        expected = -1.0
        if region.covers(natural[None, :])[0]:
            rise = certificate.level - made.V(z)
            expected = rise / (certificate.level - made.V(made.z_bar))
        assert margin == pytest.approx(expected, rel=exact, abs=exact)
        if abs(expected) > exact:
            assert (margin > 0) == made.contains(z, certificate)
        inside += margin > 0
        outside += margin < 0
    assert min(inside, outside) > 100
    at = made.z_bar
    assert compiled.margin(at[:n], at[n:]) == pytest.approx(1.0, abs=exact)


def test_low_places_elsewhere_and_what_is_not_finite_are_outside():
    """A turn of the pendulum and its spring away V is as low, in another component or none."""
    made, certificate = certified("pendulum")
    compiled = compile_controller(made, certificate=certificate)
    at = made.z_bar
    turned = at + np.array([2 * np.pi, 0, 2 * np.pi])
    assert not made.contains(turned, certificate)
    assert compiled.margin(turned[:2], turned[2:]) == -1
    for place in range(3):
        for bad in (np.nan, np.inf, -np.inf):
            z = at.copy()
            z[place] = bad
            assert compiled.margin(z[:2], z[2:]) == -1
    assert compiled.margin([at[0], 1e200], at[2:]) == -1


@pytest.mark.parametrize("real", ["double", "float"])
def test_every_cell_of_the_table_is_found(real):
    """Cells of several depths in two dimensions, half of them marked: all their centres."""
    made, certificate = certified("pendulum")
    rng = np.random.default_rng(1)
    base = dataclasses.replace(certificate.region.box, lo=(-1.0, 0.25), side=(2.0, 1.5), parts=16)
    todo, leaves = [(0, (i, j)) for i in range(16) for j in range(16)], []
    while todo:
        depth, (i, j) = todo.pop()
        if depth < 5 and rng.uniform() < 0.35:
            todo += [(depth + 1, (2 * i + a, 2 * j + b)) for a in (0, 1) for b in (0, 1)]
        else:
            leaves.append((depth, (i, j)))
    chosen = rng.permutation(len(leaves))[: len(leaves) // 2]
    marked = {leaves[k] for k in chosen}
    region = dataclasses.replace(
        certificate.region, kept=(0, 1), box=base, cells=packed(marked), floor=()
    )
    certificate = dataclasses.replace(certificate, region=region, level=1e6)
    compiled = compile_controller(made, real=real, certificate=certificate, flags=[*STRICT, "-O1"])
    units = made.units.state
    for leaf in leaves:
        middle = np.array([(lo + hi) / 2 for lo, hi in base.cell(leaf)])
        q, xi = middle * units[[0, 2]]
        assert (compiled.margin([q, 0.0], [xi]) > 0) == (leaf in marked), leaf
    for off in ([-1.001, 0.5], [1.001, 0.5], [0.0, 0.249], [0.0, 1.751]):
        q, xi = np.array(off) * units[[0, 2]]
        assert compiled.margin([q, 0.0], [xi]) == -1


def header(folder):
    return (folder / "necc.h").read_text(encoding="ascii")


def whole(made):
    return dataclasses.replace(
        claiming(made, []), claims=(Claim("global", True, "from everywhere"),)
    )


@pytest.mark.parametrize(
    ("certificate", "words"),
    [
        (lambda made: None, "no certificate came with the design"),
        (lambda made: claiming(made, ["V decreases"]), "no region is proved"),
        (whole, "what is proved holds from every state, below no level"),
    ],
)
def test_without_a_region_there_is_no_margin_and_the_header_says_so(certificate, words, tmp_path):
    made = paper_design((5,), (7,))
    export_c(made, tmp_path, certificate=certificate(made), measured=False)
    assert f"#define NECC_HAS_MARGIN 0 /* {words} */" in header(tmp_path)
    assert "necc_margin" not in header(tmp_path) + (tmp_path / "necc.c").read_text()
    assert load_controller(tmp_path).margin([0.0, 0.0], [0.0]) is None


def test_a_table_that_would_be_too_long_is_left_out(tmp_path):
    made, certificate = certified("pendulum")
    every_other = [(9, (i,)) for i in range(0, certificate.region.box.parts * 2**9, 2)]
    region = dataclasses.replace(certificate.region, cells=packed(every_other))
    certificate = dataclasses.replace(certificate, region=region)
    export_c(made, tmp_path, certificate=certificate, measured=False)
    assert "#define NECC_HAS_MARGIN 0 /* the region takes more than 4096" in header(tmp_path)


def test_one_kept_state_takes_one_interval(tmp_path):
    made, certificate = certified("pendulum")
    export_c(made, tmp_path, certificate=certificate, measured=False)
    assert "#define NECC_HAS_MARGIN 1" in header(tmp_path)
    assert "#define RUNS 1\n" in (tmp_path / "necc.c").read_text()


def test_levels_of_the_inputs_are_margins(tmp_path):
    """From NECC_MARGIN_LIMITS on, V is below c_u."""
    made, certificate = certified("pendulum")
    level, height = certificate.level, certificate.level - made.V(made.z_bar)
    limited = dataclasses.replace(certificate, level_u=level - 0.25 * height, level_clipped=level)
    export_c(made, tmp_path, certificate=limited, measured=False)
    least = dict(re.findall(r"#define NECC_MARGIN_(\w+) (\S+)", header(tmp_path)))
    assert float(least["CLIPPED"]) == 0
    assert 0.25 <= float(least["LIMITS"]) < 0.25 + 1e-12


def test_a_certificate_of_another_design_is_refused(tmp_path):
    made, certificate = certified("pendulum")
    other = paper_design((5,), (7,))
    with pytest.raises(OptionError, match="of another design"):
        export_c(other, tmp_path, certificate=certificate, measured=False)
    with pytest.raises(OptionError, match="of another design"):
        other.contains(other.z_star, certificate)
    assert made.contains(made.z_bar, certificate)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_margin_compiles_strictly_under_another_prefix(compiler, tmp_path):
    made, certificate = certified("pendulum")
    export_c(made, tmp_path, certificate=certificate, prefix="Servo", measured=False)
    assert "SERVO_HAS_MARGIN 1" in header(tmp_path)
    command = [compiler, *STRICT, "-O2", "-c", tmp_path / "necc.c", "-o", tmp_path / "necc.o"]
    subprocess.run(command, check=True)
    listing = subprocess.run(
        ["nm", "-g", tmp_path / "necc.o"], check=True, capture_output=True, text=True
    ).stdout
    assert "T Servo_margin" in listing


def test_the_functional_mock_up_unit_gives_the_margin(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    made, certificate = certified("pendulum")
    unit = export_fmu(made, tmp_path / "pendulum.fmu", certificate=certificate)
    names = [v.name for v in fmpy.read_model_description(unit, validate=True).modelVariables]
    assert names[-3:] == ["margin", "flags", "start_at_minimum"]
    assert not fmpy.validation.validate_fmu(str(unit))
    start = {"q": 0.1, "p": 0.5, "start_at_minimum": False}
    result = fmpy.simulate_fmu(
        str(unit), start_values=start, stop_time=0.01, output_interval=0.01, output=["margin"]
    )
    xi = made.xi_star if made.initial_xi == "minimum" else made.xi_at_start([0.1, 0.5])
    first = np.concatenate([[0.1, 0.5], xi])
    expected = (certificate.level - made.V(first)) / (certificate.level - made.V(made.z_bar))
    assert result["margin"][0] == pytest.approx(expected, abs=1e-10)
