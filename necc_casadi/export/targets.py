"""Set-points and parameters at run time in C, moved only as far as the proof allows.

For every r and θ the set {V(·; r, θ) − V(r) ≤ c} in the box of the certificate holds solutions.
So any r for which the present state is in that set may be taken, at any time; staying needs no
test, since V falls. The governor takes the command where it can, else the largest part of the way
that halving finds. A new ξ may come with a move: V is tested with it.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.export.casadi2c import c_function
from necc_casadi.export.level_rounding import level_rounding
from necc_casadi.export.level_set import LevelSet, level_set
from necc_casadi.export.source import Source
from necc_casadi.export.templating import comment, fill

__all__ = ["moving_set", "target_code", "target_constants", "target_declarations", "target_members"]


#: Of rounding where what is measured is seen from the set-point, in spacings of the numbers.
_SHIFTS = 8.0


#: u is the same within so many spacings of the numbers next to 1, of its size.
_SAME = 64.0


@lru_cache(maxsize=4)
def moving_set(source: Source) -> LevelSet | None:
    """What is proved of set-points that move, or of parameters that are told; else None.

    None, too, where rounding may be all of the level.
    """
    found = level_set(source.design, source.certificate)
    return None if found is None or _room(source, found) is None else found


def _room(source: Source, found: LevelSet) -> tuple[float, Vector] | None:
    """The level and the half widths of the box, lower by what rounding may be; None: by all."""
    real, (low, high) = source.number, found.sides
    level = found.level - level_rounding(found, real)
    away = np.abs(found.q_star) + np.maximum(np.abs(low), np.abs(high))
    shifted = np.concatenate([away, np.abs(source.design.xi_star)]) + found.half
    half = found.half - _SHIFTS * real.eps * shifted
    return (level, half) if level > 0 and np.all(half > 0) else None


def target_constants(source: Source) -> str:
    """What ``necc.h`` defines about set-points and parameters."""
    found = moving_set(source)
    moves, told = found is not None and bool(source.design.setpoints), _told(found)
    lines = [
        f"#define NECC_HAS_TARGET {int(moves)}",
        f"#define NECC_HAS_PARAMETER {int(bool(told))}",
    ]
    if found is None:
        return "\n".join(lines)
    lines += [f"#define NECC_NR {source.n // 2} /* coordinates of the set-point */"]
    lines += [f"#define NECC_NTHETA {len(told)} /* {comment(', '.join(told))} */"] if told else []
    lines += [
        "#define NECC_OUTSIDE 8 /* of necc_set_target and necc_set_parameter, see there */",
        "#define NECC_LIMITED 16",
        "#define NECC_REFUSED 32",
        "#define NECC_UNCOVERED 64",
        "#define NECC_SWITCH_KEEP 0 /* of necc_set_switch */",
        "#define NECC_SWITCH_BUMPLESS 1",
        "#define NECC_SWITCH_LEAST 2",
    ]
    return "\n".join(lines)


def target_members(source: Source) -> str:
    """What ``necc_state`` has of them."""
    found = moving_set(source)
    if found is None:
        return ""
    told = "\n    necc_real theta[NECC_NTHETA]; /* parameters */" if _told(found) else ""
    how = "\n    int how; /* what becomes of xi: necc_set_switch */"
    return f"\n    necc_real r[NECC_NR]; /* set-point */{told}{how}"


def _told(found: LevelSet | None) -> list[str]:
    return [] if found is None else [str(s) for s in found.points.theta]


def target_declarations(source: Source) -> str:
    """What ``necc.h`` says of them."""
    found = moving_set(source)
    if found is None:
        return ""
    told = ", ".join(_told(found))
    return fill(
        "target.h",
        set_target=fill("set_target.h") if source.design.setpoints else "",
        set_parameter=fill("set_parameter.h", names=comment(told)) if told else "",
    )


def target_code(source: Source) -> dict[str, str]:
    """Pieces of ``necc.c``; empty where nothing moves."""
    found, real = moving_set(source), source.number
    names = ("target", "seen", "reset_target", "held", "see", "at", "forward")
    if found is None:
        return dict.fromkeys(names, "") | {"at": "x"}
    told, design = _told(found), source.design
    # θ as one more argument, where there is any
    pieces = {
        "theta_parameter": ", const necc_real theta[NECC_NTHETA]" if told else "",
        "theta": ", theta" if told else "",
        "comma_theta": ", theta" if told else "",
        "theta_of_state": ", state->theta" if told else "",
    }
    low, high = found.sides
    least, most, nominal = found.told
    level, half = _room(source, found) or (0.0, found.half)
    code = fill(
        "target.c",
        xi_star=real.literals(design.xi_star),
        half=real.literals(half * (1 - real.eps)),
        level=real.literal(level * (1 - real.eps)),
        rest=real.literal(found.rest),
        infinite=f"HUGE_VAL{real.suffix.upper()}",
        fabs=f"fabs{real.suffix}",
        take=fill("target_held.c" if source.kept is None else "target_kept.c"),
        u_size=real.literals(design.sizes.input),
        close=real.literal(_SAME * real.eps),
        cbrt_eps=real.literal(float(f"{real.eps ** (1 / 3):.1g}")),
        set_target=fill("set_target.c", low=real.literals(low), high=real.literals(high), **pieces)
        if design.setpoints
        else "",
        set_parameter=fill("set_parameter.c", least=real.literals(least), most=real.literals(most))
        if told
        else "",
        **pieces,
    )
    star = [f"static const necc_real r_star[NECC_NR] = {{{real.literals(found.q_star)}}};"]
    star += [f"static const necc_real theta_star[NECC_NTHETA] = {{{real.literals(nominal)}}};"] * (
        len(told) > 0
    )
    reset = "\n    (void)memcpy(state->theta, theta_star, sizeof theta_star);" if told else ""
    return {
        "seen": "\n".join([*_leaves(source, found), *star, ""]),
        "target": code,
        "reset_target": f"\n    (void)memcpy(state->r, r_star, sizeof r_star);{reset}",
        "at": "at",
        "held": "\n    necc_real at[NECC_NX], more[NECC_NU];\n    int i;",
        "see": "seen(x, state->r, at);\n    ",
        "forward": f"\n    forward(state->r{pieces['theta_of_state']}, more);"
        "\n    for (i = 0; i < NECC_NU; ++i) {\n        "
        f"{source.asked}[i] += more[i];\n    }}",
    }


def _leaves(source: Source, found: LevelSet) -> list[str]:
    real, n = source.number, source.n
    x, at = ca.SX.sym("x", n), ca.SX.sym("at", n)
    r, theta = ca.SX.sym("r", found.k), ca.SX.sym("theta", len(found.points.theta))
    known = [("theta", theta)] if _told(found) else []
    leaves = [
        c_function("seen", [("x", x), ("r", r)], [("at", found.seen(x, r))], real),
        c_function("forward", [("r", r), *known], [("u", found.forward(r, theta))], real),
        c_function(
            "energy_above", [("at", at), ("r", r), *known],
            [("E", found.energy(at, r, theta))], real,
        ),
    ]  # fmt: skip
    if known:
        leaves.append(
            c_function("unseen", [("at", at), ("r", r)], [("x", found.unseen(at, r))], real)
        )
    return leaves
