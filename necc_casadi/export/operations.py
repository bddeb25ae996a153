"""Operations of one ``necc_control``, counted in the code: what any processor has to do.

Networks by their padded sizes and the order of :mod:`necc_casadi.export.networks`, plant terms in
their emitted text. Loads, stores, loops and comparisons come on top.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

from necc_casadi.export.networks import CNetwork

__all__ = [
    "ACTIVATION_COUNTS",
    "count_networks",
    "count_text",
    "least_cycles",
    "least_cycles_dual_issue",
]


#: Of σ and σ′ together, in ``tanh_float.c`` and the others: (×, + and −, ÷, roots).
ACTIVATION_COUNTS = {
    ("tanh", "float"): (11, 11, 1, 0),
    ("tanh", "double"): (15, 15, 1, 0),
    ("sin", "float"): (14, 13, 0, 0),
    ("sin", "double"): (21, 20, 0, 0),
    ("squareplus", "float"): (3, 3, 1, 1),
    ("squareplus", "double"): (3, 3, 1, 1),
}


_NAMES = ("multiplications", "additions", "divisions", "square roots")


#: Cycles of single precision on a Cortex-M4F (its technical reference manual, table of FPU
#: instructions): ×, + and − take 1, ÷ and roots 14. A call of the C library is not counted.
_CYCLES = dict(zip(_NAMES, (1, 1, 14, 14), strict=True))


def count_networks(networks: Iterable[CNetwork], real: str) -> Counter[str]:
    """Operations of each network once, value and gradient, and ``weights`` that are read."""
    total: Counter[str] = Counter()
    for network in networks:
        d, (*hidden, (last, _)) = network.inputs, network.layers
        for index, (W, _) in enumerate(hidden):
            rows, columns = W.shape
            streams = 1 if index == 0 else 1 + d  # the first layer's derivatives are its columns
            total["multiplications"] += rows * columns * streams + rows * d
            total["additions"] += rows * columns * streams + (rows if index > 0 else 0)
            per_row = ACTIVATION_COUNTS[network.activation, real]
            total.update({name: rows * n for name, n in zip(_NAMES, per_row, strict=True)})
        streams = 1 + d if hidden else 1
        total["multiplications"] += last.shape[1] * streams
        total["additions"] += last.shape[1] * streams
        if network.quadratic is not None:
            total["multiplications"] += 3 * d
            total["additions"] += 3 * d
        total["weights"] += sum(W.size + b.size for W, b in network.layers)
    return +total


def count_text(text: str) -> Counter[str]:
    """Operations in straight C code as :func:`necc_casadi.export.casadi2c.c_function` prints it."""
    roots = len(re.findall(r"\bsqrtf?\(", text))
    calls = len(re.findall(r"\b(?:a?(?:sin|cos|tan)h?|exp|expm1|log|log1p|pow)f?\(", text))
    counts = {
        "multiplications": text.count(" * "),
        "additions": len(re.findall(r" [+-] ", text)),
        "divisions": text.count(" / "),
        "square roots": roots,
        "calls of the C library": calls,
    }
    return +Counter(counts)


def least_cycles(counts: Counter[str]) -> int:
    """Cycles on a Cortex-M4F below which no compiler comes: arithmetic, and a load per weight."""
    return counts["weights"] + sum(_CYCLES[name] * counts[name] for name in _NAMES)


def least_cycles_dual_issue(counts: Counter[str]) -> int:
    """Cycles of arithmetic where at most two instructions begin in a cycle: Cortex-M7.

    Its latencies are not published. A multiplication and an addition are two instructions, since
    nothing is contracted; loads may take several numbers at once and are not counted.
    """
    arithmetic = sum(counts[name] for name in _NAMES)
    return (arithmetic + 1) // 2
