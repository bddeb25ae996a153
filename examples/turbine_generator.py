"""Generator on a large grid with its steam turbine: excitation and valve hold angle and power.

Per unit but for time and angle; the model is ẋ = f + G u.
Source: Kundur, Power System Stability and Control (1994), examples 12.2 and 12.3, for the unit (as
in generator_excitation.py), and section 9.2 for the time constant of the steam chest.
Try: necc-design turbine_generator.py --target delta=pi/4
"""

import sympy as sp

delta, omega, E_q, power = sp.symbols("delta omega E_q P", real=True)
base = 120 * sp.Rational("3.14159")  # rad/s
inertia, friction, chest = 7 / base, 10 / base, sp.Rational("0.3")  # s
X, X_t, decay = sp.Rational("2.46"), sp.Rational("0.95"), 8  # with the line; s
grid = sp.Rational("0.995")

name = "Generator with turbine"
x = (delta, omega, E_q, power)
drawn = grid * E_q * sp.sin(delta) / X_t
f = [
    omega,
    (power - drawn - friction * omega) / inertia,
    (-X * E_q / X_t + (X - X_t) * grid * sp.cos(delta) / X_t) / decay,
    -power / chest,
]
G = sp.Matrix([[0, 0], [0, 0], [sp.Rational(1, decay), 0], [0, 1 / chest]])

units = {delta: "rad", omega: "rad/s", E_q: "p.u.", power: "p.u."}
held, delivered = sp.pi / 4, sp.Rational("0.9")
target = {
    delta: held,
    omega: 0,
    E_q: delivered * X_t / (grid * sp.sin(held)),
    power: delivered,
}
domain = {
    delta: (0, sp.pi / 2),
    omega: (-4, 4),
    E_q: (sp.Rational("0.6"), 2),
    power: (sp.Rational("0.4"), sp.Rational("1.4")),
}
