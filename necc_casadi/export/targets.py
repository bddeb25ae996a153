"""``necc_set_target``: set-points at run time, moved only as far as the proof allows.

For every r of the range the set {V(·; r) − V(r) ≤ c} in the box of the certificate holds solutions.
So any r for which the present state is in that set may be taken, at any time; staying needs no
test, since V falls. The governor takes the command where it can, else the largest part of the way
that halving finds.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.export.casadi2c import c_function
from necc_casadi.export.source import Source
from necc_casadi.export.templating import fill
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.measurement import Measurement
from necc_casadi.model.setpoints import set_points
from necc_casadi.symbolic.floats import to_floats

__all__ = ["moving_claim", "target_code", "target_declarations"]


#: Of rounding in V, in spacings of the numbers next to 1: the level is lower by this share.
_ROUNDINGS = 1e3


def moving_claim(source: Source) -> Claim | None:
    """The claim about set-points, where the design has some and it is proved."""
    if not source.design.setpoints or source.certificate is None:
        return None
    claims = source.certificate.claims
    return next((claim for claim in claims if claim.name == "setpoints" and claim.holds), None)


def target_declarations(source: Source) -> str:
    """What ``necc.h`` says of set-points."""
    return fill("target.h") if moving_claim(source) is not None else ""


def target_code(source: Source) -> dict[str, str]:
    """Pieces of ``necc.c``; empty where set-points do not move."""
    claim, design = moving_claim(source), source.design
    names = ("target", "seen", "reset_target", "held", "see", "at", "forward")
    if claim is None:
        return dict.fromkeys(names, "") | {"at": "x"}
    real, k, n = source.number, source.n // 2, source.n
    plant, units = design.loop.plant, design.units
    q_star = design.z_star[:k]
    points = set_points(plant, q_star, design.setpoints)
    y, r = ca.SX.sym("x", n), ca.SX.sym("r", k)
    place = casadi_function("shift", points.r, list(points.shift))
    forward = casadi_function("forward", points.r, points.feedforward)
    tilt = casadi_function("tilt", points.r, points.tilt)
    known = Measurement(plant)
    H = casadi_function("H", known.y, [known.energy])
    e, resting = y[:k] - r, ca.vertcat(r, ca.SX(k, 1))
    energy = H(y) - H(resting) - tilt(r).T @ e
    here = ca.vertcat(y[:k] - place(r), y[k:])
    leaves = [
        c_function("seen", [("x", y), ("r", r)], [("at", here)], real),
        c_function("forward", [("r", r)], [("u", forward(r))], real),
        c_function("energy_above", [("x", y), ("r", r)], [("E", energy)], real),
    ]
    low, high = np.array([to_floats(side) for side in points.ranges]).T
    rest = design.V(design.z_star) - float(H(np.concatenate([q_star, np.zeros(k)])))
    half = np.array(claim.data["half_widths"]) * np.concatenate([units.state[:k], units.state[n:]])
    star = real.literals(q_star)
    level = claim.data["level"] * units.energy * (1 - _ROUNDINGS * real.eps)
    code = fill(
        "target.c",
        low=real.literals(low),
        high=real.literals(high),
        xi_star=real.literals(design.xi_star),
        half=real.literals(half * (1 - _ROUNDINGS * real.eps)),
        level=real.literal(level),
        rest=real.literal(rest),
    )
    return {
        "seen": "\n".join([*leaves, f"static const necc_real r_star[NECC_NR] = {{{star}}};\n"]),
        "target": code,
        "reset_target": "\n    memcpy(state->r, r_star, sizeof r_star);",
        "at": "at",
        "held": "\n    necc_real at[NECC_NX], more[NECC_NU];\n    int i;",
        "see": "seen(x, state->r, at);\n    ",
        "forward": "\n    forward(state->r, more);\n    for (i = 0; i < NECC_NU; ++i)"
        "\n        v[i] += more[i];",
    }
