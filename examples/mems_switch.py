"""Electrostatic switch held at a quarter of its gap, where a constant voltage would let it snap.

Plate and spring lose balance below two thirds of the gap. The charge comes through a resistor.
Source: Senturia, Microsystem Design (2001), chapter 6, electrostatic actuator and pull-in, with
numbers typical of a surface-micromachined plate: 0.1 mm by 0.1 mm, gap 2 µm, pull-in at 5.2 V.
Try: necc-design mems_switch.py --target q=0.5e-6
"""

import sympy as sp

q, p, charge = sp.symbols("q p Q", real=True)  # gap, momentum, charge
mass, stiffness, film = sp.Rational("5e-11"), 1, sp.Rational("4e-6")  # kg, N/m, N s/m
rest, plate = sp.Rational("2e-6"), sp.Rational("1e-8")  # m, m²
permittivity, source = sp.Rational("8.854e-12"), 10000000  # F/m, Ω

name = "MEMS switch"
x = (q, p, charge)
J = sp.Matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
R = sp.diag(0, film, 1 / sp.Rational(source))
G = sp.Matrix([0, 0, 1 / sp.Rational(source)])
H = p**2 / (2 * mass) + stiffness * (q - rest) ** 2 / 2
H += charge**2 * q / (2 * permittivity * plate)

units = {q: "m", p: "kg m/s", charge: "C"}
held = rest / 4
target = {q: held, p: 0, charge: sp.sqrt(2 * permittivity * plate * stiffness * (rest - held))}
domain = {q: (rest / 20, rest)}
