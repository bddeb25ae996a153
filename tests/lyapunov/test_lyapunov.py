"""V, its derivatives and the control law: numpy, finite differences, and Lemma 1's two forms."""

import dataclasses

import numpy as np
import pytest
import sympy as sp
from helpers import reference

from necc_casadi.lyapunov.lyapunov import LyapunovFunction


def test_V_is_phi_of_H_plus_Hc_and_C(any_design, points):
    V = reference.lyapunov(any_design)
    for z in points(any_design):
        assert any_design.V(z) == pytest.approx(V(z), rel=1e-11, abs=1e-11)


def test_gradient_and_hessian_by_finite_differences(any_design, points):
    V = reference.lyapunov(any_design)
    for z in points(any_design, 3, 0.5):
        gradient = np.asarray(any_design.lyapunov.gradient(z)).ravel()
        hessian = np.asarray(any_design.lyapunov.hessian(z))
        np.testing.assert_allclose(gradient, reference.jacobian(V, z).ravel(), atol=1e-8)
        np.testing.assert_allclose(hessian, reference.hessian(V, z), atol=2e-6)
        assert np.array_equal(hessian, hessian.T)


def test_the_neural_C_is_a_casimir(any_design, points):
    """eq. CasimirCondition for K(…): ∇Cᵀ(Jcl − Rcl) = 0, with ∇C from V by differences in Φ."""
    loop, form = any_design.loop, any_design.form
    parts = form.split(any_design.weights)
    casimirs = sp.lambdify([loop.z], list(any_design.casimirs.functions), "numpy")

    def C(z):
        c = np.array(casimirs(z), float)
        if form.betas:
            c = np.array([sum(reference.network(b, parts[2 + i], c[i : i + 1])
                              for i, b in enumerate(form.betas))])  # fmt: skip
        return reference.network(form.k, parts[1], c)

    M = sp.lambdify([loop.z], sp.Matrix(loop.M), "numpy")
    for z in points(any_design):
        slope = reference.jacobian(C, z).ravel()
        assert np.linalg.norm(slope) > 1e-3
        np.testing.assert_allclose(slope @ np.asarray(M(z), float), 0, atol=1e-8)


def closed_loop_of_lemma_1(made, z):
    """ẋ = (J−R)∇H + Gu, u = −Gcᵀ∇Hc + v;  ξ̇ = (Jc−Rc)∇Hc + Gc(Gᵀ∇H + v_c), from numpy alone."""
    plant, controller, n = made.loop.plant, made.loop.controller, made.loop.plant.n
    at = dict(zip(made.loop.z, map(float, z), strict=True))
    J, R, G = (np.array(sp.Matrix(m).subs(at).evalf(), float) for m in (plant.J, plant.R, plant.G))
    Jc, Rc, Gc = (
        np.array(sp.Matrix(m).subs(at).evalf(), float)
        for m in (controller.Jc, controller.Rc, controller.Gc)
    )
    energy = sp.lambdify([plant.x], plant.H, "numpy")
    theta = made.form.split(made.weights)[0]
    grad_H = reference.jacobian(energy, z[:n]).ravel()
    grad_Hc = reference.jacobian(
        lambda xi: reference.network(made.form.hc, theta, xi), z[n:]
    ).ravel()
    grad_V = reference.jacobian(reference.lyapunov(made), z).ravel()
    v, v_c = np.split(
        -made.damping @ np.concatenate([G.T @ grad_V[:n], Gc.T @ grad_V[n:]]), [plant.m]
    )
    u = -Gc.T @ grad_Hc + v
    x_dot = (J - R) @ grad_H + G @ u
    xi_dot = (Jc - Rc) @ grad_Hc + Gc @ (G.T @ grad_H + v_c)
    return u, np.concatenate([x_dot, xi_dot])


