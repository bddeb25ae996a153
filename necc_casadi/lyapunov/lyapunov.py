"""V = Φ(H + Hc, C), its derivatives, and its control law, in CasADi MX.

C = K(Σ βᵢ(cᵢ))  or  K(c₁, …, c_r)                         eq. casimir_parameterization
(v, v_c) = −𝒟 𝒢ᵀ∇V                                        Lemma EnergyCasimirControl
ũ  = −A∇Hc + v,  A = Gcᵀ or α;  u = ũ, or u₀(x) + B(x)ũ     control_affine.py
ṡ  = M_s∇(H + Hc) + 𝒢_s(v, v_c),  ξ = s + γ(x)             closed_loop.py, shaped_loop.py
ż  = (M/Φ₁ − 𝒢𝒟𝒢ᵀ)∇V,  M = Jcl − Rcl                      docs/theory.md#decrease

In the published loop γ = 0 and s = ξ.

References
----------
van der Schaft (2017), Proposition 7.1.8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.lyapunov.damping import without_inputs
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.measurement import Measurement
from necc_casadi.model.plant import Plant

__all__ = [
    "LyapunovFunction",
    "MeasuredTerms",
    "Terms",
    "control_law",
    "make_terms",
    "measured_law",
    "state_rate",
    "value",
]


_Symbols = TypeVar("_Symbols", ca.MX, ca.SX)


#: Weights that are known, or to be found.
_Weights = TypeVar("_Weights", ca.DM, ca.MX)


@dataclass(frozen=True, eq=False)
class MeasuredTerms:
    """What the controller measures, y, and the plant's energy in it; y = x, or (q, q̇)."""

    state: ca.Function  # y -> x
    output: ca.Function  # x -> y
    H: ca.Function  # y -> 1
    grad_H: ca.Function  # y -> n, ∇H at x


@dataclass(frozen=True, eq=False)
class Terms:
    """The plant's and the controller's symbolic terms as CasADi functions."""

    n: int  # plant states
    nc: int  # controller states
    m: int  # inputs
    channels: int  # entries of v_c
    r: int  # Casimirs
    H: ca.Function  # x -> 1
    grad_H: ca.Function  # x -> n
    c: ca.Function  # z -> r
    drift: ca.Function  # x -> n, f of ẋ = f + g u
    directions: ca.Function  # x -> n × m, g
    preliminary: ca.Function | None  # (x, ũ) -> u; None: u = ũ
    M: ca.Function  # z -> (n + nc) × (n + nc), Jcl − Rcl
    ports: ca.Function  # z -> (n + nc) × (m + channels), 𝒢
    feedback: ca.Function  # z -> m × nc, A
    gamma: ca.Function  # x -> nc, γ
    slopes: ca.Function  # x -> n × nc, ∇γ
    own_structure: ca.Function  # z -> nc × (n + nc), M_s
    own_ports: ca.Function  # z -> nc × (m + channels), 𝒢_s
    measured: MeasuredTerms


def make_terms(loop: ClosedLoop, casimirs: Casimirs) -> Terms:
    """Translate a closed loop and its closed-form Casimirs for CasADi."""
    plant = loop.plant
    H = casadi_function("H", plant.x, [plant.H])
    grad_H = casadi_function("grad_H", plant.x, plant.grad_H)
    return Terms(
        n=plant.n,
        nc=loop.controller.nc,
        m=plant.m,
        channels=loop.channels,
        r=len(casimirs.functions),
        H=H,
        grad_H=grad_H,
        c=casadi_function("c", loop.z, list(casimirs.functions)),
        drift=_drift(plant),
        directions=casadi_function("directions", plant.x, plant.directions),
        preliminary=_preliminary(plant),
        M=casadi_function("M", loop.z, loop.M),
        ports=casadi_function("ports", loop.z, loop.ports),
        feedback=casadi_function("feedback", loop.z, loop.feedback),
        gamma=casadi_function("gamma", plant.x, list(loop.gamma)),
        slopes=casadi_function("slopes", plant.x, loop.slopes),
        own_structure=casadi_function("own_structure", loop.z, loop.own_structure),
        own_ports=casadi_function("own_ports", loop.z, loop.own_ports),
        measured=_measured(plant, H, grad_H),
    )


