"""Where the sampled loop comes to rest in `float`, with and without what rounding leaves of ξ.

    python benchmarks/float_loop.py [--seconds S] [--starts N]

The compiled controller of the pendulum at π/4 and an integrator of the plant in double, x measured
in the type of the controller; the largest distance from z̄ in the last fifth of the run. "Without"
compiles the same code with the rest thrown away.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from necc_casadi import design, export_c, find_casimirs, judge, load_model, parse_target

HERE = Path(__file__).parent
LOOP = """
#include "necc.c"
#include <math.h>
/* Farthest from (q, xi) = (@q, @xi) in the last fifth of `steps` periods T. */
double run(double q, double p, double T, long steps, const double *rest);
double run(double q, double p, double T, long steps, const double *rest)
{
    necc_state state;
    double worst = 0;
    const int inner = 1 + (int)(T / 0.002);
    const double h = T / inner;
    necc_init(&state);
    for (long step = 0; step < steps; ++step) {
        const necc_real x[2] = {(necc_real)q, (necc_real)p};
        necc_real u[1];
        necc_step(&state, x, u, (necc_real)(step == 0 ? 0 : T));
        if (5 * step > 4 * steps) {
            const double d = fabs(q - rest[0]) + fabs(p) + fabs((double)state.xi[0] - rest[1]);
            worst = d > worst ? d : worst;
        }
        for (int i = 0; i < inner; ++i) { /* leapfrog: q, p with u held */
            p += h / 2 * ((double)u[0] - sin(q));
            q += h * p;
            p += h / 2 * ((double)u[0] - sin(q));
        }
    }
    return worst;
}
"""


def compiled(folder: Path, made, real: str, kept: bool) -> ctypes.CDLL:
    """The loop around the exported controller."""
    export_c(made, folder, real=real, measured=False)
    code = (folder / "necc.c").read_text(encoding="utf-8")
    if not kept:
        line = "    *rest = (*sum - (next - moved)) + (due - moved);\n"
        if line not in code:
            raise SystemExit("the sum of xi is written in another way now")
        code = code.replace(line, "    *rest = R(0.0);\n    (void)moved;\n")
    (folder / "necc.c").write_text(code, encoding="utf-8")
    (folder / "loop.c").write_text(LOOP, encoding="utf-8")
    target = folder / "loop.so"
    command = ["gcc", "-std=c99", "-O2", "-ffp-contract=off", "-w", "-shared", "-fPIC"]
    subprocess.run([*command, str(folder / "loop.c"), "-o", str(target), "-lm"], check=True)
    library = ctypes.CDLL(str(target))
    library.run.restype = ctypes.c_double
    library.run.argtypes = [ctypes.c_double] * 3 + [ctypes.c_long, ctypes.c_void_p]
    return library


def main() -> None:
    """One row per period."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--starts", type=int, default=5)
    options = parser.parse_args()
    loop = load_model(str(HERE.parent / "examples" / "pendulum.py")).loop
    x_star = parse_target(loop.plant, "pi/4")
    casimirs = find_casimirs(loop)
    made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    rest = np.array(made.z_bar)[[0, 2]].copy()
    kinds = [("float, without", "float", False), ("float", "float", True)]
    kinds.append(("double", "double", True))
    print("| T, s | " + " | ".join(name for name, _, _ in kinds) + " |")
    print("|---|" + "---|" * len(kinds))
    with tempfile.TemporaryDirectory() as name:
        loops = [compiled(Path(name) / str(i), made, *kind[1:]) for i, kind in enumerate(kinds)]
        for period in (1e-4, 1e-3, 1e-2, 0.05):
            steps, cells = int(options.seconds / period), []
            for library in loops:
                rng = np.random.default_rng(0)
                starts = rng.uniform([0.2, -0.5], [1.4, 0.5], (options.starts, 2))
                runs = [library.run(q, p, period, steps, rest.ctypes.data) for q, p in starts]
                cells.append(f"{max(runs):.1e}")
            print(f"| {period:g} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
