"""Second routes: networks and V in plain numpy, finite differences, a fixed-step integrator."""

from collections.abc import Callable

import numpy as np
import sympy as sp

from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.networks import MonotonePhi, Network

ACTIVATE = {
    "tanh": np.tanh,
    "sin": np.sin,
    "squareplus": lambda v: 0.5 * (v + np.sqrt(v**2 + 4.0)),
}


def network(net: Network, weights, v) -> float:
    """The network's documented formula and weight layout, read element by element."""
    weights, value = list(weights), np.atleast_1d(np.asarray(v, float))
    v = value
    widths = [net.inputs, *net.hidden, 1]
    for layer in range(len(widths) - 1):
        rows, columns = widths[layer + 1], widths[layer]
        W = np.array([[weights.pop(0) for _ in range(columns)] for _ in range(rows)])
        b = np.array([weights.pop(0) for _ in range(rows)])
        value = W @ value + b
        if layer < len(net.hidden):
            value = ACTIVATE[net.activation](value)
    result = float(value[0])
    if net.quadratic:
        kappa, center = weights[: net.inputs], weights[net.inputs :]
        result += sum(0.5 * k * (s - o) ** 2 for k, s, o in zip(kappa, v, center, strict=True))
        weights = weights[2 * net.inputs :]
    assert not weights
    return result


def phi(net: MonotonePhi, weights, e: float, k: float) -> float:
    a, b, d, f = np.reshape(weights, (4, net.hidden))
    return net.delta * e + k + float(np.exp(a) @ np.tanh(np.exp(b) * e + d * k + f))


def lyapunov(design: Design) -> Callable[[np.ndarray], float]:
    """V = Φ(H + Hc, C) by sympy's own numpy printer and the networks above."""
    loop, form = design.loop, design.form
    parts = form.split(design.weights)
    energy = sp.lambdify([loop.plant.x], loop.plant.H, "numpy")
    casimirs = sp.lambdify([loop.z], list(design.casimirs.functions), "numpy")
    n = loop.plant.n

    def V(z: np.ndarray) -> float:
        total = energy(z[:n]) + network(form.hc, parts[0], z[n:])
        c = np.array(casimirs(z), float)
        if form.betas:
            c = np.array(
                [
                    sum(
                        network(beta, parts[2 + i], c[i : i + 1])
                        for i, beta in enumerate(form.betas)
                    )
                ]
            )
        C = network(form.k, parts[1], c)
        return total + C if form.phi is None else phi(form.phi, parts[-1], total, C)

    return V


def jacobian(f: Callable[[np.ndarray], np.ndarray], z: np.ndarray, h: float = 1e-3) -> np.ndarray:
    """∂f/∂z by central differences of sixth order, (len f, len z)."""
    columns = []
    for step in h * np.eye(len(z)):
        column = sum(
            weight * (np.atleast_1d(f(z + k * step)) - np.atleast_1d(f(z - k * step)))
            for k, weight in ((1, 45 / 60), (2, -9 / 60), (3, 1 / 60))
        )
        columns.append(column / h)
    return np.column_stack(columns)


def hessian(f: Callable[[np.ndarray], float], z: np.ndarray, h: float = 2e-2) -> np.ndarray:
    """∇²f by sixth-order differences of sixth-order differences."""
    return jacobian(lambda s: jacobian(f, s, h).ravel(), z, h)


def rk4(f: Callable[[np.ndarray], np.ndarray], z: np.ndarray, T: float, steps: int) -> np.ndarray:
    """z(T) of ż = f(z) by the classical Runge–Kutta method."""
    h = T / steps
    for _ in range(steps):
        k1 = f(z)
        k2 = f(z + h / 2 * k1)
        k3 = f(z + h / 2 * k2)
        k4 = f(z + h * k3)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return z
