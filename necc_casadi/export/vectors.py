"""Test vectors for the C code: the control law and one step, evaluated by CasADi in double."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Integrator
from necc_casadi.designs.design import Design
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.source import Source
from necc_casadi.export.templating import fill
from necc_casadi.lyapunov.limits import share

__all__ = ["TOLERANCE", "next_state", "reference_step", "vector_table"]


#: Error that a vector allows, relative to the natural size of an output and what cancels in it.
TOLERANCE = {"double": 1e-12, "float": 1e-4}


_COUNT = 16


_SATURATED = 1


#: (x, s, dt, x at the next sample) -> s there.
Next = Callable[[Vector, Vector, float, Vector], Vector]


def next_state(source: Source) -> Next:
    """What one sample makes of the state, in double precision; x as it is measured."""
    kept = source.kept
    if kept is None:
        step = reference_step(source.design, source.integrator)
        return lambda x, s, dt, _: np.asarray(step.call([x, s, dt])[1], float).ravel()
    V, m = source.design.lyapunov, source.substeps

    def gamma(x: Vector) -> Vector:
        return np.asarray(kept.gamma(V.state(x)), float).ravel()

    left = share_of_damping(source.design)

    def after(x: Vector, s: Vector, dt: float, x_next: Vector) -> Vector:
        tau = float(left(x, s)) if source.scales_rate else 1.0
        xi, h = s - gamma(x) + gamma(x_next), min(dt, source.longest_due) / m
        for _ in range(m):
            xi = xi + tau * h * np.asarray(kept.rate(x_next, xi), float).ravel()
        return xi

    return after


def reference_step(design: Design, integrator: Integrator) -> ca.Function:
    """(x, s, dt) -> (u, s after dt): one sample with the measured x held; u without its limits."""
    terms, law = design.lyapunov.terms, design.lyapunov.measured_law_function
    x, xi, dt = ca.MX.sym("x", terms.n), ca.MX.sym("xi", terms.nc), ca.MX.sym("dt")
    u, share = law.call([x, xi])[0], share_of_damping(design).call([x, xi])[0]
    resting = design.lyapunov.resting.measured_law_function

    def rate(s: ca.MX) -> ca.MX:
        known = law.call([x, s])[1]
        if not design.scales_damping:
            return known
        return known - (1 - share) * (known - resting.call([x, s])[1])

    k1 = rate(xi)
    if integrator == "euler":
        after = xi + dt * k1
    elif integrator == "heun":
        after = xi + dt / 2 * (k1 + rate(xi + dt * k1))
    else:
        k2 = rate(xi + dt / 2 * k1)
        k3 = rate(xi + dt / 2 * k2)
        after = xi + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rate(xi + dt * k3))
    return ca.Function("necc_step", [x, xi, dt], [u, after])


@lru_cache(maxsize=4)
def share_of_damping(design: Design) -> ca.Function:
    """(x, s) -> what limits of u leave of the damping, at what is measured; 1 where they clip u."""
    V, limits = design.lyapunov, design.loop.plant.u_limits
    x, s = ca.MX.sym("x", V.terms.n), ca.MX.sym("xi", V.terms.nc)
    tau = ca.MX(1)
    if limits is not None and design.scales_damping:
        u, resting = (of.measured_law_function.call([x, s])[0] for of in (V, V.resting))
        low, high = np.array(limits, float).T
        tau = share(resting, u - resting, ca.DM(low), ca.DM(high))
    return ca.Function("share", [x, s], [tau])


def rounding_scales(design: Design) -> ca.Function:
    """(x, s, dt) -> what rounding in u, ṡ and s after dt is relative to, each one of its size.

    The natural size, which the networks' own terms have, and the magnitudes of the terms that
    Lemma 1 adds up: u may be the small difference of large ones.
    """
    V, terms, sizes = design.lyapunov, design.lyapunov.terms, design.sizes
    w, form = ca.DM(design.weights), design.form
    x, s, dt = ca.MX.sym("x", terms.n), ca.MX.sym("s", terms.nc), ca.MX.sym("dt")
    z = ca.MX.sym("z", terms.n + terms.nc)
    xi, c, e = z[terms.n :], ca.MX.sym("c", terms.r), ca.MX.sym("e")
    C = form.casimir(w)(c)
    k = ca.MX.sym("k")
    outer = ca.Function("outer", [e, k], [ca.gradient(form.outer(w)(e, k), k)])
    gamma = ca.Function("gamma", [e, c], [outer(e, C) * ca.gradient(C, c)])
    grad_Hc = ca.gradient(form.controller_energy(w)(xi), z)[terms.n :]
    energy = terms.H(z[: terms.n]) + form.controller_energy(w)(xi)
    pull = ca.fabs(gamma(energy, terms.c(z)))
    slopes = ca.fabs(ca.jacobian(terms.c(z), z)).T @ pull
    slope = ca.fabs(ca.vertcat(terms.grad_H(z[: terms.n]), grad_Hc))
    passive = ca.fabs(terms.ports(z)).T @ (V.phi_slope_function(z) * slope + slopes)
    injected = ca.DM(abs(design.damping)) @ passive
    u = ca.fabs(terms.feedback(z)) @ slope[terms.n :] + injected[: terms.m]
    if terms.preliminary is not None:
        x_of, given = z[: terms.n], ca.MX.sym("u", terms.m)
        gain = ca.jacobian(terms.preliminary(x_of, given), given)
        u = ca.fabs(ca.substitute(gain, given, u)) @ u
        u = u + ca.fabs(terms.preliminary(x_of, ca.DM(terms.m, 1)))
    u = u + ca.DM(sizes.input)
    size = ca.DM(sizes.state[terms.n :])
    moved = ca.fabs(terms.own_structure(z)) @ slope + ca.fabs(terms.own_ports(z)) @ injected
    rate = moved + size / sizes.time
    held = size + ca.fabs(xi) + ca.fabs(s) + dt * rate
    u, rate, held = ca.substitute([u, rate, held], [z], [ca.vertcat(x, s + terms.gamma(x))])
    return ca.Function("scales", [x, s, dt], [u, rate, held])


def vector_table(source: Source) -> str:
    """``test_vectors.h``: z*, then points of the middle half of the domain."""
    design, real, n = source.design, source.number, source.n
    rng = np.random.default_rng(0)
    lo, hi = design.domain.lo, design.domain.hi
    following, scales = next_state(source), _scales(source)
    V, law = design.lyapunov, design.lyapunov.measured_law_function
    rows = []
    first = real.rounded(V.measured(design.z_star[:n]))
    for index in range(_COUNT):
        inside = rng.uniform(0.75 * lo + 0.25 * hi, 0.25 * lo + 0.75 * hi)
        z = inside if index > 0 else design.z_star
        x = real.rounded(V.measured(z[:n]))
        s = real.rounded(V.stored(z[:n], z[n:]))
        dt = float(real.rounded(np.array(source.step_time * (1 + index % 3) / 3)))
        u, rate = (np.asarray(v, float).ravel() for v in law.call([x, s]))
        after = following(x, s, dt, first)
        limited, flags = _limited(design, x, s, u)
        outputs = [u, rate, limited, after, *scales(V.state(x), s, dt, after)]
        rows.append(_row([x, s], outputs, dt, flags, real))
    text = fill(
        "test_vectors.h",
        count=_COUNT,
        tolerance=f"{TOLERANCE[real.name]:g}",
        vectors=",\n".join(rows),
    )
    return source.named(text)


def _scales(source: Source) -> Callable[[Vector, Vector, float, Vector], list[Vector]]:
    """(State, s, dt, s at the next sample) -> scales of u, of ṡ and of s there."""
    design, kept, n = source.design, source.kept, source.n
    scales = rounding_scales(design)

    def at(x: Vector, s: Vector, dt: float, after: Vector) -> list[Vector]:
        found = [np.asarray(v, float).ravel() for v in scales.call([x, s, dt])]
        if kept is not None:  # x jumps, ξ with it, and then damping moves it
            first = design.z_star[:n]
            found[2] += np.asarray(scales.call([first, after, dt])[2], float).ravel()
            found[2] += sum(np.abs(np.asarray(kept.gamma(v), float).ravel()) for v in (x, first))
        return found

    return at


def _limited(design: Design, x: Vector, s: Vector, u: Vector) -> tuple[Vector, int]:
    """U within its limits, and the flags of a sample, at what is measured and kept."""
    limits = design.loop.plant.u_limits
    if limits is None:
        return u, 0
    left = float(share_of_damping(design)(x, s))
    pull = u - np.asarray(design.lyapunov.resting.measured_law_function.call([x, s])[0]).ravel()
    limited = np.clip(u - (1 - left) * pull, *np.array(limits, float).T)
    return limited, _SATURATED if np.any(limited != u) else 0


def _row(
    inputs: Sequence[Vector], outputs: Sequence[Vector], dt: float, flags: int, real: Real
) -> str:
    double = Real("double")
    fields = [f"{{{real.literals(group)}}}" for group in inputs] + [real.literal(dt)]
    fields += [f"{{{double.literals(group)}}}" for group in outputs]
    return "    {" + ",\n     ".join(fields) + f", {flags}}}"
