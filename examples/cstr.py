"""Stirred tank with an exothermic reaction at its unstable point; the coolant's temperature is set.

No energy is known: the model is ẋ = f + G u.
Source: Seborg, Edgar, Mellichamp, Process Dynamics and Control, second edition (2004), example 2.5.
Try: necc-design cstr.py
"""

import sympy as sp

c, T = sp.symbols("c T", positive=True)  # concentration of the reactant, temperature
turnover = sp.Rational(1, 60)  # 1/s, feed over volume: 100 l/min, 100 l
fastest = sp.Rational("1.2e9")  # 1/s: 7.2·10¹⁰ 1/min
rate = fastest * sp.exp(-8750 / T) * c  # mol/(l s)
heat = sp.Rational(50000, 239)  # K l/mol: 5·10⁴ J/mol over 239 J/(l K)
exchange = sp.Rational(50000, 60 * 23900)  # 1/s: 5·10⁴ J/(min K) over 100 l

name = "Stirred tank reactor"
x = (c, T)
f = sp.Matrix([turnover * (1 - c) - rate, turnover * (350 - T) + heat * rate - exchange * T])
G = sp.Matrix([0, exchange])

units = {c: "mol/l", T: "K"}
held = 350
ratio = fastest / turnover * sp.exp(-sp.Rational(8750, held))
target = {c: 1 / (1 + ratio), T: held}
domain = {c: (sp.Rational("0.1"), sp.Rational("0.9")), T: (325, 375)}
u_limits = [(250, 350)]  # K
