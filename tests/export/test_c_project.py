"""The C controller computes what CasADi computes, and nothing else happens in it."""

import ctypes
import dataclasses
import hashlib
import math
import re
import subprocess
import zipfile
from dataclasses import replace
from typing import get_args
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np
import pytest
from helpers.export_cases import (
    COMPILERS,
    STRICT,
    arm_loop,
    claiming,
    design,
    designs,
    paper_design,
    pendulum_loop,
)  # fmt: skip
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from necc_casadi.cases import Integrator
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.sampled import KEPT, SampledRegion, packed_tree
from necc_casadi.errors import OptionError, OutputError
from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import compile_controller, load_controller
from necc_casadi.export.fmu import export_fmu
from necc_casadi.export.header import header
from necc_casadi.export.sampled_loop import ORDERS
from necc_casadi.export.source import Source
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop

REJECTED = 2


def sha256(text):
    return hashlib.sha256(text.encode()).hexdigest()


def heun(f, y, dt):
    k1 = f(y)
    return y + dt / 2 * (k1 + f(y + dt * k1))


def euler(f, y, dt):
    return y + dt * f(y)


def rk4(f, y, dt):
    k1 = f(y)
    k2 = f(y + dt / 2 * k1)
    k3 = f(y + dt / 2 * k2)
    return y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + f(y + dt * k3))


def reference(d, steps, dt, x0, xi0, method=heun):
    """The sampled loop by CasADi: u at the sample, x by RK4 with u held, ξ with x held."""
    terms, law = d.lyapunov.terms, d.lyapunov.control_law_function
    x, xi, u = (ca.MX.sym(n, k) for n, k in (("x", terms.n), ("xi", terms.nc), ("u", terms.m)))
    plant = lambda s: terms.drift(s) + terms.directions(s) @ u  # noqa: E731
    plant_step = ca.Function("plant_step", [x, u], [rk4(plant, x, dt)])
    xi_step = ca.Function(
        "xi_step", [x, xi], [law(x, xi)[0], method(lambda s: law(x, s)[1], xi, dt)]
    )
    rows = []
    x, xi = ca.DM(x0), ca.DM(xi0)
    for step in range(steps):
        u, xi_next = xi_step(x, xi)
        rows.append([step * dt, *x.full().ravel(), *xi.full().ravel(), *u.full().ravel(), 0])
        x, xi = plant_step(x, u), xi_next
    return np.array(rows)


def run_demo(folder, compiler, *arguments):
    sources = [str(folder / "necc.c"), str(folder / "main.c")]
    subprocess.run(
        [compiler, *STRICT, "-O2", *sources, "-o", str(folder / "demo"), "-lm"], check=True
    )
    done = subprocess.run(
        [str(folder / "demo"), *arguments], check=True, capture_output=True, text=True
    )
    header, *rows = done.stdout.splitlines()
    return header.split(","), np.array([[float(v) for v in row.split(",")] for row in rows])


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("real", ["double", "float"])
def test_closed_loop_of_the_demonstration_is_the_scheme_that_casadi_computes(
    tmp_path, compiler, real
):
    d = paper_design()
    names = {p.name for p in export_c(d, tmp_path, real=real, sample_time=0.02, measured=False)}
    assert {"necc.h", "necc.c", "main.c", "CMakeLists.txt"} <= names
    header, rows = run_demo(tmp_path, compiler, "2000", "0.1", "-0.7")
    assert header == ["t", "q", "p", "xi1", "u1", "flags"]
    expected = reference(d, 2000, 0.02, [0.1, -0.7], rows[0, 3:4])
    tolerance = {"double": 1e-12, "float": 2e-4}[real]
    assert np.abs(rows - expected)[:, 1:].max() <= tolerance


