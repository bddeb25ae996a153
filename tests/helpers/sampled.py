"""The sampled loop in floating point: the scheme that is exported, the plant to high accuracy."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from necc_casadi.certificate.prover.arithmetic import tables
from necc_casadi.certificate.prover.sampled import prove


@contextmanager
def quick_proofs():
    """Proofs of the periods that are asked for, of no longer ones, and by coarser tables."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        patch.setattr(tables, "_MOST", 2**13)
        yield


def held_input(design, z):
    """u, within its limits where it has some, and ξ̇ of the law at states (B, N)."""
    n = design.loop.plant.n
    u, rate = design.control(z[:, :n], z[:, n:])
    limits = design.loop.plant.u_limits
    if limits is None:
        return u, rate
    low, high = np.array(limits).T
    if design.scales_damping:
        left = share(design, z)[:, None]
        bare = resting(design).control(z[:, :n], z[:, n:])
        u, rate = (b + left * (a - b) for a, b in zip((u, rate), bare, strict=True))
    return np.clip(u, low, high), rate


def resting(design):
    """The same without damping in u, and without all of it where ξ is coupled with that."""
    m, damping = design.loop.plant.m, design.damping.copy()
    apart = not (damping[:m, m:].any() or damping[m:, :m].any())
    damping[: m if apart else None] = 0.0
    return replace(design, damping=damping)


def share(design, z):
    """How much of the damping the limits leave at states (B, N), −y_c within them, (B,)."""
    n, limits = design.loop.plant.n, np.array(design.loop.plant.u_limits)
    bare, full = (d.control(z[:, :n], z[:, n:])[0] for d in (resting(design), design))
    v = full - bare
    room = np.where(v > 0, limits[:, 1] - bare, bare - limits[:, 0])
    with np.errstate(divide="ignore"):
        return np.minimum(1.0, (room / np.abs(v)).min(1))


def with_limits(design, limits):
    """A design of a plant with limits of u, in the units of the design."""
    plant = replace(design.loop.plant, u_limits=tuple(map(tuple, np.array(limits).tolist())))
    return replace(design, loop=replace(design.loop, plant=plant))


def limited_around(design, z, room):
    """The same with limits of u this far beyond −y_c at all of some states (B, N)."""
    n, m = design.loop.plant.n, design.loop.plant.m
    undamped = design.damping.copy()
    undamped[:m] = 0.0
    resting, _ = replace(design, damping=undamped).control(z[:, :n], z[:, n:])
    return with_limits(design, np.stack([resting.min(0) - room, resting.max(0) + room], 1))


def plant_after(design, x, u, s, steps=16):
    """x(s) with u held, by the method of Runge and Kutta; (B, n), (B, m), (B,)."""
    terms = design.lyapunov.terms

    def rate(x):
        drift = np.asarray(terms.drift(x.T)).T
        n, m = terms.n, terms.m
        g = np.asarray(terms.directions(x.T)).reshape(n, len(x), m).transpose(1, 0, 2)
        return drift + np.einsum("bij,bj->bi", g, u)

    h = (s / steps)[:, None]
    for _ in range(steps):
        a = rate(x)
        b = rate(x + h / 2 * a)
        c = rate(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
    return x


def sampled_step(design, z, s, integrator="heun", u=None):
    """z⁺ after periods s (B,), in the units of the design; u as the law has it, or as given."""
    n = design.loop.plant.n
    x, xi = z[:, :n], z[:, n:]
    law, first = held_input(design, z)
    moved = xi + s[:, None] * first
    if integrator == "heun":
        second = design.control(x, moved)[1]
        if design.scales_damping:
            bare = resting(design).control(x, moved)[1]
            second = bare + share(design, z)[:, None] * (second - bare)
        moved = xi + s[:, None] / 2 * (first + second)
    return np.hstack([plant_after(design, x, law if u is None else u, s), moved])
