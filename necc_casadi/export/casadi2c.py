"""Plant terms as C: CasADi's algorithm of an SX function, printed as plain C99.

CasADi differentiates, shares subexpressions and orders the operations; this file prints the
result. CasADi's own printer writes double literals and double library calls even for
``casadi_real = float``, which a single-precision processor has to emulate.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Precision

__all__ = ["Real", "c_function"]


@dataclass(frozen=True)
class Real:
    """How numbers of the exported type are written."""

    name: Precision

    @property
    def suffix(self) -> str:
        """Suffix of literals and of library functions."""
        return "f" if self.name == "float" else ""

    @property
    def eps(self) -> float:
        """Spacing of the numbers next to 1."""
        return float(np.finfo(np.float32 if self.suffix else np.float64).eps)

    @property
    def tiny(self) -> float:
        """The smallest normal number."""
        return float(np.finfo(np.float32 if self.suffix else np.float64).tiny)

    def rounded(self, values: Vector) -> Vector:
        """`values` rounded to this type."""
        return np.asarray(values, np.float32 if self.suffix else np.float64).astype(float)

    def literal(self, value: float) -> str:
        """The shortest literal that reads back as `value` rounded to this type."""
        rounded = np.float32(value) if self.suffix else np.float64(value)
        if not math.isfinite(rounded):
            return ("-" if value < 0 else "") + "HUGE_VAL" + self.suffix.upper()
        return str(rounded) + self.suffix

    def literals(self, values: Iterable[float]) -> str:
        """Literals separated by commas."""
        return ", ".join(self.literal(v) for v in values)


_LONG = 40  # longer expressions get a name


_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}


_CALLS = {
    ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh",
    ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_SQRT: "sqrt",
    ca.OP_EXPM1: "expm1", ca.OP_LOG1P: "log1p",
    ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow",
}  # fmt: skip


def c_function(
    name: str,
    arguments: Sequence[tuple[str, ca.SX]],
    results: Sequence[tuple[str, ca.SX]],
    real: Real,
) -> str:
    """A static C function  arguments → results; all are vectors that share no memory.

    Values used once are written where they are used, so that short terms read like the model.
    """
    function = ca.Function(
        name, [s for _, s in arguments], [ca.densify(ca.vec(s)) for _, s in results]
    )
    lines = _statements(function, [a for a, _ in arguments], [r for r, _ in results], real)
    used = "\n".join(lines)
    lines[:0] = [f"    (void){a};" for a, _ in arguments if f"{a}[" not in used]
    parameters = [f"const necc_real {a}[{s.numel()}]" for a, s in arguments]
    parameters += [f"necc_real {r}[{s.numel()}]" for r, s in results]
    return "\n".join([_signature(f"static void {name}(", parameters), "{", *lines, "}", ""])


def _signature(head: str, parameters: Sequence[str]) -> str:
    rows, row = [], head + parameters[0]
    for parameter in parameters[1:]:
        if len(row) + len(parameter) > 95:
            rows.append(row + ",")
            row = " " * len(head) + parameter
        else:
            row += f", {parameter}"
    return "\n".join([*rows, row + ")"])


def _statements(
    function: ca.Function, arguments: Sequence[str], results: Sequence[str], real: Real
) -> list[str]:
    steps = range(function.n_instructions())
    uses = _uses(function)
    slot: dict[int, str] = {}  # work vector: what each place holds now, as C text
    lines: list[str] = []
    stores: list[str] = []  # the results, after all that is shared
    for i in steps:
        code = function.instruction_id(i)
        inputs, outputs = function.instruction_input(i), function.instruction_output(i)
        if code == ca.OP_OUTPUT:
            stores.append(f"    {results[outputs[0]]}[{outputs[1]}] = {_bare(slot[inputs[0]])};")
            continue
        if code == ca.OP_INPUT:
            slot[outputs[0]] = f"{arguments[inputs[0]]}[{inputs[1]}]"
            continue
        if code == ca.OP_CONST:
            text = real.literal(function.instruction_constant(i))
            slot[outputs[0]] = f"({text})" if text.startswith("-") else text
            continue
        text = _operation(code, [slot[j] for j in inputs], real)
        if uses[i] > 1 or len(text) > _LONG:
            lines.append(f"    const necc_real t{i} = {_bare(text)};")
            text = f"t{i}"
        slot[outputs[0]] = text
    return lines + stores


def _uses(function: ca.Function) -> Counter[int]:
    """How often the value of each instruction is read."""
    maker: dict[int, int] = {}
    uses: Counter[int] = Counter()
    for i in range(function.n_instructions()):
        code = function.instruction_id(i)
        if code not in (ca.OP_INPUT, ca.OP_CONST):
            reads = function.instruction_input(i)
            twice = code in (ca.OP_SQ, ca.OP_TWICE)
            for place in reads[:1] if code == ca.OP_OUTPUT or len(reads) == 1 else reads:
                uses[maker[place]] += 2 if twice else 1
        if code != ca.OP_OUTPUT:
            maker[function.instruction_output(i)[0]] = i
    return uses


def _operation(code: int, inputs: list[str], real: Real) -> str:
    if code in _INFIX:
        return f"({inputs[0]} {_INFIX[code]} {inputs[1]})"
    if code == ca.OP_NEG:
        return f"(-{inputs[0]})"
    if code == ca.OP_SQ:
        return f"({inputs[0]} * {inputs[0]})"
    if code == ca.OP_TWICE:
        return f"({inputs[0]} + {inputs[0]})"
    if code == ca.OP_INV:
        return f"({real.literal(1.0)} / {inputs[0]})"
    return f"{_CALLS[code]}{real.suffix}({', '.join(_bare(text) for text in inputs)})"


def _bare(text: str) -> str:
    """`text` without an outer pair of parentheses."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for position, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and position < len(text) - 1:
            return text
    return text[1:-1]