@pytest.mark.parametrize("method", [euler, heun, rk4])
def test_integrators_of_the_controller_state(tmp_path, method):
    form = Form(Network(2, (5,)), Network(1, (9,)), (Network(1, (3,)), Network(1, (4,))))
    d = design(arm_loop(), form)
    assert method.__name__ in ORDERS
    export_c(d, tmp_path, sample_time=0.01, integrator=method.__name__, measured=False)
    _, rows = run_demo(tmp_path, COMPILERS[0], "300", "0.1", "0.2", "0.3", "-0.1")
    expected = reference(d, 300, 0.01, [0.1, 0.2, 0.3, -0.1], rows[0, 5:7], method)
    assert np.abs(rows - expected)[:, 1:].max() <= 1e-12


def test_what_is_proved_of_another_method_is_not_said_of_this_code():
    """A region is about the method that advances ξ in it."""
    form = Form(Network(1, (8,), quadratic=True), Network(1, (8,), quadratic=True))
    d = design(pendulum_loop(), form)
    sides = ((-1.0, 1.0),) * 3
    region = SampledRegion(
        0.5, "heun", ((0.0,) * 3,) * 3, 1.0, 1.0, sides, sides, False, packed_tree(bytes([KEPT]))
    )
    claim = Claim("sampled", True, "every solution converges", region.data)
    near = Claim("disturbed", True, "it stays near by", {"precision": "double"})
    certificate = replace(claiming(d, ["z̄ is stable"]), claims=(claim, near))
    for integrator in get_args(Integrator):
        source = Source(d, sample_time=0.01, integrator=integrator, certificate=certificate)
        for words in ("Proved of the sampled loop", near.statement):
            assert (words in header(source)) == (integrator == "heun"), integrator
        assert (source.disturbed_claim is None) == (integrator != "heun")
        assert all(c != claim.statement for c in source.claims)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(designs(), st.integers(0, 2**16), st.sampled_from(["double", "float"]))
def test_control_law_for_any_networks(d, seed, real):
    compiled = compile_controller(d, real=real, flags=[*STRICT, "-O1"])
    rng = np.random.default_rng(seed)
    for scale in (0.5, 2):
        x, xi = scale * rng.normal(size=compiled.n), scale * rng.normal(size=compiled.nc)
        if real == "float":
            x, xi = np.float32(x).astype(float), np.float32(xi).astype(float)
        expected = np.concatenate(d.control(x, xi))
        got = np.concatenate(compiled.control(x, xi))
        unit = {"double": 1e-13, "float": 1e-4}[real] * max(1, np.abs(expected).max())
        np.testing.assert_allclose(got, expected, rtol=0, atol=unit)


@pytest.fixture(scope="module")
def controller():
    return compile_controller(paper_design((5,), (7,)), flags=STRICT)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", ["q", "p", "xi", "dt"])
def test_non_finite_input_gives_a_status_no_input_and_keeps_the_state(controller, bad, place):
    x, xi, dt = [0.1, 0.2], [0.3], 0.01
    if place == "dt":
        dt = bad
    elif place == "xi":
        xi = [bad]
    else:
        x["qp".index(place)] = bad
    u, after, flags = controller.step(xi, x, dt)
    assert flags == REJECTED
    assert list(u) == [0]
    np.testing.assert_array_equal(after, xi)


def test_negative_dt_and_overflow_are_rejected_and_zero_dt_keeps_the_state(controller):
    assert controller.step([0.3], [0.1, 0.2], -0.01)[2] == REJECTED
    u, after, flags = controller.step([0.3], [0.1, 1.7e308], 0.01)
    assert (flags, list(u), list(after)) == (REJECTED, [0], [0.3])
    u, after, flags = controller.step([0.3], [0.1, 0.2], 0)
    assert (flags, list(after)) == (0, [0.3])
    assert u == controller.control([0.1, 0.2], [0.3])[0]


@pytest.mark.parametrize("method", [euler, heun, rk4])
def test_xi_advances_over_the_period_that_has_passed_with_the_x_of_its_start(method):
    """Periods of any length, one after another: ξ moves over each with the plant, never ahead."""
    d = design(arm_loop(), Form(Network(2, (5,)), Network(2, (9,))))
    compiled = compile_controller(d, integrator=method.__name__, flags=STRICT)
    rng = np.random.default_rng(1)
    xs, dts = rng.normal(size=(30, 4)), rng.uniform(1e-4, 0.1, 30)
    us, xis, flags = compiled.samples(d.xi_star, xs, dts)
    assert not any(flags)
    xi = np.array(d.xi_star)
    for k, x in enumerate(xs):
        if k > 0:
            before = xs[k - 1]
            xi = method(lambda s, before=before: d.control(before, s)[1], xi, dts[k])
        np.testing.assert_allclose(xis[k], xi, rtol=0, atol=1e-11)
        np.testing.assert_allclose(us[k], d.control(x, xi)[0], rtol=0, atol=1e-10)


