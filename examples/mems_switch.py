"""Electrostatic switch held at a quarter of its gap, where a constant voltage would let it snap.

Plate and spring lose balance below two thirds of the gap. The charge comes through a resistor.
Source: Senturia, Microsystem Design (2001), chapter 6, electrostatic actuator and pull-in, with
numbers typical of a surface-micromachined plate: 0.1 mm by 0.1 mm, gap 2 µm, pull-in at 5.2 V.
Try: necc-design mems_switch.py --target q=0.5e-6
"""

import sympy as sp

q, p, charge = sp.symbols("q p Q", real=True)  # gap, momentum, charge
mass, stiffness, film, source = sp.symbols("mass stiffness film source", positive=True)
plate, gap = sp.symbols("plate gap", positive=True)  # area, gap at rest
rest, permittivity = sp.Rational("2e-6"), sp.Rational("8.854e-12")  # m as designed, F/m

name = "MEMS switch"
params = {
    mass: sp.Rational("5e-11"),  # kg
    stiffness: 1,  # N/m
    film: sp.Rational("4e-6"),  # N s/m
    source: 10000000,  # Ω
    plate: sp.Rational("1e-8"),  # m²
    gap: rest,
}
x = (q, p, charge)
J = sp.Matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
R = sp.diag(0, film, 1 / source)
G = sp.Matrix([0, 0, 1 / source])
H = p**2 / (2 * mass) + stiffness * (q - gap) ** 2 / 2
H += charge**2 * q / (2 * permittivity * plate)

units = {q: "m", p: "kg m/s", charge: "C"}
held = rest / 4
target = {q: held, p: 0, charge: sp.sqrt(2 * permittivity * plate * stiffness * (rest - held))}
domain = {q: (rest / 20, rest)}
