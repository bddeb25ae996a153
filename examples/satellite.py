"""Rigid satellite in Euler angles (roll, pitch, yaw) with three body torques.

The controller's states are angles that the same body rates turn, Gc = the kinematics. Three
Casimirs exist, entries of Rot(q) Rot(ξ)ᵀ, and any attitude can be held. With the default
integrators (delete the last four lines) the kernel has three vectors at every point and not one
is a gradient: no Casimir, refused.
Source: Wie, Space Vehicle Dynamics and Control (2008), kinematics and rigid-body dynamics.
Try: necc-design satellite.py
"""

import sympy as sp

q = sp.symbols("roll pitch yaw", real=True)
p = sp.symbols("p1:4", real=True)  # angular momentum in the body frame


def kinematics(angles):
    """Euler rates per body rate."""
    roll, pitch, _ = angles
    return sp.Matrix(
        [
            [1, sp.sin(roll) * sp.tan(pitch), sp.cos(roll) * sp.tan(pitch)],
            [0, sp.cos(roll), -sp.sin(roll)],
            [0, sp.sin(roll) / sp.cos(pitch), sp.cos(roll) / sp.cos(pitch)],
        ]
    )


name = "Satellite"
x = (*q, *p)
J = sp.zeros(6, 6)
J[:3, 3:], J[3:, :3] = kinematics(q), -kinematics(q).T
J[3:, 3:] = sp.Matrix([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
R = sp.zeros(6, 6)
G = sp.Matrix.vstack(sp.zeros(3, 3), sp.eye(3))
H = p[0] ** 2 / 2 + p[1] ** 2 / 3 + p[2] ** 2 / 4

units = {**dict.fromkeys(q, "rad"), **dict.fromkeys(p, "kg m²/s")}
target = {q[0]: sp.pi / 6, q[1]: sp.pi / 8, q[2]: -sp.pi / 5, **dict.fromkeys(p, 0)}
xi = sp.symbols("xi1:4", real=True)
Jc, Rc = sp.zeros(3, 3), sp.zeros(3, 3)
Gc = kinematics(xi)
