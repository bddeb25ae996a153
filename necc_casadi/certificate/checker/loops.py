"""The loops that a design may have, as the checker makes them of what design.json holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import sympy as sp

__all__ = ["StoredFeedback", "StoredInterconnection", "StoredLoop", "StoredShaping"]


class StoredLoop(Protocol):
    """ż = (Jcl − Rcl)∇(H + Hc) + 𝒢(v, v_c), u = −A∇Hc + v."""

    Jcl: sp.Matrix
    Rcl: sp.Matrix
    ports: sp.Matrix  # 𝒢
    feedback: sp.Matrix  # A, m × nc
    skew: dict[str, sp.Matrix]  # must be skew-symmetric
    dissipative: dict[str, sp.Matrix]  # must be symmetric, ⪰ 0
    zero: dict[str, sp.Matrix]  # must vanish
    written: list[sp.Expr]  # everything that must be smooth


@dataclass(frozen=True, eq=False)
class StoredFeedback:
    """Feedback u = u₀(x) + B(x)ũ ahead of the loop, of a plant ẋ = f(x) + g(x)u."""

    f: sp.Matrix  # n × 1
    g: sp.Matrix  # n × m
    u0: sp.Matrix  # m × 1
    gain: sp.Matrix  # B, m × m

    @property
    def written(self) -> list[sp.Expr]:
        """Every entry."""
        return [e for matrix in (self.f, self.g, self.u0, self.gain) for e in matrix]

    @property
    def acts_alone(self) -> bool:
        """Whether B is diagonal and positive, whatever the state."""
        B, size = self.gain, range(self.gain.rows)
        alone = all(B[i, j] == 0 for i in size for j in size if i != j)
        return alone and all(B[i, i].is_positive is True for i in size)


class StoredInterconnection:
    """The published loop (eq. ClosedLoopSystem)."""

    def __init__(
        self,
        J: sp.Matrix,
        R: sp.Matrix,
        G: sp.Matrix,
        Jc: sp.Matrix,
        Rc: sp.Matrix,
        Gc: sp.Matrix,
    ) -> None:
        self.Jc, self.Rc, self.Gc = Jc, Rc, Gc
        coupling = G * Gc.T
        top, bottom = J.row_join(-coupling), coupling.T.row_join(Jc)
        self.Jcl, self.Rcl = sp.Matrix(top.col_join(bottom)), sp.diag(R, Rc)
        self.ports, self.feedback = sp.diag(G, Gc), Gc.T
        self.skew, self.dissipative = {"J": J, "Jc": Jc}, {"R": R, "Rc": Rc}
        self.zero: dict[str, sp.Matrix] = {}
        self.written = [e for matrix in (J, R, G, Jc, Rc, Gc) for e in matrix]


class StoredShaping:
    """The loop of power shaping: ξ̇ = ∇γᵀẋ + v_c and F∇γ = −Gα, F = J − R."""

    def __init__(
        self,
        J: sp.Matrix,
        R: sp.Matrix,
        G: sp.Matrix,
        x: Sequence[sp.Symbol],
        gamma: Sequence[sp.Expr],
        alpha: sp.Matrix,
    ) -> None:
        n, nc = len(x), len(gamma)
        slopes = sp.Matrix([[sp.diff(g, s) for g in gamma] for s in x])  # n × nc
        if alpha.shape != (G.cols, nc):
            raise ValueError("α needs a row for each input and a column for each of γ")
        through = sp.eye(n).col_join(slopes.T)
        self.Jcl = (through * J * through.T).applyfunc(_tidy)
        self.Rcl = (through * R * through.T).applyfunc(_tidy)
        left, right = G.col_join((slopes.T * G).applyfunc(_tidy)), sp.zeros(n, nc)
        self.ports = left.row_join(right.col_join(sp.eye(nc)))
        self.feedback = alpha
        self.skew, self.dissipative = {"J": J}, {"R": R}
        self.zero = {"(J − R)∇γ + Gα": (J - R) * slopes + G * alpha}
        self.written = [e for matrix in (J, R, G, slopes, alpha) for e in matrix] + list(gamma)


def _tidy(entry: sp.Expr) -> sp.Expr:
    return sp.expand(entry) if entry.is_polynomial() else entry
