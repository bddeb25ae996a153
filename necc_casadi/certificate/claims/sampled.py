"""The region of the sampled loop as data, and the tree of boxes that its proof goes through."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from necc_casadi.certificate.claims.fields import Entries
from necc_casadi.certificate.claims.regions import Rows, Side

__all__ = [
    "BEYOND",
    "KEPT",
    "SPLIT",
    "Covered",
    "Method",
    "SampledRegion",
    "packed_tree",
    "unpacked",
    "walk",
]


#: How ξ is advanced over a sample.
Method = Literal["euler", "heun"]


#: Nodes of a tree: W > w₀ on the box, or the step is proved on it; from `SPLIT` on a cut in the
#: middle of side k − SPLIT, the last of which is the period.
BEYOND, KEPT, SPLIT = 0, 1, 2

#: Nodes that a tree may have, and how deep it may be.
MOST_NODES, _DEEPEST = 2_000_000, 200

#: A box of states and of periods, one side each.
Cell = tuple[Side, ...]


class Covered(Entries):
    """What is proved box by box, with the tree of the boxes."""

    tree: str  # see `packed_tree`

    @cached_property
    def nodes(self) -> bytes:
        """The nodes of the tree, a box before what it is cut into.

        Raises
        ------
        ValueError
            When they do not unpack.
        """
        return unpacked(self.tree)


@dataclass(frozen=True)
class SampledRegion(Covered):
    """Ω_T = {W < w₀} in a box, W = V + ½∇VᵀQ∇V; natural units."""

    period: float  # the longest
    integrator: Method
    metric: Rows  # Q
    level: float  # w₀, of W
    height: float  # w₀ − V(z̄) is at least this
    box: tuple[Side, ...]  # W > w₀ on its sides
    core: tuple[Side, ...]  # around z̄, with ∇²V ≻ 0
    clipped: bool  # whether limits of u may clip it somewhere in {W ≤ w₀}
    tree: str  # see `packed_tree`

    @cached_property
    def leaves(self) -> tuple[tuple[Cell, int], ...]:
        """Boxes that together are the whole, and what each is.

        Raises
        ------
        ValueError
            When the nodes are no tree.
        """
        return tuple(walk(self.root, self.nodes))

    @property
    def root(self) -> Cell:
        """The box, and all periods."""
        return (*self.box, (0.0, self.period))


def packed_tree(nodes: bytes) -> str:
    """The nodes of a tree as text: compressed, base 64."""
    return base64.b64encode(zlib.compress(nodes, 9)).decode()


def unpacked(tree: str) -> bytes:
    """The nodes of a tree from its text.

    Raises
    ------
    ValueError
        When they do not unpack.
    """
    unpacker = zlib.decompressobj()
    data = unpacker.decompress(base64.b64decode(tree, validate=True), MOST_NODES + 1)
    if len(data) > MOST_NODES or not data:
        raise ValueError("the boxes of the sampled region are not what they should be")
    return data


def walk(root: Cell, nodes: Sequence[int]) -> Iterator[tuple[Cell, int]]:
    """The leaves of a tree, which together are the root.

    Raises
    ------
    ValueError
        When the nodes are no tree over this box.
    """
    todo, at = [(root, 0)], 0
    while todo:
        cell, depth = todo.pop()
        if at >= len(nodes) or depth > _DEEPEST:
            raise ValueError("the boxes of the sampled region are no tree")
        node = nodes[at]
        at += 1
        if node < SPLIT:
            yield cell, node
            continue
        k = node - SPLIT
        if k >= len(cell):
            raise ValueError("a box of the sampled region is cut across no side")
        lo, hi = cell[k]
        middle = lo / 2 + hi / 2
        if not lo < middle < hi:
            raise ValueError("a box of the sampled region is cut too often")
        todo.append(((*cell[:k], (middle, hi), *cell[k + 1 :]), depth + 1))
        todo.append(((*cell[:k], (lo, middle), *cell[k + 1 :]), depth + 1))
    if at != len(nodes):
        raise ValueError("the boxes of the sampled region are no tree")
