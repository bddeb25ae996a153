"""Networks as C: weight tables, the kernels they need, one function per network.

Each function returns a network's value and writes its gradient. The derivatives travel forward
with the value: the closed form of f′ costs one more product per input and no stored pass back.

The order of operations, the same for every compiler, processor and width of vectors, with
``-ffp-contract=off`` to the last bit (tests/export/test_rounding_order.py follows it in NumPy):

* first hidden layer: a = ((b + W₁v₁) + W₂v₂) + …, ∂a/∂vᵢ = Wᵢ, exact;
* a further one, column by column in fours: s ← s + ((w₁v₁ + w₂v₂) + (w₃v₃ + w₄v₄)) from s = 0,
  likewise its derivatives, then a = s + b;
* activation: σ(a) and σ′(a), then each derivative times σ′(a);
* output: 16 partial sums, column j in sum j mod 16, added in halves, then the bias;
* the quadratic part is added after that.

So a term of a further layer of h columns meets at most h/4 + 4 roundings, one of the output
h/16 + 6. Columns that pad a layer are zeros. With ε = 2⁻²³, at every float: tanh within 2.16 ε of
its value and its slope within 3.64 ε of 1; sin and cos within 0.92 ε of 1, as far as |x| ≤ 100 was
looked at (beyond 5000 they are the C library's). In double the errors are at most 3 and 6, 1.5 and
1.5 of ε = 2⁻⁵² at the points of a sweep.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.templating import fill
from necc_casadi.lyapunov.networks import MonotonePhi, Network

__all__ = ["GROUP", "CNetwork", "c_network", "kernels", "loop_sizes"]


#: Hidden layers are padded to whole groups of this many neurons.
GROUP = 16


#: Neurons that a loop takes at a time, where all layers are whole groups of so many: gcc takes
#: shorter loops apart before it vectorises them.
_LANES = 32


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
            values = np.concatenate([W.ravel(), b] if last else [b, W.T.ravel()])
            parts.append(_table(f"{self.name}_w{index}", values, real))
        if self.quadratic is not None:
            parts.append(_table(f"{self.name}_quadratic", self.quadratic, real))
        return "\n".join(parts)

    def function(self, real: Real) -> str:
        """``name_network(v, slope)``: the value; ``slope`` becomes the gradient."""
        d, hidden = self.inputs, self.layers[:-1]
        shape = " -> ".join(str(n) for n in (d, *(W.shape[0] for W, _ in hidden), 1))
        buffers = ", ".join(f"{b}[{1 + d} * WIDTH]" for b in "ab"[: len(hidden)])
        body = [*self._layers(), *self._quadratic_and_linear(real)]
        return "\n".join([
            f"/* {self.name}: {shape}, {self.activation} */",
            f"static necc_real {self.name}_network(const necc_real v[{d}], necc_real slope[{d}])",
            "{",
            *([f"    necc_real {buffers};"] if hidden else []),
            "    necc_real value;",
            *(f"    {line}" for line in body),
            "    return value;",
            "}",
            "",
        ])  # fmt: skip

    def _layers(self) -> list[str]:
        """Calls that give the value and the gradient without the quadratic and the linear part."""
        d, table, (*hidden, (W_last, _)) = self.inputs, f"{self.name}_w", self.layers
        last, (source, target) = f"{table}{len(self.layers)}", "ab"
        if not hidden:
            return [f"value = affine_output({last}, {d}, v, slope);"]
        calls = [f"first_layer_{self.activation}({table}1, {hidden[0][0].shape[0]}, {d}, v, a);"]
        for index, (W, _) in enumerate(hidden[1:], 2):
            rows, columns = W.shape
            calls.append(
                f"layer_{self.activation}({table}{index}, {rows}, {columns}, {1 + d}, "
                f"{source}, {target});"
            )
            source, target = target, source
        return [*calls, f"value = output({last}, {W_last.shape[1]}, {d}, {source}, slope);"]

    def _quadratic_and_linear(self, real: Real) -> list[str]:
        lines = []
        if self.quadratic is not None:
            lines.append(f"value += quadratic({self.name}_quadratic, {self.inputs}, v, slope);")
        for i, slope in enumerate(() if self.linear is None else self.linear):
            text = real.literal(slope)
            lines += [f"value += {text} * v[{i}];", f"slope[{i}] += {text};"]
        return lines


def c_network(name: str, network: Network | MonotonePhi, weights: Vector) -> CNetwork:
    """Weights of a trained network, padded for the C code."""
    if isinstance(network, MonotonePhi):
        a, b, d, f = np.split(weights, 4)
        layers = [(np.column_stack([np.exp(b), d]), f), (np.exp(a)[None, :], np.zeros(1))]
        linear = np.array([network.delta, 1.0])
        return CNetwork(name, 2, "tanh", _padded(layers), linear=linear)
    quadratic = np.concatenate(network.quadratic_part(weights)) if network.quadratic else None
    layers = network.layers(weights)
    return CNetwork(name, network.inputs, network.activation, _padded(layers), quadratic)


def _padded(layers: list[tuple[Vector, Vector]]) -> tuple[tuple[Vector, Vector], ...]:
    """Hidden widths rounded up to whole groups; the new neurons have weights zero both ways."""
    result, columns = [], layers[0][0].shape[1]
    for index, (W, b) in enumerate(layers):
        last = index == len(layers) - 1
        rows = W.shape[0] if last else -(-W.shape[0] // GROUP) * GROUP
        padded, bias = np.zeros((rows, columns)), np.zeros(rows)
        padded[: W.shape[0], : W.shape[1]], bias[: b.size] = W, b
        result.append((padded, bias))
        columns = rows
    return tuple(result)


def loop_sizes(networks: Iterable[CNetwork]) -> str:
    """The macros of the kernels' loops; none where no network has hidden layers."""
    rows = [b.size for network in networks for _, b in network.layers[:-1]]
    lanes = GROUP if any(count % _LANES for count in rows) else _LANES
    return fill("lanes.c", lanes=lanes, width=max(rows)) if rows else ""


