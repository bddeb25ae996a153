"""Mistakes that the type checker has to see; it reads this file, nothing runs it.

Each line with a comment is wrong. Where the checker no longer sees that, the comment is left over
and ``warn_unused_ignores`` reports it.
"""

import casadi as ca
import flint
import numpy as np
import sympy as sp
from flint import arb, arb_mat, fmpq, nmod_mat

from necc_casadi.arrays import Vector
from necc_casadi.certificate.checker.arithmetic.balls import evaluate
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.lyapunov.networks import Network


def balls(x: arb, A: arb_mat, residues: nmod_mat) -> None:
    x + "1"  # type: ignore[operator]
    x.sinus()  # type: ignore[attr-defined]
    A + x  # type: ignore[operator]
    A * residues  # type: ignore[operator]
    A[0]  # type: ignore[index]
    A.T  # type: ignore[attr-defined]
    A.tolist()[0] + x  # type: ignore[operator]
    arb(np.zeros(2))  # type: ignore[arg-type]
    fmpq(0.5)  # type: ignore[arg-type]
    flint.ctx.precision = 64  # type: ignore[attr-defined]
    flint.qqbar(1)  # type: ignore[attr-defined]


def rounded(x: arb) -> float:
    return x  # type: ignore[return-value]


def casadi_symbols(x: ca.MX, s: ca.SX, numbers: ca.DM, f: ca.Function) -> None:
    x + "1"  # type: ignore[operator]
    x * s  # type: ignore[operator]
    x.tanh()  # type: ignore[attr-defined]
    float(x)  # type: ignore[arg-type]
    ca.tanh("x")  # type: ignore[type-var]
    ca.vertcat(x, s)  # type: ignore[call-overload]
    ca.jacobian(x, s)  # type: ignore[type-var]
    ca.gradient(numbers, numbers)  # type: ignore[type-var]
    list(f(x))  # type: ignore[call-overload]
    ca.Function("f", [x], [s])  # type: ignore[list-item]
    ca.Function("f", [numbers], [x])  # type: ignore[list-item]
    f.jacobian()  # type: ignore[attr-defined]
    ca.hessian(x, x) @ x  # type: ignore[operator]
    ca.norm(x)  # type: ignore[attr-defined]


def expressions(f: sp.Expr, fixed: sp.ImmutableMatrix, q: sp.Symbol) -> None:
    f + "q"  # type: ignore[operator]
    f.derivative(q)  # type: ignore[attr-defined]
    f.p  # type: ignore[attr-defined]
    f.exp  # type: ignore[attr-defined]
    fixed[0, 0] = f  # type: ignore[index]
    fixed + f  # type: ignore[operator]
    sp.diff(f, "q")  # type: ignore[arg-type]
    sp.sen(f)  # type: ignore[attr-defined]
    assert f.evalf() < "1"  # type: ignore[operator]


def negative(f: sp.Expr) -> bool:
    return f < 0  # type: ignore[return-value]


def written(fixed: sp.ImmutableMatrix) -> sp.Matrix:
    return fixed  # type: ignore[return-value]


def the_house(f: sp.Expr, V: LyapunovFunction, net: Network, z: Vector, s: ca.SX) -> None:
    evaluate(f, {}) + "1"  # type: ignore[operator]
    V.V(z).eigenvalues()  # type: ignore[attr-defined]
    V.terms.M(z) + "1"  # type: ignore[operator]
    net(ca.DM(V.weights), s)  # type: ignore[arg-type]
    V.form.split("w")  # type: ignore[type-var]
