"""What the type checker has to know of the types that pass through the house; nothing runs it."""

from typing import assert_type

import casadi as ca
import sympy as sp
from flint import arb, arb_mat, fmpq, fmpq_mat

from necc_casadi.arrays import Vector
from necc_casadi.certificate.checker.arithmetic.balls import evaluate
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.arithmetic.potential import Energy, hessian_hull
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.symbolic.arb import ball
from necc_casadi.symbolic.derivatives import gradient


def certain(x: arb, A: arb_mat, q: fmpq_mat) -> None:
    assert_type(2 * x / 3 - 1, arb)
    assert_type(abs(x).sqrt().union(x), arb)
    assert_type(x < 1, bool)
    assert_type(A * A * x / 2, arb_mat)
    assert_type(A.inv().tolist()[0][0], arb)
    assert_type(q.det(), fmpq)
    assert_type(sum([x], arb(0)), arb)


def symbols(x: ca.MX, s: ca.SX, n: ca.DM, v: Vector) -> None:
    assert_type(v * x + n @ x, ca.MX)
    assert_type(ca.vertcat(n, 1.0, v), ca.DM)
    assert_type(ca.vertcat(x, n), ca.MX)
    assert_type(ca.vertcat(n, s), ca.SX)
    assert_type(ca.hessian(s, s), tuple[ca.SX, ca.SX])
    assert_type(ca.dot(n, x), ca.MX)
    f = ca.Function("f", [x], [x[0], ca.tanh(x)])
    assert_type(f.call([s]), list[ca.SX])
    assert_type(f.map(3)(x), ca.MX)
    assert_type(f(x0=v), dict[str, ca.DM])


def exact(f: sp.Expr, q: sp.Symbol, M: sp.Matrix, fixed: sp.ImmutableMatrix) -> None:
    assert_type(1 - f**2 / 2, sp.Expr)
    assert_type(sp.diff(sp.sin(f), q).free_symbols, set[sp.Symbol])
    assert_type(M * fixed, sp.ImmutableMatrix)
    assert_type((M + M.T)[0, 0], sp.Expr)
    assert_type(M[:, 0], sp.Matrix)
    assert_type(f.is_positive, bool | None)
    if isinstance(f, sp.Pow):
        assert_type(f.exp, sp.Expr)


def the_house(V: LyapunovFunction, energy: Energy, net: Net, stored: StoredDesign) -> None:
    z, x = ca.MX.sym("z", 2), sp.Symbol("x")
    assert_type(V(z), ca.MX)
    assert_type(V.form.split(z)[0], ca.MX)
    assert_type(V.form.split(V.weights)[0], Vector)
    assert_type(evaluate(sp.sin(x), {x: arb(1)}), arb)
    assert_type(ball(sp.pi, {}), arb)
    assert_type(gradient(x**2, [x])[0], sp.Expr)
    assert_type(hessian_hull(energy, ((0.0, 1.0),)), arb_mat)
    assert_type(net.layers[0][0], arb_mat)
    assert_type(stored.named_bounds[0][0], float)