def kernels(networks: Iterable[CNetwork], real: Real) -> str:
    """The C functions that these networks call; no other, so that no compiler warns."""
    networks = list(networks)
    hidden = [network for network in networks if len(network.layers) > 1]
    deep = [network for network in hidden if len(network.layers) > 2]
    parts = [fill("output.c")] if hidden else []
    parts += [fill("affine_output.c")] if len(hidden) < len(networks) else []
    parts += [fill("affine.c")] if deep else []
    # One stream is left over where the value and its derivatives are odd in number.
    odd = any(network.inputs % 2 == 0 for network in deep)
    parts += [fill("affine_one.c")] if odd else []
    for activation in sorted({network.activation for network in hidden}):
        typed = f"{activation}_{real.name}.c" if activation in ("tanh", "sin") else None
        parts.append(fill(typed or f"{activation}.c", sqrt=f"sqrt{real.suffix}"))
        parts.append(fill("first_layer.c", activation=activation))
        if any(network.activation == activation for network in deep):
            one = _ONE_STREAM if odd else ""
            parts.append(fill("layer.c", activation=activation, last_stream=one))
    if any(network.quadratic is not None for network in networks):
        parts.append(fill("quadratic.c"))
    return "\n".join(parts)


#: What a layer does where the number of streams may be odd.
_ONE_STREAM = """
        if (s < streams) {
            products_of_one(w + rows + p, rows, columns, in + s * WIDTH, out + s * WIDTH + p);
        }"""


def _table(name: str, values: Vector, real: Real) -> str:
    literals = [real.literal(v) for v in values]
    rows = [", ".join(literals[i : i + 4]) for i in range(0, len(literals), 4)]
    body = ",\n    ".join(rows)
    return f"static const necc_real {name}[{len(literals)}] = {{\n    {body}\n}};\n"