def test_the_first_dt_counts_for_nothing_and_a_rejected_call_is_no_sample(controller):
    bad = [math.nan, 0.2]
    us, xis, flags = controller.samples([0.3], [[0.1, 0.2], bad, [0.4, 0.0]], [5.0, 0.01, 0.03])
    assert flags == [0, REJECTED, 0]
    assert [*xis[0], *xis[1], *us[1]] == [0.3, 0.3, 0]
    plain = controller.samples([0.3], [[0.1, 0.2], [0.4, 0.0]], [0, 0.03])
    assert [*us[2], *xis[2]] == [*plain[0][1], *plain[1][1]]


@given(st.lists(st.floats(-1e300, 1e300), min_size=3, max_size=3))
def test_huge_and_denormal_inputs_give_finite_output_or_a_status(controller, z):
    u, after, flags = controller.step(z[2:], z[:2], 1e-3)
    assert flags in (0, REJECTED)
    assert np.isfinite([*u, *after]).all()


def test_init_is_the_designed_equilibrium(controller):
    assert list(controller.init()) == list(paper_design((5,), (7,)).xi_star)


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("real", ["double", "float"])
def test_no_heap_no_globals_and_only_the_interface_is_visible(tmp_path, compiler, real):
    form = Form(Network(2, (5,), "sin"), Network(2, (9,), "squareplus"), phi=MonotonePhi())
    export_c(design(arm_loop(), form), tmp_path, real=real, measured=False)
    target = tmp_path / "necc.o"
    subprocess.run(
        [compiler, *STRICT, "-O2", "-c", str(tmp_path / "necc.c"), "-o", str(target)], check=True
    )
    listing = subprocess.run(["nm", str(target)], check=True, capture_output=True, text=True).stdout
    symbols = re.findall(r"([A-Za-z]) (\w+)$", listing, re.MULTILINE)
    assert not [name for kind, name in symbols if kind in "bBdDC"]
    assert {name for kind, name in symbols if kind == "T"} >= {"necc_control", "necc_step"}
    assert all(name.startswith("necc_") for kind, name in symbols if kind == "T")
    allowed = {"memcpy", "memset", "cos", "sin", "exp", "sqrt", "atan", "tanh", "cosh", "sincos"}
    undefined = {name for kind, name in symbols if kind == "U"}
    assert undefined <= allowed | {f"{name}f" for name in allowed} | {"_GLOBAL_OFFSET_TABLE_"}


