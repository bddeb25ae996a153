"""Networks as C: weight tables, the kernels they need, one function per network.

Each function returns a network's value and writes its gradient. The derivatives travel forward
with the value: the closed form of f′ costs one more product per input and no stored pass back.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.templating import fill
from necc_casadi.lyapunov.networks import MonotonePhi, Network

__all__ = ["LANES", "CNetwork", "c_network", "kernels", "width"]


#: Hidden layers are padded to whole groups of this many neurons, which compilers vectorise. gcc
#: takes shorter loops of doubles apart before it vectorises them; floats are for small processors,
#: where a shorter group needs less stack.
LANES = {"double": 16, "float": 8}


@dataclass(frozen=True, eq=False)
class CNetwork:
    """A network in the layout of the C code."""

    name: str
    inputs: int
    activation: str
    layers: tuple[tuple[Vector, Vector], ...]  # (W, b), rows and columns padded
    quadratic: Vector | None = None  # κ, then o
    linear: Vector | None = None  # slopes of a linear term, (inputs,)

    def tables(self, real: Real) -> str:
        """The weights as ``static const`` arrays."""
        parts = []
        for index, (W, b) in enumerate(self.layers, 1):
            last = index == len(self.layers)
            values = np.concatenate([W.ravel(), b] if last else [b, _panels(W, LANES[real.name])])
            parts.append(_table(f"{self.name}_w{index}", values, real))
        if self.quadratic is not None:
            parts.append(_table(f"{self.name}_quadratic", self.quadratic, real))
        return "\n".join(parts)

    def function(self, real: Real) -> str:
        """``name_network(v, slope)``: the value; ``slope`` becomes the gradient."""
        d, (*hidden, (W_last, _)) = self.inputs, self.layers
        shape = " -> ".join(str(n) for n in (d, *(W.shape[0] for W, _ in hidden), 1))
        body = [f"start(v, {d}, {d if hidden else W_last.shape[1]}, a);"]
        source, target = "a", "b"
        for index, (W, _) in enumerate(hidden, 1):
            rows, columns = W.shape
            body.append(
                f"layer_{self.activation}({self.name}_w{index}, {rows}, {columns}, {1 + d}, "
                f"{source}, {target});"
            )
            source, target = target, source
        body.append(
            f"value = output({self.name}_w{len(self.layers)}, {W_last.shape[1]}, {d}, "
            f"{source}, slope);"
        )
        if self.quadratic is not None:
            body.append(f"value += quadratic({self.name}_quadratic, {d}, v, slope);")
        for i, slope in enumerate(() if self.linear is None else self.linear):
            text = real.literal(slope)
            body += [f"value += {text} * v[{i}];", f"slope[{i}] += {text};"]
        buffers = ", ".join(f"{b}[{1 + d} * WIDTH]" for b in ("ab" if hidden else "a"))
        return "\n".join([
            f"/* {self.name}: {shape}, {self.activation} */",
            f"static necc_real {self.name}_network(const necc_real v[{d}], necc_real slope[{d}])",
            "{",
            f"    necc_real {buffers};",
            "    necc_real value;",
            *(f"    {line}" for line in body),
            "    return value;",
            "}",
            "",
        ])  # fmt: skip


def c_network(name: str, network: Network | MonotonePhi, weights: Vector, lanes: int) -> CNetwork:
    """Weights of a trained network, padded for the C code."""
    if isinstance(network, MonotonePhi):
        a, b, d, f = np.split(weights, 4)
        layers = [(np.column_stack([np.exp(b), d]), f), (np.exp(a)[None, :], np.zeros(1))]
        linear = np.array([network.delta, 1.0])
        return CNetwork(name, 2, "tanh", _padded(layers, lanes), linear=linear)
    quadratic = np.concatenate(network.quadratic_part(weights)) if network.quadratic else None
    layers = network.layers(weights)
    return CNetwork(name, network.inputs, network.activation, _padded(layers, lanes), quadratic)


def _panels(W: Vector, lanes: int) -> Vector:
    """Four columns at a time, `lanes` rows of each in turn; columns that are left one by one."""
    rows, columns = W.shape
    whole = columns - columns % 4
    fours = W[:, :whole].reshape(rows // lanes, lanes, whole // 4, 4).transpose(2, 0, 3, 1)
    return np.concatenate([fours.ravel(), W[:, whole:].T.ravel()])


def _padded(layers: list[tuple[Vector, Vector]], lanes: int) -> tuple[tuple[Vector, Vector], ...]:
    """Hidden widths rounded up to whole lanes; the new neurons have weights zero both ways."""
    result, columns = [], layers[0][0].shape[1]
    for index, (W, b) in enumerate(layers):
        last = index == len(layers) - 1
        rows = W.shape[0] if last else _whole(W.shape[0], lanes)
        columns = _whole(columns, lanes) if last else columns
        padded, bias = np.zeros((rows, columns)), np.zeros(rows)
        padded[: W.shape[0], : W.shape[1]], bias[: b.size] = W, b
        result.append((padded, bias))
        columns = rows
    return tuple(result)


def _whole(count: int, lanes: int) -> int:
    return -(-count // lanes) * lanes


def width(networks: Iterable[CNetwork], lanes: int) -> int:
    """Length of a stream: the widest layer or input."""
    return max(_whole(max(W.shape), lanes) for network in networks for W, _ in network.layers)


def kernels(networks: Iterable[CNetwork], real: Real) -> str:
    """The C functions that these networks call; no other, so that no compiler warns."""
    networks = list(networks)
    hidden = [network for network in networks if len(network.layers) > 1]
    parts = [fill("output.c")]
    if hidden:
        parts.append(fill("affine.c"))
    for activation in sorted({network.activation for network in hidden}):
        typed = f"{activation}_{real.name}.c" if activation in ("tanh", "sin") else None
        parts.append(fill(typed or f"{activation}.c", sqrt=f"sqrt{real.suffix}"))
        parts.append(fill("layer.c", activation=activation))
    if any(network.quadratic is not None for network in networks):
        parts.append(fill("quadratic.c"))
    return "\n".join(parts)


def _table(name: str, values: Vector, real: Real) -> str:
    literals = [real.literal(v) for v in values]
    rows = [", ".join(literals[i : i + 4]) for i in range(0, len(literals), 4)]
    body = ",\n    ".join(rows)
    return f"static const necc_real {name}[{len(literals)}] = {{\n    {body}\n}};\n"
