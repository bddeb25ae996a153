"""Overhead crane of a workshop that hoists while it travels: trolley, rope, and a load that swings.

The forces of the trolley's drive and of the hoist are the inputs. Trolley and rope are shaped, and
the swing follows, damped through the coupling.
Source: Lee, Modeling and control of a three-dimensional overhead crane (1998), for the equations
in a plane; numbers typical of a crane of 500 kg.
Try: necc-design overhead_crane.py --target s=2,l=3
"""

import sympy as sp

s, rope, theta = sp.symbols("s l theta")  # m, m, rad
trolley, drum, load, g = sp.symbols("trolley drum load g")
params = {trolley: 200, drum: 50, load: 500, g: 9.81}  # kg, kg of rotor behind gear and drum

q = (s, rope, theta)
sin, cos = sp.sin(theta), sp.cos(theta)
M = sp.Matrix(
    [
        [trolley + load, load * sin, load * rope * cos],
        [load * sin, drum + load, 0],
        [load * rope * cos, 0, load * rope**2],
    ]
)
V = -load * g * rope * cos
B = sp.Matrix([[1, 0], [0, 1], [0, 0]])
friction = sp.diag(200, 100, 0)  # N s/m

name = "Overhead crane"
inputs = ("drive", "hoist")
units = {s: "m", rope: "m", theta: "rad", "drive": "N", "hoist": "N"}
domain = {s: (-5, 5), rope: (1, 6), theta: (-1, 1)}
target = {s: 2, rope: 3, theta: 0}
