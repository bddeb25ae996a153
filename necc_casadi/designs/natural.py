"""A design in natural units: the same loop, networks and damping, measured otherwise, exactly.

    Ĥc = Hc/E,  K̂(ĉ) = K(c)/E with ĉ = c/S_c,  V̂ = V/E,
    𝒟̂ᵢⱼ = 𝒟ᵢⱼ pⱼ/eᵢ with e = (U, Y), p = (Y, U), Y = E/(T U)

Weights of a network change by factors alone: the first layer by the size of its input, the output
layer and κ by the energy, centres by the size of the input. Where every factor is a power of two
nothing is rounded. The logarithms in a neural Φ would be: it keeps the model's unit of energy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.parts import Parts
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.rescale import exactly, rescaled_functions, rescaled_loop
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.model.sizes import Sizes
from necc_casadi.verdict.verdict import Verdict

__all__ = [
    "damping_units",
    "natural_ceiling",
    "natural_parts",
    "natural_verdict",
    "rescaled_casimirs",
    "units_for",
    "weight_units",
]


def units_for(sizes: Sizes, form: Form) -> Sizes:
    """The powers of two in which a design of this form is exact."""
    return sizes.units if form.phi is None else replace(sizes.units, energy=1.0)


def rescaled_casimirs(casimirs: Casimirs, loop: ClosedLoop, units: Sizes) -> Casimirs:
    """The Casimirs as functions of ẑ, in units of their own."""
    return replace(casimirs, functions=rescaled_functions(casimirs.functions, loop, units))


def weight_units(form: Form, units: Sizes) -> Vector:
    """σ with weights = σ∘ŵ, (form.size,)."""
    n = len(units.state) - form.hc.inputs
    parts = [form.hc.units(units.state[n:], units.energy)[0]]
    parts.append(form.k.units(np.ones(1) if form.betas else units.casimir, units.energy)[0])
    parts += [b.units(units.casimir[i : i + 1], 1.0)[0] for i, b in enumerate(form.betas)]
    if form.phi is not None:
        parts.append(np.ones(form.phi.size))
    return np.concatenate(parts)


def damping_units(loop: ClosedLoop, units: Sizes) -> Vector:
    """Units of 𝒟, which gives (v, v_c) for 𝒢ᵀ∇V, (m + channels)².

    In the published loop these are in the units of (u, y) and of (y, u); in one of power shaping
    v_c is a rate of ξ.
    """
    output, inner = units.output, units.state[loop.plant.n :]
    rates = inner / units.time if isinstance(loop, ShapedLoop) else output
    given = np.concatenate([units.input, rates])
    taken = np.concatenate([output, units.energy / (units.time * rates)])
    return np.asarray(given[:, None] / taken, float)


def natural_verdict(verdict: Verdict, units: Sizes, n: int) -> Verdict:
    """The verdict in other units; a_max is that of the curvature in hand."""
    state, energy = exactly(units.state), exactly(np.array([units.energy]))[0]
    lam = verdict.lam
    if lam is not None and len(lam) == len(units.casimir):
        sizes = exactly(units.casimir)
        lam = tuple(v * c / energy for v, c in zip(lam, sizes, strict=True))
    xi = verdict.xi_star
    W = verdict.invisible
    W = sp.ImmutableMatrix(W.rows, W.cols, lambda i, j: W[i, j] / state[i])
    curvature = None if verdict.curvature is None else verdict.curvature / energy
    return replace(
        verdict,
        lam=lam,
        xi_star=None if xi is None else tuple(v / s for v, s in zip(xi, state[n:], strict=True)),
        invisible=W,
        curvature=curvature,
        a_max=natural_ceiling(verdict, units),
    )


def natural_ceiling(verdict: Verdict, units: Sizes) -> float | None:
    """Least eigenvalue, in these units, of the curvature that no network adds to; None: no ceiling.

    With several Casimirs it is that of the combination in hand, which may not be the best.
    """
    if verdict.a_max is None or verdict.curvature is None or not verdict.invisible.cols:
        return None
    W, curvature = (
        np.array(sp.Matrix(m).evalf(20), float) for m in (verdict.invisible, verdict.curvature)
    )
    basis = W / units.state[: len(W), None]
    whiten = np.linalg.inv(np.linalg.cholesky(basis.T @ basis))
    return float(np.linalg.eigvalsh(whiten @ curvature @ whiten.T / units.energy)[0])


def natural_parts(parts: Parts) -> Parts:
    """The design in units of its own: all its units are 1."""
    units, plant = parts.units, parts.loop.plant
    state = exactly(units.state)
    casimirs = rescaled_casimirs(parts.casimirs, parts.loop, units)
    curvature, gain = parts.curvature, parts.initial_gain
    relative = units.state[: plant.n] / units.state[plant.n :, None]
    return replace(
        parts,
        initial_gain=None if gain is None else gain * relative,
        integral=None if parts.integral is None else parts.integral.measured_in(units),
        loop=rescaled_loop(parts.loop, units),
        casimirs=casimirs,
        x_star=tuple(v / s for v, s in zip(parts.x_star, state[: plant.n], strict=True)),
        verdict=natural_verdict(parts.verdict, units, plant.n),
        weights=parts.weights / weight_units(parts.form, units),
        xi_star=parts.xi_star / units.state[plant.n :],
        damping=parts.damping / damping_units(parts.loop, units),
        a=float(curvature.min()),
        a_requested=float(curvature.min()),
        sizes=parts.sizes.measured_in(units),
        units=units.measured_in(units),
    )
