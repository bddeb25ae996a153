"""Induction motor at 100 rad/s under a constant load torque, fed with voltages.

The frame turns with the flux of the rotor. No energy is needed: the model is ẋ = f + G u.
Source: Leonhard, Control of Electrical Drives (1985), for the model in the coordinates of the rotor
flux, with numbers typical of a motor of 1.5 kW.
Try: necc-design induction_motor.py
"""

import sympy as sp

i_d, i_q, psi, omega = sp.symbols("i_d i_q psi omega", real=True)  # currents, rotor flux, speed
stator, rotor = sp.Rational("4.85"), sp.Rational("3.805")  # Ω
own, mutual, pairs = sp.Rational("0.274"), sp.Rational("0.258"), 2  # H
inertia, friction, load = sp.Rational("0.031"), sp.Rational("0.008"), 2  # kg m², N m s, N m

leakage = own - mutual**2 / own  # H
decay = rotor / own  # 1/s, of the rotor's flux
loss = stator + rotor * mutual**2 / own**2  # Ω, seen from the stator
turning = pairs * omega + decay * mutual * i_q / psi  # rad/s, of the frame
moment = sp.Rational(3, 2) * pairs * mutual / own  # torque over ψ i_q

name = "Induction motor"
x = (i_d, i_q, psi, omega)
f = sp.Matrix(
    [
        (mutual / own * decay * psi - loss * i_d) / leakage + turning * i_q,
        (-mutual / own * pairs * omega * psi - loss * i_q) / leakage - turning * i_d,
        decay * (mutual * i_d - psi),
        (moment * psi * i_q - friction * omega - load) / inertia,
    ]
)
G = sp.Matrix([[1, 0], [0, 1], [0, 0], [0, 0]]) / leakage

units = {i_d: "A", i_q: "A", psi: "Wb", omega: "rad/s"}
flux, speed = 1, 100
target = {
    i_d: flux / mutual,
    i_q: (load + friction * speed) / (moment * flux),
    psi: flux,
    omega: speed,
}
domain = {
    i_d: (-5, 15),
    i_q: (-15, 15),
    psi: (sp.Rational("0.3"), sp.Rational("1.7")),
    omega: (0, 200),
}
