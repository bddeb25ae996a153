"""Permanent-magnet synchronous motor at 100 rad/s under a constant load torque, with all losses.

Fluxes in the frame of the rotor; the load torque is a source that no input touches.
Source: Petrović, Ortega, Stanković, Interconnection and Damping Assignment Approach to Control of
PM Synchronous Motors, IEEE Transactions on Control Systems Technology 9 (2001), for the model, with
numbers typical of a servo motor of 1 kW.
Try: necc-design pmsm.py
"""

import sympy as sp

psi_d, psi_q, p = sp.symbols("psi_d psi_q p", real=True)  # fluxes of the coils, angular momentum
resistance, coil, magnet = sp.symbols("resistance coil magnet", positive=True)
inertia, friction, load = sp.symbols("inertia friction load", positive=True)
pairs = 4

name = "PM synchronous motor"
params = {
    resistance: sp.Rational("2.875"),  # Ω
    coil: sp.Rational("8.5e-3"),  # H
    magnet: sp.Rational("0.175"),  # Wb
    inertia: sp.Rational("8e-4"),  # kg m²
    friction: sp.Rational("1e-3"),  # N m s
    load: 1,  # N m
}
x = (psi_d, psi_q, p)
J = pairs * sp.Matrix([[0, 0, psi_q], [0, 0, -psi_d - magnet], [-psi_q, psi_d + magnet, 0]])
R = sp.diag(resistance, resistance, friction)
G = sp.Matrix([[1, 0], [0, 1], [0, 0]])
E = sp.Matrix([0, 0, -load])
H = (psi_d**2 + psi_q**2) / (2 * coil) + p**2 / (2 * inertia)

units = {psi_d: "Wb", psi_q: "Wb", p: "kg m²/s"}
speed = 100  # rad/s
target = {
    psi_d: 0,
    psi_q: coil * (friction * speed + load) / (pairs * magnet),
    p: inertia * speed,
}
reach = sp.Rational("0.1")  # Wb: the magnet's flux is never turned over
domain = {psi_d: (-reach, reach), psi_q: (-reach, reach), p: (0, 2 * inertia * speed)}