def test_plant_and_controller_as_the_paper_wires_them(any_design, points):
    n = any_design.loop.plant.n
    for z in points(any_design):
        u, z_dot = closed_loop_of_lemma_1(any_design, z)
        control, xi_dot = any_design.control(z[:n], z[n:])
        field = np.asarray(any_design.lyapunov.vector_field(z)).ravel()
        np.testing.assert_allclose(control, u, atol=1e-6)
        np.testing.assert_allclose(xi_dot, z_dot[n:], atol=1e-6)
        np.testing.assert_allclose(field, z_dot, atol=1e-6)


def test_the_two_forms_of_the_loop_agree(any_design, points):
    """ż = (M/Φ₁ − 𝒢𝒟𝒢ᵀ)∇V, because M∇C = 0 (theory of the damped loop)."""
    loop, V = any_design.loop, any_design.lyapunov
    ports = sp.lambdify([loop.z], sp.Matrix(loop.ports), "numpy")
    M = sp.lambdify([loop.z], sp.Matrix(loop.M), "numpy")
    damping = any_design.damping
    for z in points(any_design, 8):
        gradient = np.asarray(V.gradient(z)).ravel()
        P = np.asarray(ports(z), float)
        expected = (np.asarray(M(z), float) / float(V.phi_slope(z)) - P @ damping @ P.T) @ gradient
        np.testing.assert_allclose(
            np.asarray(V.vector_field(z)).ravel(), expected, rtol=1e-9, atol=1e-9
        )


def test_phi_slope_is_what_V_gains_per_energy(designs, points):
    """Φ₁ by raising H by a constant: V(H + δ) by finite differences."""
    for name in ("neural", "beta-sum neural", "default"):
        made = designs[name]
        plant = made.loop.plant
        for z in points(made, 3):

            def raised(shift, z=z, made=made, plant=plant):
                H = plant.H + sp.Float(float(shift[0]), 30)
                lifted = dataclasses.replace(plant, H=H)
                loop = dataclasses.replace(made.loop, plant=lifted)
                return reference.lyapunov(dataclasses.replace(made, loop=loop))(z)

            slope = reference.jacobian(raised, np.zeros(1))[0, 0]
            assert float(made.lyapunov.phi_slope(z)) == pytest.approx(slope, abs=1e-8)
            assert slope > 0


def test_V_never_rises_along_the_vector_field(any_design, points):
    """V̇ = −∇Vᵀ Rcl ∇V/Φ₁ − ∇Vᵀ𝒢𝒟𝒢ᵀ∇V ≤ 0 everywhere, far from z* too, and for any damping."""
    V, loop = any_design.lyapunov, any_design.loop
    m = loop.plant.m
    ports = sp.lambdify([loop.z], sp.Matrix(loop.ports), "numpy")
    R = sp.lambdify([loop.z], sp.Matrix(loop.R), "numpy")
    rng = np.random.default_rng(3)
    for z in points(any_design, 40, 20.0, seed=1):
        root, skew = rng.normal(size=(2, 2 * m, 2 * m))
        symmetric = root @ root.T + 1e-3 * np.eye(2 * m)
        for damping in (any_design.damping, symmetric + 5 * (skew - skew.T)):
            made = LyapunovFunction(V.terms, V.form, V.weights, damping)
            gradient = np.asarray(made.gradient(z)).ravel()
            rate = gradient @ np.asarray(made.vector_field(z)).ravel()
            seen = np.asarray(ports(z), float).T @ gradient
            lost = gradient @ np.asarray(R(z), float) @ gradient / float(made.phi_slope(z))
            expected = -lost - seen @ (damping + damping.T) @ seen / 2
            size = 1 + gradient @ gradient * (1 + np.abs(damping).sum())
            assert rate == pytest.approx(expected, abs=1e-10 * size)
            assert rate <= 1e-10 * size


def test_linearisation_by_finite_differences(any_design):
    V = any_design.lyapunov
    for z in (any_design.z_star, any_design.z_star + 0.3):
        A = reference.jacobian(lambda s: np.asarray(V.vector_field(s)).ravel(), z)
        np.testing.assert_allclose(V.linearisation(z), A, atol=1e-7)
