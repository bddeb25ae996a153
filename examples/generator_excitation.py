"""Generator on a large grid, its flux in the field winding decaying: the excitation holds 45°.

Per unit but for time and angle; the transient saliency is left out.
Source: Galaz, Ortega, Bazanella, Stanković, An Energy-shaping Approach to the Design of Excitation
Control of Synchronous Generators, Automatica 39 (2003), for the model; Kundur, Power System
Stability and Control (1994), examples 12.2 and 12.3, for the unit: H = 3.5 s, Xd = 1.81, X'd = 0.3,
T'd0 = 8 s, 0.65 to the grid at 0.995, 0.9 delivered.
Try: necc-design generator_excitation.py --target delta=pi/4
"""

import sympy as sp

delta, omega, E_q = sp.symbols("delta omega E_q", real=True)  # angle, slip, transient voltage
base = 120 * sp.Rational("3.14159")  # rad/s
inertia, friction = 7 / base, 10 / base
X, X_t, decay = sp.symbols("X X_t decay", positive=True)  # with the line
grid, power = sp.symbols("grid power", positive=True)

name = "Generator with excitation"
params = {
    X: sp.Rational("2.46"),  # p.u.
    X_t: sp.Rational("0.95"),
    decay: 8,  # s
    grid: sp.Rational("0.995"),
    power: sp.Rational("0.9"),
}
x = (delta, omega, E_q)
J = sp.Matrix([[0, 1 / inertia, 0], [-1 / inertia, 0, 0], [0, 0, 0]])
R = sp.diag(0, friction / inertia**2, (X - X_t) / decay)
G = sp.Matrix([0, 0, 1 / decay])
H = inertia * omega**2 / 2 - power * delta - grid * E_q * sp.cos(delta) / X_t
H += X * E_q**2 / (2 * X_t * (X - X_t))

units = {delta: "rad", omega: "rad/s", E_q: "p.u."}
held = sp.pi / 4
target = {delta: held, omega: 0, E_q: power * X_t / (grid * sp.sin(held))}
domain = {delta: (0, sp.pi / 2), omega: (-4, 4), E_q: (sp.Rational("0.6"), 2)}
