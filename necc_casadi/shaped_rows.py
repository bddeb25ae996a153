"""The rows u = A m + b of a shaping in the training program: affine in the weights m that move."""

from __future__ import annotations

import casadi as ca

from necc_casadi.lifting import Lifting
from necc_casadi.shaping import Shaping, moving_weights

__all__ = ["Rows"]


class Rows:
    """The rows u = A ŵ[moving] + b of a shaping in the program; A and b are parameters."""

    def __init__(self, shaping: Shaping, lifting: Lifting, w: ca.MX, c: ca.MX) -> None:
        moving = moving_weights(lifting.form)
        A, b = ca.MX.sym("A", shaping.count, moving.size), ca.MX.sym("b", shaping.count)
        u, level = ca.SX.sym("u", shaping.count), ca.SX.sym("c")
        objective = shaping.objective(u, level)
        second = ca.diag(ca.hessian(objective, u)[0])
        terms = ca.Function("shape", [u, level], [objective, shaping.margins(u, level), second])
        selection = ca.DM.eye(w.numel())[moving.tolist(), :]
        self.parameters = ca.vertcat(ca.vec(A), b)
        self.objective, self.margins, second = terms(A @ (selection @ w) + b, c)
        weighted = ca.repmat(second, 1, moving.size) * A
        self.curvature = selection.T @ (A.T @ weighted) @ selection
        slopes = ca.jacobian(shaping.margins(u, level), ca.vertcat(level, u))
        at_level, at_rows = ca.DM(slopes)[:, 0], ca.sparsify(ca.DM(slopes)[:, 1:])
        self.slope = ca.horzcat(at_level, (at_rows @ A) @ selection)

    def first_derivative(self, s: ca.MX, w: ca.MX, p: ca.MX, g: ca.MX) -> dict[str, object]:
        """The Jacobian of the constraints, of these rows without differentiation.

        `g` holds the other constraints; the level is the last entry of `s`.
        """
        x = ca.vertcat(s, w)
        own = ca.horzcat(ca.MX(self.slope.size1(), s.numel() - 1), self.slope)
        jacobian = ca.vertcat(ca.jacobian(g, x), own)
        both = [ca.vertcat(g, self.margins), jacobian]
        return {"jac_g": ca.Function("jac_g", [x, p], both)}