def _measured(plant: Plant, H: ca.Function, grad_H: ca.Function) -> MeasuredTerms:
    known = Measurement(plant)
    if not known.of_velocities:
        same = casadi_function("state", plant.x, plant.x)
        return MeasuredTerms(same, same, H, grad_H)
    return MeasuredTerms(
        state=casadi_function("state", known.y, known.state),
        output=casadi_function("measure", plant.x, known.output),
        H=casadi_function("H", known.y, [known.energy]),
        grad_H=casadi_function("grad_H", known.y, known.slopes),
    )


def _drift(plant: Plant) -> ca.Function:
    """X -> f(x); (J − R) times ∇H is left a product."""
    if plant.preliminary is not None:
        return casadi_function("drift", plant.x, plant.preliminary.f)
    x = ca.SX.sym("x", plant.n)
    F = casadi_function("F", plant.x, plant.J - plant.R)
    grad_H = casadi_function("grad_H", plant.x, plant.grad_H)
    return ca.Function("drift", [x], [F(x) @ grad_H(x)])


def _preliminary(plant: Plant) -> ca.Function | None:
    """(x, ũ) -> u₀ + Bũ."""
    if plant.preliminary is None:
        return None
    x, given = ca.SX.sym("x", plant.n), ca.SX.sym("u", plant.m)
    u0 = casadi_function("u0", plant.x, plant.preliminary.u0)
    gain = casadi_function("gain", plant.x, plant.preliminary.gain)
    return ca.Function("preliminary", [x, given], [u0(x) + gain(x) @ given])


def value(
    terms: Terms,
    z: _Symbols,
    controller_energy: Callable[[_Symbols], _Symbols],
    casimir: Callable[[_Symbols], _Symbols],
    outer: Callable[[_Symbols, _Symbols], _Symbols],
) -> _Symbols:
    """V(z) = Φ(H(x) + Hc(ξ), C(c(z))) for any functions Hc, C and Φ."""
    x, xi = z[: terms.n], z[terms.n :]
    return outer(terms.H(x) + controller_energy(xi), casimir(terms.c(z)))


def control_law(
    terms: Terms,
    form: Form,
    weights: _Weights,
    damping: ca.DM | ca.MX,
    x: ca.MX,
    s: ca.MX,
) -> tuple[ca.MX, ca.MX]:
    """U (m,) and ṡ (nc,) at x (n,), s = ξ − γ(x) (nc,).

    For weights (form.size,) and 𝒟 (m + channels)².
    """
    return _law(terms, form, weights, damping, x, s, terms.H(x), terms.grad_H(x))


def measured_law(
    terms: Terms, form: Form, weights: _Weights, damping: ca.DM | ca.MX, y: ca.MX, s: ca.MX
) -> tuple[ca.MX, ca.MX]:
    """The same at what is measured, y (n,): no mass stands in it that the law does not need."""
    of = terms.measured
    return _law(terms, form, weights, damping, of.state(y), s, of.H(y), of.grad_H(y))


def _law(
    terms: Terms,
    form: Form,
    weights: _Weights,
    damping: ca.DM | ca.MX,
    x: ca.MX,
    s: ca.MX,
    H: ca.MX,
    grad_H: ca.MX,
) -> tuple[ca.MX, ca.MX]:
    """The control law with H and ∇H at x as they are known there."""
    z, e = ca.MX.sym("z", terms.n + terms.nc), ca.MX.sym("H")
    g, energy = ca.MX.sym("grad_H", terms.n), form.controller_energy(weights)
    Hc = energy(z[terms.n :])
    V = form.outer(weights)(e + Hc, form.casimir(weights)(terms.c(z)))
    grad_Hc = ca.gradient(Hc, z)[terms.n :]
    V_z = ca.gradient(V, z) + ca.gradient(V, e) * ca.vertcat(g, ca.DM(terms.nc, 1))
    injected = -damping @ terms.ports(z).T @ V_z
    u = injected[: terms.m] - terms.feedback(z) @ grad_Hc
    s_dot = terms.own_structure(z) @ ca.vertcat(g, grad_Hc) + terms.own_ports(z) @ injected
    here = ca.densify(ca.vertcat(x, s + terms.gamma(x)))
    known = [here, ca.densify(H), ca.densify(grad_H)]
    u, s_dot = ca.substitute([u, s_dot], [z, e, g], known)
    return (u if terms.preliminary is None else terms.preliminary(x, u)), s_dot


