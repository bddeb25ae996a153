"""Set-points that move in C: taken, limited or refused, and never beyond the proved level."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.export_cases import COMPILERS, STRICT
from helpers.velocity import pendulum, pendulum_with_load

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.export.controller import controller
from necc_casadi.export.header import header
from necc_casadi.export.source import Source

ATTACK = """
#include "necc.c"
#include <stdio.h>
#include <stdlib.h>

static double between(double lo, double hi) { return lo + (hi - lo) * rand() / RAND_MAX; }

int main(int argc, char **argv)
{
    static const double wild[] = {NAN, INFINITY, -INFINITY, 1e30, -1e30, 2.000001};
    necc_state state, other;
    necc_real x[2] = {R(0.75), 0}, u[1], r[1], now[1], then[1];
    double worst = 0, gap = 0, load = 0;
    long counts[4] = {0}, loads = 0, k;
    int flags;
    (void)argc;
    srand((unsigned)atoi(argv[1]));
    necc_init(&state);
    r[0] = R(0.75);
    for (k = 0; k < 100000; ++k) {
        if (k % 400 == 0) { /* a command anywhere in the range, or beyond it */
            r[0] = (necc_real)between(-2.2, 2.2);
            necc_set_switch(&state, HOW < 3 ? HOW : rand() % 3);
        }
        if (k > 98000)
            r[0] = R(-1.5);
        if (necc_step(&state, x, u, STEP) & NECC_REJECTED)
            return 2;
#if NECC_HAS_PARAMETER
        if (k % 150 == 0 && k < 98000) { /* a load that the present is proved to stand */
            necc_real theta[1];
            theta[0] = (necc_real)between(-0.25, 0.55);
            other = state;
            if (necc_set_parameter(&other, theta) == NECC_OK) {
                state = other;
                load = (double)theta[0];
                ++loads;
            }
        }
#endif
        if (k % 7 == 0) { /* no command at all */
            necc_get_target(&state, now);
            then[0] = (necc_real)wild[k / 7 % 6];
            flags = necc_set_target(&state, x, then);
            if (flags != (isfinite(then[0]) ? NECC_OUTSIDE : NECC_REJECTED))
                return 3;
            necc_get_target(&state, then);
            if (then[0] != now[0])
                return 4;
        }
        flags = necc_set_target(&state, x, r);
        ++counts[flags == NECC_OK ? 0 : flags == NECC_LIMITED ? 1 : flags == NECC_REFUSED ? 2 : 3];
        if (1 - (double)necc_margin(&state, x) > worst)
            worst = 1 - (double)necc_margin(&state, x);
        if (necc_step(&state, x, u, 0) & NECC_REJECTED)
            return 2;
        for (int i = 0; i < 10; ++i) { /* the pendulum with its load */
            const necc_real m = R(1.0) + (necc_real)load;
            x[1] += STEP / 10 * ((u[0] - R(0.1) * x[1]) / m - SIN(x[0]));
            x[0] += STEP / 10 * x[1];
        }
    }
    gap = fabs((double)x[0] + 1.5);
    printf("%.17g %.3g %ld %ld %ld %ld %ld\\n", worst, gap, counts[0], counts[1], counts[2],
           counts[3], loads);
    return 0;
}
"""


def lowered(made):
    """A proof of less, for the level to be met often."""
    certificate = certify(made)
    claim = next(c for c in certificate.claims if c.name == "setpoints")
    data = {**claim.data, "level": claim.data["level"] / 16}
    claims = tuple(replace(c, data=data) if c is claim else c for c in certificate.claims)
    return made, replace(certificate, claims=claims)


@pytest.fixture(scope="module")
def moving():
    """A pendulum that is weakly held, so that large steps are beyond the level."""
    return lowered(replace(pendulum(), setpoints={"q": (sp.Integer(-2), sp.Integer(2))}))


def build(moving, folder, name, code, real="double", how=0, integrator="heun"):
    made, certificate = moving
    options = {"real": real, "integrator": integrator, "sample_time": 0.01}
    source = Source(made, certificate=certificate, **options)
    for file, text in (("necc.h", header(source)), ("necc.c", controller(source))):
        (folder / file).write_text(text, encoding="utf-8")
    (folder / f"{name}.c").write_text(code, encoding="utf-8")
    suffix = "f" if real == "float" else ""
    words = {"STEP": f"0.01{suffix}", "SIN": f"sin{suffix}", "HOW": how}
    defines = [f"-D{name}={value}" for name, value in words.items()]
    command = [COMPILERS[0], "-std=c99", "-O1", "-Wall", *defines, f"{name}.c", "-o", name, "-lm"]
    subprocess.run(command, cwd=folder, check=True)


def attacked(moving, folder, real, how, seeds, integrator="heun"):
    """The least and the largest of what counts in runs of 10⁵ samples."""
    build(moving, folder, "attack", ATTACK, real, how, integrator)
    counts = np.zeros(5)
    for seed in seeds:
        run = subprocess.run(
            ["./attack", str(seed)], cwd=folder, check=True, capture_output=True, text=True
        )
        worst, gap, *found = (float(v) for v in run.stdout.split())
        assert worst <= 1 + {"double": 1e-9, "float": 1e-3}[real]
        assert worst > 0.9  # the level is met
        assert gap < {"double": 1e-3, "float": 1e-2}[real]
        counts += found
    return counts


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(("how", "integrator"), [(0, "heun"), (3, "heun"), (3, "casimir")])
def test_no_sequence_of_commands_leaves_the_level(moving, tmp_path, real, how, integrator):
    """A new command every 4 s; V is never above the level, and commands arrive.

    What is no command changes nothing.
    """
    counts = attacked(moving, tmp_path, real, how, (1, 2), integrator)
    assert np.all(counts[[0, 1, 3]] > 100)
    assert counts[:4].sum() == 200_000


@pytest.mark.slow
@pytest.mark.parametrize("real", ["double", "float"])
def test_no_sequence_of_loads_leaves_the_level(loaded, tmp_path, real):
    """The plant's load changes and is told, where the present is proved with it."""
    counts = attacked(loaded, tmp_path, real, 3, (1, 2, 3))
    assert counts[4] > 300