def test_fast_math_is_refused(tmp_path):
    export_c(paper_design((5,), (7,)), tmp_path, measured=False)
    done = subprocess.run(
        [COMPILERS[0], "-ffast-math", "-c", str(tmp_path / "necc.c"), "-o", "/dev/null"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "-ffast-math" in done.stderr


def test_header_says_what_it_is_about(tmp_path):
    d = paper_design((5,), (7,))
    certificate = claiming(d, ["z̄ is asymptotically stable"])
    export_c(d, tmp_path, certificate=certificate, measured=False)
    text = (tmp_path / "necc.h").read_text(encoding="utf-8")
    assert f'#define NECC_DESIGN "{d.hash}"' in text
    assert f'#define NECC_CERTIFICATE "{sha256(certificate.to_json())}"' in text
    assert "continuous-time" in text
    assert "not saturated" in text
    assert "zbar is asymptotically stable" in text
    assert "p [kg m^2/s]" in text
    assert "Pendulum * / with" in text


@pytest.mark.parametrize(
    "option", [{"real": "half"}, {"integrator": "ab2"}, {"sample_time": 0}, {"sample_time": np.nan}]
)
def test_options_that_cannot_be_used(tmp_path, option):
    with pytest.raises(OptionError):
        export_c(paper_design((5,), (7,)), tmp_path, **option, measured=False)
    assert not list(tmp_path.iterdir())


def test_the_loaded_controller_of_a_folder_is_the_compiled_design(tmp_path):
    d = design(pendulum_loop(), Form(Network(1, (6,)), Network(1, ())), 3)
    export_c(d, tmp_path, measured=False)
    loaded = load_controller(tmp_path)
    np.testing.assert_array_equal(
        np.concatenate(loaded.control([0.2, 0.1], [0.4])),
        np.concatenate(compile_controller(d).control([0.2, 0.1], [0.4])),
    )


def test_readme_tells_sizes_and_times_measured_here(tmp_path):
    export_c(paper_design((5,), (7,)), tmp_path, sample_time=0.02)
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(-O.*)` \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|$", text, re.MULTILINE)
    assert [row[0] for row in rows] == ["-O2", "-O3 -march=native"]
    for _, size, bss, control, step in rows:
        assert 1000 < int(size) < 30000
        assert int(bss) == 0
        assert 0 < int(control) < int(step)
    assert "necc_step(&state, x, u, 0.02)" in text


def test_without_a_compiler_the_readme_says_so_and_loading_names_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    export_c(paper_design((5,), (7,)), tmp_path / "c")
    assert "Not measured" in (tmp_path / "c" / "README.md").read_text(encoding="utf-8")
    with pytest.raises(OutputError, match="no C compiler"):
        load_controller(tmp_path / "c")


# --- names, letters, and what belongs together ----------------------------------------------------


def external(folder, compiler, prefix) -> set[str]:
    """Macros and external functions, types and constants of a header, without those of C."""
    listing = subprocess.run(
        [compiler, "-std=c99", "-dM", "-E", str(folder / "necc.h")],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    macros = {line.split()[1].split("(")[0] for line in listing.splitlines()}
    own = {name for name in macros if not name.startswith("_") and name not in ("linux", "unix")}
    target = folder / "necc.o"
    subprocess.run([compiler, "-std=c99", "-c", folder / "necc.c", "-o", target], check=True)
    symbols = subprocess.run(["nm", "-g", target], check=True, capture_output=True, text=True)
    defined = set(re.findall(r"[TRDB] (\w+)$", symbols.stdout, re.MULTILINE))
    assert {f"{prefix}_step", f"{prefix}_dimensions"} <= defined
    return own | defined | set(re.findall(r"}} (\w+);", (folder / "necc.h").read_text()))


@pytest.mark.parametrize("compiler", COMPILERS)
def test_two_controllers_in_one_firmware(tmp_path, compiler):
    """Each name begins with its prefix, so that both link; each is the controller it was."""
    made = {"left": paper_design((5,), (7,)), "right2": design(arm_loop(), Form(*_TWO))}
    for prefix, d in made.items():
        export_c(d, tmp_path / prefix, prefix=prefix, measured=False)
        names = external(tmp_path / prefix, compiler, prefix)
        assert all(name.lower().startswith(f"{prefix}_") for name in names), names
        for path in (tmp_path / prefix).glob("*.[ch]"):
            assert re.findall(r"\b(?:necc|NECC)_\w+", path.read_text()) == [], path
    main = """
#include "left/necc.h"
#include "right2/necc.h"
#include <stdio.h>
int main(void)
{
    left_state a;
    right2_state b;
    left_real x[LEFT_NX] = {0}, u[LEFT_NU];
    right2_real y[RIGHT2_NX] = {0}, v[RIGHT2_NU];
    left_init(&a);
    right2_init(&b);
    if (left_step(&a, x, u, 0) != LEFT_OK || right2_step(&b, y, v, 0) != RIGHT2_OK)
        return 1;
    printf("%.17g %.17g\\n", u[0], v[0]);
    return 0;
}
"""
    (tmp_path / "firmware.c").write_text(main)
    sources = [tmp_path / "firmware.c", *(tmp_path / prefix / "necc.c" for prefix in made)]
    subprocess.run([compiler, *STRICT, *sources, "-o", tmp_path / "firmware", "-lm"], check=True)
    done = subprocess.run([tmp_path / "firmware"], check=True, capture_output=True, text=True)
    expected = [d.control(np.zeros(d.loop.plant.n), d.xi_star)[0][0] for d in made.values()]
    assert [float(v) for v in done.stdout.split()] == pytest.approx(expected, abs=1e-12)


_TWO = (Network(2, (5,)), Network(2, (9,)))


@pytest.mark.parametrize("prefix", ["", "1st", "_x", "a-b", "a b", "é", "x" * 32, "a\n"])
def test_a_prefix_that_is_no_beginning_of_a_name(tmp_path, prefix):
    with pytest.raises(OptionError, match="cannot begin"):
        export_c(paper_design((5,), (7,)), tmp_path, prefix=prefix, measured=False)
    assert not list(tmp_path.iterdir())


def test_the_code_with_a_prefix_loads_and_passes_its_own_test(tmp_path):
    d = paper_design((5,), (7,))
    export_c(d, tmp_path, prefix="Servo_A", measured=False)
    loaded = load_controller(tmp_path, prefix="Servo_A")
    assert list(loaded.init()) == list(d.xi_star)
    with pytest.raises(OutputError, match="no code with the prefix necc"):
        load_controller(tmp_path)
    sources = [str(tmp_path / name) for name in ("necc.c", "selftest.c")]
    subprocess.run(
        [COMPILERS[0], *STRICT, *sources, "-o", str(tmp_path / "selftest"), "-lm"], check=True
    )
    assert subprocess.run([tmp_path / "selftest"], capture_output=True).returncode == 0


@pytest.mark.parametrize("real", ["double", "float"])
def test_sizes_are_read_from_the_code_itself(tmp_path, real):
    """What comments and texts of the header say counts for nothing."""
    export_c(paper_design((5,), (7,)), tmp_path, real=real, measured=False)
    header = (tmp_path / "necc.h").read_text()
    lie = "/* #define NECC_NX 9\n#define NECC_NU 9\n typedef float x; typedef double y; */\n"
    (tmp_path / "necc.h").write_text(lie + header.replace("#define NECC_NX", "# define  NECC_NX"))
    loaded = load_controller(tmp_path)
    assert (loaded.n, loaded.nc, loaded.m) == (2, 1, 1)
    assert ctypes.sizeof(loaded.real) == {"double": 8, "float": 4}[real]


NASTY = ("ω̄*/ \\", "x\u202ey", "??/", "漢字", "p\x1b[31m")


def test_every_letter_of_the_code_is_ascii_and_prints(tmp_path):
    """Names as a stored design may hold them: no file is spoilt by one."""
    loop, casimirs = pendulum_loop()
    plant = dataclasses.replace(loop.plant, name=" ".join(NASTY), units={"q": NASTY[0]})
    loop = ClosedLoop(plant, loop.controller)
    d = design((loop, casimirs), Form(Network(1, (6,)), Network(1, ())), 3)
    export_c(d, tmp_path, certificate=claiming(d, NASTY), measured=False)
    export_fmu(d, tmp_path / "x.fmu")
    for path in tmp_path.iterdir():
        if path.suffix in (".c", ".h"):
            data = path.read_bytes()
            assert set(data) <= {10, *range(32, 127)}, path
        if path.suffix == ".c":
            subprocess.run([COMPILERS[0], *STRICT, "-fsyntax-only", str(path)], check=True)
    with zipfile.ZipFile(tmp_path / "x.fmu") as unit:
        ET.fromstring(unit.read("modelDescription.xml"))


def test_files_of_two_designs_do_not_compile_together(tmp_path):
    export_c(paper_design((5,), (7,)), tmp_path, measured=False)
    export_c(paper_design((6,), (7,)), tmp_path / "other", measured=False)
    (tmp_path / "necc.c").write_bytes((tmp_path / "other" / "necc.c").read_bytes())
    with pytest.raises(OutputError, match="failed"):
        load_controller(tmp_path)
