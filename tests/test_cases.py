"""Plants in the units of a data sheet, from model file to checked certificate and C self-test."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from helpers.commands import design
from helpers.models import BASE

from necc_casadi.certificate.checker.check import check
from necc_casadi.designs.design import Design

#: 300 kg on 2e5 N/m, moved by a force.
STIFF_SPRING = BASE + "H = p**2 / 600 + 200000 * q**2 / 2\n"
#: A proof mass of 2e-9 kg on 1 N/m.
MICRO_SPRING = (
    BASE
    + """
H = p**2 / sp.Rational("4e-9") + q**2 / 2
domain = {q: (sp.Rational("-1e-5"), sp.Rational("1e-5")),
          p: (sp.Rational("-1e-9"), sp.Rational("1e-9"))}
"""
)
#: 1e-4 kg m², m g l = 0.015 N m, friction 1e-5 N m s.
LIGHT_PENDULUM = (
    BASE
    + """
R = sp.diag(0, sp.Rational("1e-5"))
H = p**2 / (2 * sp.Rational("1e-4")) + sp.Rational("0.015") * (1 - sp.cos(q))
"""
)
#: 2e6 kg that nothing holds but the controller: u is the difference of 1e5 N.
BARGE = BASE + "H = p**2 / 4000000\ndomain = {q: (0, 60), p: (-6000000, 6000000)}\n"
#: The energy has no value beyond theta = 1.29.
CART_POLE = """
import sympy as sp
x_c, theta, v_x, v_t = sp.symbols("x_c theta v_x v_theta", real=True)
x = (x_c, theta, v_x, v_t)
J = sp.Matrix([[0, 0, 4, -1], [0, 0, -1, sp.Rational(7, 25)], [-4, 1, 0, 0],
               [1, -sp.Rational(7, 25), 0, 0]])
R = sp.zeros(4, 4)
c = sp.cos(theta)
G = sp.Matrix([0, 0, -3 / (25 * c - 7), 3 * c / (25 * c - 7)])
H = (50 * v_t**2 / 3 + 25 * v_t * v_x / 3 + 7 * v_x**2 / 6
     - sp.Rational(981, 100) * sp.log((25 * c - 7) / 18))
h = sp.tan(theta / 2)
xi1 = sp.Symbol("xi1", real=True)
casimirs = [xi1 - (4 * theta + x_c + sp.log((3 + 4 * h) / (3 - 4 * h)) / 8)]
"""
PENDULUM = (
    BASE
    + """
m = sp.Symbol("m")
params = {m: 1}
H = p**2 / (2 * m) + m * (1 - sp.cos(q))
domain = {p: (-2 * m, 2 * m)}
"""
)


def run(tmp_path, text, *options):
    """(exit code, JSON, folder) of necc-design; every claim is checked again."""
    path, out = tmp_path / "plant.py", tmp_path / "out"
    path.write_text(text, encoding="utf-8")
    code, text, errors = design(path, *options, "--json", "--out", out)
    found = json.loads(text)
    assert code in (0, 4), errors
    return code, found, out


def settled(found) -> list[float]:
    return [r["settling_time"] for r in found["responses"]]


@pytest.mark.parametrize(
    ("text", "target", "natural_time"),
    [(STIFF_SPRING, "q=0.05", (300 / 2e5) ** 0.5), (MICRO_SPRING, "q=3e-6", 2e-9**0.5),
     (LIGHT_PENDULUM, "pi/4", 0.1), (BARGE, "q=30", 10.0)],
    ids=["stiff spring", "micro spring", "light pendulum", "barge"],
)  # fmt: skip
def test_a_plant_in_si_units_is_certified_by_maker_and_checker(
    tmp_path, text, target, natural_time
):
    code, found, out = run(tmp_path, text, "--target", target, "--no-plots")
    assert (code, found["status"]) == (0, "certified")
    assert found["design"]["stability"] == "asymptotic"
    assert found["certificate"]["domain_share"] > 0.2
    failed = [claim for claim in check(out) if not claim.holds]
    assert not failed, failed
    assert None not in settled(found)
    assert max(settled(found)) < 12 * natural_time
    assert set(found["sizes"]) == {"q", "p", "xi1", "u"}


def test_a_spring_of_any_stiffness_is_proved_everywhere(tmp_path):
    for text, target in ((STIFF_SPRING, "q=0.05"), (MICRO_SPRING, "q=3e-6"), (BARGE, "q=30")):
        _, found, _ = run(tmp_path, text, "--target", target, "--no-plots")
        assert found["certificate"]["global"] is True


def test_a_small_pendulum_gets_small_gains(tmp_path):
    """The holding torque is 0.0106 N m: gains of 0.005 … 1 N m/rad, a C sample of milliseconds."""
    _, found, out = run(tmp_path, LIGHT_PENDULUM, "--target", "pi/4", "--no-plots")
    made = Design.load(out)
    z, n = made.z_bar, 2
    h = 1e-6
    turned = np.diag([h, 0.0, h])  # of q and ξ1
    gains = [made.control((z + d)[:n], (z + d)[n:])[0] for d in turned]
    rest = made.control(z[:n], z[n:])[0]
    assert 0.005 < max(abs(gain - rest)[0] / h for gain in gains) < 1
    assert max(r["peak_input"] for r in found["responses"]) < 0.2
    assert 0.2 < max(settled(found)) < 2
    assert any("sizes of q, p, xi1, u were guessed" in note for note in found["notes"])


@pytest.mark.slow
@pytest.mark.parametrize("m", ["1e-6", "3e5", "1e6"])
def test_the_mass_of_a_pendulum_changes_nothing_but_its_units(tmp_path, m):
    results = []
    for mass in ("1", m):
        folder = tmp_path / mass
        folder.mkdir()
        options = ("--target", "q=pi/4,p=0", "--param", f"m={mass}", "--no-plots")
        code, found, out = run(folder, PENDULUM, *options)
        assert code == 0
        assert all(claim.holds for claim in check(out))
        results.append(found)
    plain, other = results
    held = [[(c["name"], c["holds"]) for c in r["certificate"]["claims"]] for r in results]
    assert held[0] == held[1]
    assert other["certificate"]["domain_share"] == pytest.approx(
        plain["certificate"]["domain_share"], rel=0.02
    )
    assert other["design"]["spectral_abscissa"] == pytest.approx(
        plain["design"]["spectral_abscissa"], rel=0.05
    )
    assert settled(other) == pytest.approx(settled(plain), rel=0.05)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("text", [BARGE, MICRO_SPRING], ids=["barge", "micro spring"])
def test_the_exported_self_test_allows_what_cancels(tmp_path, text):
    target = "q=30" if text is BARGE else "q=3e-6"
    _, _, out = run(tmp_path, text, "--target", target, "--no-plots")
    program = tmp_path / "selftest"
    sources = [out / "c" / name for name in ("necc.c", "selftest.c")]
    subprocess.run(["gcc", "-O2", "-o", program, *sources, "-lm"], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_a_figure_goes_around_a_pole(tmp_path):
    target = "x_c=1,theta=0,v_x=0,v_theta=0"
    code, _, out = run(tmp_path, CART_POLE, "--target", target)
    assert code == 0
    assert (out / "figures" / "lyapunov.png").is_file()
    assert (out / "figures" / "region.png").is_file()
    made = Design.load(out)
    corner = made.domain.hi
    assert not np.isfinite(made.V(corner))
