"""The sampled loop in floating point: the scheme that is exported, the plant to high accuracy."""

import numpy as np


def held_input(design, z):
    """u and ξ̇ of the law at states (B, N)."""
    n = design.loop.plant.n
    return design.control(z[:, :n], z[:, n:])


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
        moved = xi + s[:, None] / 2 * (first + second)
    return np.hstack([plant_after(design, x, law if u is None else u, s), moved])
