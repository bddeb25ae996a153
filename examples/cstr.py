"""Stirred tank with an exothermic reaction at its unstable point; the coolant's temperature is set.

No energy is known: the model is ẋ = f + G u. Minutes, litres, moles and kelvins.
Source: Seborg, Edgar, Mellichamp, Process Dynamics and Control, second edition (2004), example 2.5.
Try: necc-design cstr.py
"""

import sympy as sp

c, T = sp.symbols("c T", positive=True)  # concentration of the reactant, temperature
turnover = 1  # 1/min, feed over volume: 100 l/min, 100 l
rate = sp.Rational("7.2e10") * sp.exp(-8750 / T) * c  # mol/(l min)
heat = sp.Rational(50000, 239)  # K l/mol: 5·10⁴ J/mol over 239 J/(l K)
exchange = sp.Rational(50000, 23900)  # 1/min: 5·10⁴ J/(min K) over 100 l

name = "Stirred tank reactor"
x = (c, T)
f = sp.Matrix([turnover * (1 - c) - rate, turnover * (350 - T) + heat * rate - exchange * T])
G = sp.Matrix([0, exchange])

units = {c: "mol/l", T: "K"}
held = 350
speed = sp.Rational("7.2e10") * sp.exp(-sp.Rational(8750, held))
target = {c: 1 / (1 + speed), T: held}
domain = {c: (sp.Rational("0.1"), sp.Rational("0.9")), T: (325, 375)}
u_limits = [(250, 350)]  # K
