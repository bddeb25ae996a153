"""The analytic piece of a loop's structure on which a target lies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.pieces import Box, Piece, branches, piece_around

__all__ = ["LoopPiece", "loop_piece"]


@dataclass(frozen=True, eq=False)
class LoopPiece:
    """J, R, G, Jc, Rc, Gc as they are around a target."""

    loop: ClosedLoop  # with roots of squares and arcs of angles resolved
    piece: Piece | None = None  # where that holds; None: everywhere, or nothing is known
    changed: bool = False  # whether anything was resolved
    joined: bool = True  # what is proved of the box, or of any real point, holds at the target

    @property
    def note(self) -> str | None:
        """Where the structure is what it was taken for; None where it is as it was written."""
        if self.piece is None or not self.changed:
            return None
        limits = " and ".join(str(limit) for limit in self.piece.limits)
        return (
            "J, R and G are looked at on one side of a branch point, as around the target: what "
            f"is said of Casimirs holds there, where {limits}"
        )

    @property
    def box(self) -> Box | None:
        """Where ranks and counts are to be proved; None: anywhere."""
        return None if self.piece is None else self.piece.box


def loop_piece(loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr]) -> LoopPiece:
    """The loop on a box around x* on which no root, logarithm or arc has a branch point.

    Without such functions the entries are meromorphic: one piece, whatever the poles.
    """
    entries = [e for matrix in loop.matrices for e in matrix.todok().values() if e.free_symbols]
    if not branches(entries):
        return LoopPiece(loop)
    middle = {s: x_star.get(s, _ANYWHERE) for s in loop.z}
    piece = piece_around(entries, middle, dict.fromkeys(loop.z, sp.Integer(2)))
    if piece is None:
        return LoopPiece(loop, joined=False)
    local = loop.rewritten(piece.rewritten)
    return LoopPiece(local, piece, changed=local.M != loop.M or local.ports != loop.ports)


#: ξ* is not known yet; a value at which few expressions are singular.
_ANYWHERE = sp.Rational(3, 7)
