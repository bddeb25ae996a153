"""Casimirs kept: ξ is read off x, and what is kept of it moves by damping alone.

Where outputs are rates of functions of the states (``casimirs/outputs.py``), ξ = γ(x) + k with
k̇ = Gc v_c under every input. At a sample, s after the last one,

    ξ = γ(x) + k,   then m times  k += (s/m) Gc v_c(x, ξ),  ξ = γ(x) + k,   then u.

Without coupling v_c = −Dc w, w = Gcᵀ∂V/∂ξ. With ∂²V/∂ξ² ⪯ B for all arguments a step of length h
changes V by −h wᵀDc w + ½h² (Gc Dc w)ᵀB̃(Gc Dc w) at most, B̃ ⪯ B: by −½h wᵀDc w or less if hL ≤ 1,
L the largest λ with det(DcᵀGcᵀBGcDc − λ sym Dc) = 0. docs/theory.md#kept-casimirs
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.outputs import integrated_outputs, refuse_kept
from necc_casadi.certificate.prover.arithmetic.hessian_floor import hessian_ceiling
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.designs.design import Design
from necc_casadi.errors import OptionError
from necc_casadi.lyapunov.sympy2casadi import casadi_function

__all__ = ["KeptCasimirs", "kept_casimirs"]


#: Steps of ξ in one sample, at most.
_MOST_STEPS = 1000


#: The share of L that is added for the rounding of eigenvalues.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class KeptCasimirs:
    """What the code needs to keep the Casimirs."""

    gamma: ca.Function  # x -> γ, (nc,)
    rate: ca.Function  # (what is measured, ξ) -> Gc v_c, (nc,)
    fastest: float  # L, 1/s

    def steps(self, time: float) -> int:
        """The least m with (time/m) L < 1; `time` in s."""
        return math.floor(time * self.fastest) + 1

    def checked_steps(self, time: float) -> int:
        """The same, refused where it is more than code can be asked for.

        Raises
        ------
        OptionError
            Naming the sample time that would do.
        """
        steps = self.steps(time)
        if steps > _MOST_STEPS:
            raise OptionError(
                "usage",
                f"--integrator casimir: {time:g} s take {steps} steps of ξ",
                f"At most {_MOST_STEPS} are taken: a --sample-time up to "
                f"{_MOST_STEPS / self.fastest:.2g}.",
            )
        return steps


@lru_cache(maxsize=8)
def kept_casimirs(design: Design) -> KeptCasimirs:
    """What is kept of ξ in this design, and how fast damping moves it.

    Raises
    ------
    OptionError
        Where an output is not the rate of a function of the states, or the curvature of V in ξ has
        no bound.
    """
    gamma = integrated_outputs(design.loop, design.casimirs.functions)
    V, terms = design.lyapunov, design.lyapunov.terms
    y, xi = ca.MX.sym("x", terms.n), ca.MX.sym("xi", terms.nc)
    slope = ca.vertcat(terms.measured.grad_H(y), ca.DM(terms.nc, 1))
    integrated = terms.own_structure(ca.vertcat(terms.measured.state(y), xi)) @ slope
    rate = ca.densify(V.measured_law_function.call([y, xi])[1] - integrated)
    return KeptCasimirs(
        casadi_function("gamma", design.loop.plant.x, list(gamma)),
        ca.Function("rate", [y, xi], [rate]),
        _fastest(design.natural) / design.units.time,
    )


def _fastest(design: Design) -> float:
    """L in natural units."""
    terms, form = design.lyapunov.terms, design.form
    if form.phi is not None or form.betas:
        refuse_kept("the curvature of V in ξ is bounded for Φ = H + Hc + K(c₁, …, c_r) alone")
    z = ca.SX.sym("z", terms.n + terms.nc)
    slopes = ca.Function("A", [z], [ca.jacobian(terms.c(z), z)[:, terms.n :]])
    A = np.asarray(slopes(design.z_bar), float)  # constant
    of_hc, of_k = design.form.split(design.weights)[:2]
    B = hessian_ceiling(form.hc, of_hc) + _seen(hessian_ceiling(form.k, of_k), A)
    Gc = np.asarray(terms.own_ports(design.z_bar), float)[:, terms.m :]  # constant
    Dc = design.Dc
    return _largest(_seen(B, Gc @ Dc), (Dc + Dc.T) / 2)


def _seen(B: Interval, A: Vector) -> Interval:
    """AᵀBA."""
    return matmul(point(A.T), matmul(B, point(A)))


def _largest(B: Interval, D: Vector) -> float:
    """A number above every λ with det(B − λD) = 0, D ≻ 0."""
    values, vectors = np.linalg.eigh(D)
    root = vectors / np.sqrt(values)
    middle, radius = (B.lo + B.hi) / 2, (B.hi - B.lo) / 2
    seen = root.T @ (middle + middle.T) / 2 @ root
    rest = np.abs(root).T @ radius @ np.abs(root)
    largest = float(np.linalg.eigvalsh(seen)[-1] + np.linalg.norm(rest))
    return (1 + _ROUNDING) * max(largest, 0.0)