@pytest.fixture(scope="module")
def loaded():
    """The same, with a load that is told."""
    told = pendulum_with_load(l=(sp.Rational(-1, 5), sp.Rational(1, 2)))
    moves = {"q": (sp.Integer(-2), sp.Integer(2))}
    return lowered(replace(pendulum(), setpoints=moves, told=told))


def test_each_answer_of_the_function(moving, tmp_path):
    code = """
    #include "necc.c"
    #include <stdio.h>
    int main(void)
    {
        necc_state s;
        const necc_real x[2] = {0.75, 0}, far[2] = {0.75, 50}, bad[2] = {0.75, NAN};
        const necc_real near[1] = {0.8}, away[1] = {-2}, out[1] = {2.5}, none[1] = {NAN};
        necc_real r[1], u[1];
        necc_init(&s);
        printf("%d ", necc_set_target(&s, x, near));
        necc_get_target(&s, r);
        printf("%.6g ", r[0]);
        printf("%d ", necc_set_target(&s, x, away));
        necc_get_target(&s, r);
        printf("%d ", r[0] < 0.75 && r[0] > -2);
        printf("%d ", necc_set_target(&s, far, near));
        printf("%d ", necc_set_target(&s, x, out));
        printf("%d %d ", necc_set_target(&s, x, none), necc_set_target(&s, bad, near));
        necc_init(&s);
        necc_get_target(&s, r);
        printf("%.6g ", r[0]);
        s.r[0] = 1.25;
        {
            const necc_real there[2] = {1.25, 0};
            necc_step(&s, there, u, 0.01);
        }
        printf("%.12g\\n", u[0]);
        return 0;
    }
    """
    build(moving, tmp_path, "answers", code)
    run = subprocess.run(["./answers"], cwd=tmp_path, check=True, capture_output=True, text=True)
    words = run.stdout.split()
    assert words[:9] == ["0", "0.8", "16", "1", "32", "8", "2", "2", "0.75"]
    assert float(words[9]) == pytest.approx(np.sin(1.25), abs=1e-12)  # what holds it there


def test_xi_stays_at_a_change_where_casimirs_are_kept(moving, tmp_path):
    """And what is kept is the Casimir of what the law sees from the new set-point."""
    code = """
    #include "necc.c"
    #include <stdio.h>
    int main(void)
    {
        necc_state s;
        const necc_real x[2] = {0.75, 0}, y[2] = {0.8, 0}, to[1] = {0.79};
        necc_real u[1], before;
        necc_init(&s);
        necc_step(&s, x, u, 0);
        before = s.xi[0];
        printf("%d ", necc_set_target(&s, x, to));
        necc_step(&s, x, u, 0);
        printf("%.3g ", fabs(s.xi[0] - before));
        necc_update(&s, 0.01);
        necc_set_target(&s, y, x); /* between two samples: xi is what y makes of it */
        printf("%.3g ", fabs(s.xi[0] - before - 0.05));
        necc_step(&s, y, u, 0);
        printf("%.3g\\n", fabs(s.xi[0] - before - 0.05));
        return 0;
    }
    """
    build(moving, tmp_path, "kept", code, integrator="casimir")
    run = subprocess.run(["./kept"], cwd=tmp_path, check=True, capture_output=True, text=True)
    flags, same, on_the_way, damped = (float(v) for v in run.stdout.split())
    assert flags == 0
    assert same < 1e-15
    assert on_the_way < 1e-15
    assert 0 < damped < 0.01  # the time that was due


@pytest.mark.parametrize("integrator", ["heun", "casimir"])
def test_strict_compilers_take_it_and_the_header_says_it(moving, tmp_path, integrator):
    made, certificate = moving
    source = Source(made, certificate=certificate, integrator=integrator, sample_time=0.01)
    for file, text in (("necc.h", header(source)), ("necc.c", controller(source))):
        (tmp_path / file).write_text(text, encoding="utf-8")
    for compiler in COMPILERS:
        subprocess.run([compiler, *STRICT, "-c", "necc.c"], cwd=tmp_path, check=True)
    assert "#define NECC_HAS_TARGET 1" in header(source)
    plain = header(Source(replace(made, setpoints={})))
    assert "NECC_HAS_TARGET 0" in plain
    assert "necc_set_target" not in plain
