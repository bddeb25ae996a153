"""Write docs/images/casimir.png: what a Casimir keeps, and what damping does to it.

    python docs/make_casimir.py

Both motions are of the same design of the README's pendulum, integrated here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from necc_casadi import Design, run, simulate
from necc_casadi.report.style import styled, write_figure

ROOT = Path(__file__).parent.parent
START = (-0.2, 0.0, 0.35)  # q [rad], p, ξ1: away from the equilibrium
SECONDS = 12.0
#: Jcl − Rcl of the states (q, p, ξ1), where Rcl = 0: the pendulum and its integrator.
STRUCTURE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def main() -> None:
    """Design, integrate with and without damping, draw."""
    made = run(ROOT / "examples" / "pendulum.py", "pi/4").design
    if made is None:
        raise SystemExit("there is no design to draw")
    damped = simulate(made, START[:2], xi0=START[2:], time=SECONDS)
    undamped = solve_ivp(
        lambda _, z: STRUCTURE @ np.ravel(made.lyapunov.gradient(z)),
        (0.0, SECONDS),
        START,
        rtol=1e-9,
        atol=1e-9,
        dense_output=True,
    )
    with styled():
        figure = Figure(figsize=(8.0, 3.4), layout="constrained")
        plane, over_time = figure.subplots(1, 2)
        _draw_plane(plane, made, damped.z, undamped.y.T)
        _draw_over_time(over_time, damped, undamped)
        write_figure(figure, ROOT / "docs" / "images" / "casimir.png")


def _draw_plane(axis, made: Design, damped, undamped) -> None:
    """Lines on which the Casimir is constant, V's levels, and both motions."""
    q, xi = np.meshgrid(np.linspace(-0.6, 2.0, 121), np.linspace(-0.6, 2.0, 121))
    states = np.stack([q.ravel(), np.zeros(q.size), xi.ravel()], axis=1)
    V = np.ravel(made.lyapunov.V(states)).reshape(q.shape) - made.V(made.z_bar)
    axis.contour(q, xi, V, levels=np.max(V) * np.linspace(0.02, 1, 9) ** 2, colors="0.8")
    for constant in np.arange(-2.4, 2.5, 0.4):
        axis.plot([-0.6, 2.0], [-0.6 - constant, 2.0 - constant], ":", color="0.5", lw=0.8)
    axis.plot(undamped[:, 0], undamped[:, 2], color="C1", lw=2.2, label="without damping")
    axis.plot(damped[:, 0], damped[:, 2], color="C0", label="with damping")
    axis.plot(*made.z_bar[[0, 2]], "k*", label="z̄")
    axis.plot(START[0], START[2], "ko", ms=4, label="start")
    axis.set(xlim=(-0.6, 2.0), ylim=(-0.6, 2.0), xlabel="q [rad]", ylabel="ξ1")
    axis.set_title("dotted: q − ξ1 constant; grey: levels of V at p = 0", fontsize=9)
    axis.legend(loc="upper right", fontsize=8)


def _draw_over_time(axis, damped, undamped) -> None:
    t = np.linspace(0.0, SECONDS, 400)
    z = undamped.sol(t)
    axis.plot(t, z[0] - z[2], color="C1", lw=2.2, label="without damping")
    axis.plot(damped.t, damped.z[:, 0] - damped.z[:, 2], color="C0", label="with damping")
    axis.set(xlabel="t [s]", ylabel="Casimir q − ξ1")
    axis.set_title("exactly constant without damping", fontsize=9)
    axis.legend(fontsize=8)


if __name__ == "__main__":
    main()