def state_rate(terms: Terms, x: ca.MX, x_dot: ca.MX, s_dot: ca.MX) -> ca.MX:
    """Ż from ẋ (n,) and ṡ (nc,): ξ̇ = ṡ + ∇γᵀẋ."""
    return ca.vertcat(x_dot, s_dot + terms.slopes(x).T @ x_dot)


@dataclass(frozen=True, eq=False)
class LyapunovFunction:
    """A trained V with its derivatives, its control law and its closed loop.

    Methods take one state (n + nc,) or many, (B, n + nc), and give arrays with that first axis;
    ``…_function`` is the same of CasADi's symbols, states in columns.
    """

    terms: Terms
    form: Form
    weights: Vector  # (form.size,)
    damping: Vector  # 2m × 2m, symmetric part ≻ 0

    def __call__(self, z: ca.MX) -> ca.MX:
        """V(z) as an MX expression."""
        w = ca.DM(self.weights)
        form = self.form
        return value(self.terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))

    @cached_property
    def resting(self) -> LyapunovFunction:
        """The same V without the damping that limits of inputs scale."""
        return replace(self, damping=without_inputs(self.damping, self.terms.m))

    def V(self, z: npt.ArrayLike) -> Vector:
        """V(z), one number for each state."""
        z = np.asarray(z, float)
        return np.asarray(self.V_function(z.T), float).reshape(z.shape[:-1])

    def gradient(self, z: npt.ArrayLike) -> Vector:
        """∇V(z), (n + nc,) for each state."""
        return _in_rows(self.gradient_function, z)

    def hessian(self, z: npt.ArrayLike) -> Vector:
        """∇²V(z), (n + nc, n + nc) for each state."""
        z = np.asarray(z, float)
        N = self.terms.n + self.terms.nc
        side_by_side = np.asarray(self.hessian_function(z.T), float)
        return side_by_side.reshape(N, -1, N).transpose(1, 0, 2).reshape(*z.shape, N)

    def phi_slope(self, z: npt.ArrayLike) -> Vector:
        """Φ₁ = ∂Φ/∂(H + Hc), one number for each state."""
        z = np.asarray(z, float)
        return np.asarray(self.phi_slope_function(z.T), float).reshape(z.shape[:-1])

    def control_law(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> tuple[Vector, Vector]:
        """Plant states (…, n), controller states (…, nc) -> u (…, m), ξ̇ (…, nc)."""
        x, xi = np.asarray(x, float), np.asarray(xi, float)
        u, z_dot = self._motion_function.call([np.concatenate([x, xi], axis=-1).T])
        shape, rates = (*xi.shape[:-1], self.terms.m), np.asarray(z_dot, float).T
        return np.asarray(u, float).T.reshape(shape), rates[..., self.terms.n :].reshape(xi.shape)

    def stored(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> Vector:
        """What the controller keeps, s = ξ − γ(x), (…, nc)."""
        return np.asarray(xi, float) - self.gamma(x)

    def gamma(self, x: npt.ArrayLike) -> Vector:
        """γ(x), (…, nc): ξ less what the controller keeps."""
        x = np.asarray(x, float)
        shape = (*x.shape[:-1], self.terms.nc)
        return np.asarray(self.terms.gamma(x.T), float).T.reshape(shape)

    def measured(self, x: npt.ArrayLike) -> Vector:
        """What the controller measures at states (…, n)."""
        return _in_rows(self.terms.measured.output, x)

    def state(self, y: npt.ArrayLike) -> Vector:
        """Plant states of what is measured, (…, n)."""
        return _in_rows(self.terms.measured.state, y)

    def vector_field(self, z: npt.ArrayLike) -> Vector:
        """Ż of the damped closed loop, (n + nc,) for each state."""
        return _in_rows(self.vector_field_function, z)

    def linearisation(self, z: npt.ArrayLike) -> Vector:
        """∂ż/∂z at one state z, (n + nc) × (n + nc)."""
        s = self._z()
        jacobian = ca.Function("A", [s], [ca.jacobian(self.vector_field_function(s), s)])
        return np.asarray(jacobian(np.asarray(z, float)), float)

    @cached_property
    def V_function(self) -> ca.Function:
        """Z -> V(z), scalar."""
        z = self._z()
        return ca.Function("V", [z], [self(z)], ["z"], ["V"])

    @cached_property
    def gradient_function(self) -> ca.Function:
        """Z -> ∇V, (n + nc,)."""
        z = self._z()
        return ca.Function("grad_V", [z], [ca.gradient(self(z), z)], ["z"], ["grad_V"])

    @cached_property
    def hessian_function(self) -> ca.Function:
        """Z -> ∇²V, (n + nc) × (n + nc)."""
        z = self._z()
        return ca.Function("hess_V", [z], [ca.hessian(self(z), z)[0]], ["z"], ["hess_V"])

    @cached_property
    def phi_slope_function(self) -> ca.Function:
        """Z -> Φ₁ = ∂Φ/∂(H + Hc), scalar."""
        z, e, c = self._z(), ca.MX.sym("e"), ca.MX.sym("c")
        w = ca.DM(self.weights)
        slope = ca.Function("slope", [e, c], [ca.gradient(self.form.outer(w)(e, c), e)])
        x, xi = z[: self.terms.n], z[self.terms.n :]
        energy = self.terms.H(x) + self.form.controller_energy(w)(xi)
        return ca.Function("phi_1", [z], [slope(energy, self.form.casimir(w)(self.terms.c(z)))])

    @cached_property
    def control_law_function(self) -> ca.Function:
        """(x, s) -> (u, ṡ) at states; s = ξ in the published loop."""
        x, s = ca.MX.sym("x", self.terms.n), ca.MX.sym("xi", self.terms.nc)
        weights, damping = ca.DM(self.weights), ca.DM(self.damping)
        u, s_dot = control_law(self.terms, self.form, weights, damping, x, s)
        return ca.Function("necc", [x, s], [u, s_dot], ["x", "xi"], ["u", "xi_dot"])

    @cached_property
    def measured_law_function(self) -> ca.Function:
        """(y, s) -> (u, ṡ), the exported controller; y is what it measures, s = ξ − γ(x)."""
        y, s = ca.MX.sym("x", self.terms.n), ca.MX.sym("xi", self.terms.nc)
        weights, damping = ca.DM(self.weights), ca.DM(self.damping)
        u, s_dot = measured_law(self.terms, self.form, weights, damping, y, s)
        return ca.Function("necc", [y, s], [u, s_dot], ["x", "xi"], ["u", "xi_dot"])

    @cached_property
    def vector_field_function(self) -> ca.Function:
        """Z -> ż of the damped closed loop, plant and controller as they are built."""
        z = self._z()
        return ca.Function("loop", [z], [self._motion_function.call([z])[1]], ["z"], ["z_dot"])

    @cached_property
    def _motion_function(self) -> ca.Function:
        """Z -> (u, ż)."""
        terms, z = self.terms, self._z()
        x, xi = z[: terms.n], z[terms.n :]
        u, s_dot = self.control_law_function.call([x, xi - terms.gamma(x)])
        x_dot = terms.drift(x) + terms.directions(x) @ u
        return ca.Function("motion", [z], [u, state_rate(terms, x, x_dot, s_dot)])

    def _z(self) -> ca.MX:
        return ca.MX.sym("z", self.terms.n + self.terms.nc)


def _in_rows(function: ca.Function, z: npt.ArrayLike) -> Vector:
    """A function from states to vectors of their length, states in rows."""
    z = np.asarray(z, float)
    return np.asarray(function(z.T), float).T.reshape(z.shape)
