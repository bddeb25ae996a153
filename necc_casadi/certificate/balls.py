"""A second evaluator of V, in Arb ball arithmetic, for the checker alone.

It reads design.json by itself and shares no formula with the maker of certificates: expressions
are differentiated symbolically, networks carry derivatives packed over multi-indices, and results
are kept per box, since neighbouring cells ask for the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import combinations_with_replacement, pairwise, product
from typing import Any

import sympy as sp
from flint import arb, arb_mat, fmpq

from necc_casadi.expressions import parse

__all__ = ["Box", "Energy", "Model", "Net", "ball", "ends", "evaluate"]

#: A box: one (lo, hi) of doubles per coordinate.
Box = tuple[tuple[float, float], ...]

#: Arguments of neurons may vary by this much over a piece of a box.
_SPREAD = 0.25


def _wave(v: arb, f: Callable[[arb], arb], phase: float) -> arb:
    """Sine or cosine, with extrema at (k + phase)π, of a ball: sharp also where it is wide."""
    if not (v.is_finite() and v.rad() > 1e-6 and v.abs_upper() < 1e5):
        return f(v)
    lower, upper = v.lower(), v.upper()
    slack = 1e-6  # in half periods: an extremum this close counts as inside
    first = math.ceil(float((lower / arb.pi()).mid()) - phase - slack)
    last = math.floor(float((upper / arb.pi()).mid()) - phase + slack)
    if last > first:
        return ball(-1.0, 1.0)
    image = f(lower).union(f(upper))
    return image if last < first else image.union(arb(-1 if first % 2 else 1))


_FUNCTIONS = {
    "sin": lambda v: _wave(v, arb.sin, 0.5), "cos": lambda v: _wave(v, arb.cos, 0.0),
    "tan": arb.tan, "asin": arb.asin, "acos": arb.acos, "atan": arb.atan, "sinh": arb.sinh,
    "cosh": arb.cosh, "tanh": arb.tanh, "asinh": arb.asinh, "acosh": arb.acosh,
    "atanh": arb.atanh, "exp": arb.exp, "log": arb.log,
}  # fmt: skip


def ball(lo: float, hi: float) -> arb:
    """The ball over [lo, hi]."""
    return arb(lo) if lo == hi else arb(lo).union(arb(hi))


def evaluate(expr: sp.Expr, values: Mapping[sp.Symbol, arb]) -> arb:
    """An expression with balls for its symbols."""
    if expr in values:
        return values[expr]
    if expr.is_Rational:
        return arb(fmpq(int(expr.p), int(expr.q)))
    if expr == sp.pi:
        return arb.pi()
    if expr == sp.E:
        return arb.const_e()
    if expr.is_Pow:
        return _power(evaluate(expr.base, values), expr.exp, values)
    parts = [evaluate(a, values) for a in expr.args]
    if expr.is_Add:
        return sum(parts[1:], parts[0])
    if expr.is_Mul:
        product = parts[0]
        for part in parts[1:]:
            product = product * part
        return product
    return _FUNCTIONS[expr.func.__name__](parts[0])


def _power(base: arb, exponent: sp.Expr, values: Mapping[sp.Symbol, arb]) -> arb:
    if exponent.is_Integer:
        power = _integer_power(base, abs(int(exponent)))
        return power if exponent > 0 else 1 / power
    if exponent == sp.Rational(1, 2):
        return base.sqrt()
    return (base.log() * evaluate(exponent, values)).exp()


def _integer_power(base: arb, exponent: int) -> arb:
    """Repeated squaring: flint's ** takes logarithms, which a ball around 0 has not."""
    if exponent <= 1:
        return base if exponent else arb(1)
    half = _integer_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


class Model:
    """design.json as expressions and exact numbers."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        model = data["model"]
        self.symbols = {name: sp.Symbol(name, real=True) for name in model["symbols"]}
        self.z = tuple(self.symbols.values())
        self.states = [*model["states"], *model["controller_states"]]
        self.n, self.nc = len(model["states"]), len(model["controller_states"])
        self.H = self._read(model["H"])
        self.J, self.R, self.G = (self._matrix(model[key]) for key in "JRG")
        self.Jc, self.Rc, self.Gc = (self._matrix(model[key]) for key in ("Jc", "Rc", "Gc"))
        self.m = self.G.cols
        self.casimirs = [self._read(text) for text in data["casimirs"]["functions"]]
        self.target = [self._read(text) for text in data["target"]]
        self.xi_star = [float.fromhex(v) for v in data["xi_star"]]
        self.D, self.Dc = (
            [[float.fromhex(v) for v in row] for row in data[key]] for key in ("D", "Dc")
        )
        self.form, self.weights = data["form"], [float.fromhex(v) for v in data["weights"]]
        self.domain = {
            name: tuple(self._read(v) for v in bounds) for name, bounds in model["domain"].items()
        }
        self.verdict = data["verdict"]
        self.u_limits: list[list[float]] | None = model["u_limits"]

    def _read(self, text: str) -> sp.Expr:
        return parse(text, self.symbols)

    def _matrix(self, rows: list[list[str]]) -> sp.Matrix:
        return sp.Matrix([[self._read(v) for v in row] for row in rows])

    @property
    def Jcl(self) -> sp.Matrix:
        """The interconnection, plant first."""
        coupling = self.G * self.Gc.T
        top, bottom = self.J.row_join(-coupling), coupling.T.row_join(self.Jc)
        return sp.Matrix(top.col_join(bottom))

    @property
    def Rcl(self) -> sp.Matrix:
        """The dissipation."""
        return sp.diag(self.R, self.Rc)

    @property
    def ports(self) -> sp.Matrix:
        """𝒢 = diag(G, Gc)."""
        return sp.diag(self.G, self.Gc)

    def target_balls(self) -> list[arb]:
        """z* = (x*, ξ*)."""
        return [evaluate(v, {}) for v in self.target] + [arb(v) for v in self.xi_star]

    def bounds(self) -> list[tuple[arb, arb]]:
        """The domain; target ± 2 where the model names none."""
        result = []
        for name, at in zip(self.states, self.target_balls(), strict=True):
            lo, hi = self.domain.get(name, (None, None))
            result.append((at - 2, at + 2) if lo is None else (evaluate(lo, {}), evaluate(hi, {})))
        return result


# --- networks -------------------------------------------------------------------------------------


def _tanh(v: arb) -> tuple[arb, arb, arb, arb]:
    t = v.tanh()
    one = 1 - t * t
    return t, one, -2 * t * one, one * (6 * t * t - 2)


def _sin(v: arb) -> tuple[arb, arb, arb, arb]:
    s, c = v.sin(), v.cos()
    return s, c, -s, -c


def _squareplus(v: arb) -> tuple[arb, arb, arb, arb]:
    r = (v * v + 4).sqrt()
    return (v + r) / 2, (1 + v / r) / 2, 2 / r**3, -6 * v / r**5


_ACTIVATIONS = {"tanh": _tanh, "sin": _sin, "squareplus": _squareplus}
Activation = Callable[[arb], tuple[arb, arb, arb, arb]]


class Net:
    """A network ℝᵈ → ℝ: value, gradient, Hessian and third derivative over a box."""

    def __init__(
        self, layers: list[tuple[arb_mat, arb_mat]], activation: Activation, inputs: int
    ) -> None:
        self.layers, self.activation, self.d = layers, activation, inputs
        self.index = [list(combinations_with_replacement(range(inputs), k)) for k in range(4)]
        self.place = [{key: i for i, key in enumerate(keys)} for keys in self.index]
        self.quadratic: tuple[list[arb], list[arb]] | None = None
        self.linear: list[arb] | None = None
        rows = layers[0][0].tolist()
        self.steepest = [max(float(abs(row[i]).upper()) for row in rows) for i in range(inputs)]
        self._known: dict[Box, tuple[arb, list[arb], dict[tuple[int, int], arb]]] = {}

    @classmethod
    def from_weights(cls, shape: Mapping[str, Any], weights: Sequence[float]) -> tuple[Net, int]:
        """A network of design.json and how many weights it took."""
        widths = [shape["inputs"], *shape["hidden"], 1]
        at, layers = 0, []
        for columns, rows in pairwise(widths):
            starts = range(at, at + rows * columns, columns)
            W = [list(map(arb, weights[k : k + columns])) for k in starts]
            at += rows * columns
            layers.append((arb_mat(W), arb_mat([[arb(b)] for b in weights[at : at + rows]])))
            at += rows
        net = cls(layers, _ACTIVATIONS[shape["activation"]], shape["inputs"])
        if shape["quadratic"]:
            d = shape["inputs"]
            kappa, center = (list(map(arb, weights[at + k * d : at + (k + 1) * d])) for k in (0, 1))
            net.quadratic, at = (kappa, center), at + 2 * d
        return net, at

    @classmethod
    def outer(cls, phi: Mapping[str, Any], weights: Sequence[float]) -> Net:
        """The neural Φ(e, k) = δe + k + Σ exp(a) tanh(exp(b)e + dk + f)."""
        h = phi["hidden"]
        a, b, d, f = (list(map(arb, weights[i * h : (i + 1) * h])) for i in range(4))
        first = arb_mat([[x.exp(), y] for x, y in zip(b, d, strict=True)])
        second = arb_mat([[x.exp() for x in a]])
        layers = [(first, arb_mat([[x] for x in f])), (second, arb_mat([[arb(0)]]))]
        net = cls(layers, _tanh, 2)
        net.linear = [arb(phi["delta"]), arb(1)]
        return net

    def floor(self, activation: str) -> arb_mat:
        """A matrix ⪯ ∇²f for all arguments of a network with at most one hidden layer."""
        total = arb_mat(self.d, self.d)
        if self.quadratic is not None:
            for i, kappa in enumerate(self.quadratic[0]):
                total[i, i] = kappa
        if len(self.layers) == 1:
            return total
        W, out = self.layers[0][0], self.layers[1][0]
        bend = {"tanh": 4 / (3 * arb(3).sqrt()), "sin": arb(1), "squareplus": arb(1) / 4}[
            activation
        ]
        for j in range(W.nrows()):
            convex = activation == "squareplus" and not out[0, j] < 0
            weight = arb(0) if convex else abs(out[0, j]) * bend
            for i in range(self.d):
                for k in range(self.d):
                    total[i, k] = total[i, k] - weight * W[j, i] * W[j, k]
        return total

    def __call__(self, box: Box) -> tuple[arb, list[arb], dict[tuple[int, int], arb]]:
        """(f, ∇f, ∇²f over pairs i ≤ j) over a box, by mean-value forms about its middle."""
        if box not in self._known:
            pieces = [self._enclose(piece) for piece in self._pieces(box)]
            self._known[box] = reduce(_union, pieces)
        return self._known[box]

    def _pieces(self, box: Box) -> list[Box]:
        """The box, cut where a neuron's argument varies much."""
        most = {1: 16, 2: 4}.get(self.d, 2)
        sides = []
        for (lo, hi), steep in zip(box, self.steepest, strict=True):
            count = min(most, max(1, math.ceil((hi - lo) * steep / _SPREAD)))
            ends = [lo + (hi - lo) * k / count for k in range(count)] + [hi]
            sides.append(list(pairwise(ends)))
        return list(product(*sides))

    def _enclose(self, box: Box) -> tuple[arb, list[arb], dict[tuple[int, int], arb]]:
        wide = [ball(lo, hi) for lo, hi in box]
        at = [arb(lo / 2 + hi / 2) for lo, hi in box]
        step = [w - a for w, a in zip(wide, at, strict=True)]
        value, grad, hess = self._pass(wide, at, step)
        if self.quadratic is not None:
            for i, (kappa, center) in enumerate(zip(*self.quadratic, strict=True)):
                offset = wide[i] - center
                value, grad[i] = value + kappa * offset * offset / 2, grad[i] + kappa * offset
                hess[i, i] += kappa
        if self.linear is not None:
            for i, slope in enumerate(self.linear):
                value, grad[i] = value + slope * wide[i], grad[i] + slope
        return value, grad, hess

    def _pass(
        self, wide: list[arb], at: list[arb], step: list[arb]
    ) -> tuple[arb, list[arb], dict[tuple[int, int], arb]]:
        over, mid = self._start(wide), self._start(at)
        for depth, (W, b) in enumerate(self.layers):
            if depth:
                over = [self._activated(neuron) for neuron in over]
                mid = [self._activated(neuron) for neuron in mid]
            over, mid = self._affine(W, b, over), self._affine(W, b, mid)
            if depth:  # before it everything is linear
                both = zip(over, mid, strict=True)
                over = [self._centred(n, m, step) for n, m in both]
        value, grad, hess, _ = over[0]
        pairs = {(i, j): h for (i, j), h in zip(self.index[2], hess, strict=True)}
        return value[0], grad, pairs

    def _start(self, v: list[arb]) -> list[list[list[arb]]]:
        zeros = [[arb(0)] * len(keys) for keys in self.index]
        return [
            [[v[i]], [arb(int(i == j)) for j in range(self.d)], zeros[2], zeros[3]]
            for i in range(self.d)
        ]

    def _affine(self, W: arb_mat, b: arb_mat, layer: list[Any]) -> list[Any]:
        products = [(W * arb_mat([neuron[k] for neuron in layer])).tolist() for k in range(4)]
        rows = range(W.nrows())
        return [
            [[products[0][r][0] + b[r, 0]], products[1][r], products[2][r], products[3][r]]
            for r in rows
        ]

    def _activated(self, neuron: list[list[arb]]) -> list[list[arb]]:
        (v,), g, H, T = neuron
        f0, f1, f2, f3 = self.activation(v)
        pair = self.place[2]
        hess = [f1 * H[k] + f2 * g[i] * g[j] for k, (i, j) in enumerate(self.index[2])]
        third = [
            f1 * T[n]
            + f2 * (H[pair[i, j]] * g[k] + H[pair[i, k]] * g[j] + H[pair[j, k]] * g[i])
            + f3 * g[i] * g[j] * g[k]
            for n, (i, j, k) in enumerate(self.index[3])
        ]
        return [[f0], [f1 * x for x in g], hess, third]

    def _centred(self, over: list[Any], mid: list[Any], step: list[arb]) -> list[Any]:
        def sharpened(order: int, key: tuple[int, ...], naive: arb, center: arb) -> arb:
            above = self.place[order + 1]
            terms = [
                over[order + 1][above[tuple(sorted((*key, k)))]] * step[k] for k in range(self.d)
            ]
            return _meet(naive, sum(terms, center))

        result = [
            [
                sharpened(order, key, over[order][n], mid[order][n])
                for n, key in enumerate(self.index[order])
            ]
            for order in range(3)
        ]
        return [*result, over[3]]


def _union(a: Any, b: Any) -> tuple[arb, list[arb], dict[tuple[int, int], arb]]:
    """The hull of two enclosures of (f, ∇f, ∇²f)."""
    grad = [u.union(v) for u, v in zip(a[1], b[1], strict=True)]
    return a[0].union(b[0]), grad, {key: a[2][key].union(b[2][key]) for key in a[2]}


def _meet(a: arb, b: arb) -> arb:
    return a.intersection(b) if a.is_finite() and b.is_finite() and a.overlaps(b) else b


# --- V --------------------------------------------------------------------------------------------


class _Term:
    """An expression in the coordinates of a box, kept by the coordinates that it contains."""

    def __init__(self, expr: sp.Expr, variables: Sequence[sp.Symbol]) -> None:
        self.expr = expr
        self.used = [(k, v) for k, v in enumerate(variables) if expr.has(v)]
        self.constant = None if self.used else evaluate(expr, {})
        self._known: dict[Box, arb] = {}

    def __call__(self, box: Box) -> arb:
        if self.constant is not None:
            return self.constant
        key = tuple(box[k] for k, _ in self.used)
        if key not in self._known:
            self._known[key] = evaluate(self.expr, {v: ball(*box[k]) for k, v in self.used})
        return self._known[key]


class Energy:
    """V in some of the states over boxes, the other states being 0."""

    def __init__(self, model: Model, active: Sequence[int]) -> None:
        self.model, self.active, self.d = model, tuple(active), len(active)
        self.variables = [model.z[i] for i in active]
        at_rest = {s: 0 for i, s in enumerate(model.z) if i not in active}
        self._tables = [
            self._derivatives(sp.sympify(f).subs(at_rest)) for f in (model.H, *model.casimirs)
        ]
        self._nets()

    def _derivatives(self, f: sp.Expr) -> tuple[_Term, list[_Term], list[list[_Term]]]:
        v = self.variables
        grad = [sp.diff(f, s) for s in v]
        hess = [[_Term(sp.diff(g, s), v) for s in v] for g in grad]
        return _Term(f, v), [_Term(g, v) for g in grad], hess

    def _nets(self) -> None:
        form, at, nets = self.model.form, 0, []
        for shape in (form["hc"], form["k"], *form["betas"]):
            net, used = Net.from_weights(shape, self.model.weights[at:])
            nets.append(net)
            at += used
        self.hc, self.k, *self.betas = nets
        self.phi = None if form["phi"] is None else Net.outer(form["phi"], self.model.weights[at:])

    def value(self, box: Box) -> arb:
        """V over a box, by the mean-value form."""
        middle: Box = tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in box))
        naive, grad = self._first(box)
        if middle == box:
            return naive
        steps = [ball(lo, hi) - arb(m) for (lo, hi), (m, _) in zip(box, middle, strict=True)]
        centred = sum((g * s for g, s in zip(grad, steps, strict=True)), self._first(middle)[0])
        return _meet(naive, centred)

    def gradient(self, box: Box) -> list[arb]:
        """∇V over a box."""
        return self._first(box)[1]

    def _first(self, box: Box) -> tuple[arb, list[arb]]:
        e, de, C, dC = self._energy_and_casimir(box)
        if self.phi is None:
            return e + C, [a + b for a, b in zip(de, dC, strict=True)]
        value, (slope_e, slope_c), _ = self.phi((ends(e), ends(C)))
        return value, [slope_e * a + slope_c * b for a, b in zip(de, dC, strict=True)]

    def _energy_and_casimir(self, box: Box) -> tuple[arb, list[arb], arb, list[arb]]:
        H, dH, _ = self._tables[0]
        hc, dhc, _ = self.hc(box[-self.model.nc :])
        grad = [g(box) for g in dH]
        for i, g in enumerate(dhc):
            grad[self.d - self.model.nc + i] += g
        C, inner, outer, _ = self._casimir(box)
        slope = [
            sum((outer[a] * s[1][i] for a, s in enumerate(inner)), arb(0)) for i in range(self.d)
        ]
        return H(box) + hc, grad, C, slope

    def _casimir(
        self, box: Box
    ) -> tuple[arb, list[tuple[arb, list[arb], Any]], list[arb], dict[tuple[int, int], arb]]:
        """K, its inner functions (value, gradient, Hessian), ∇K and ∇²K."""
        inner = []
        for f, grad, hess in self._tables[1:]:
            rows = [[h(box) for h in row] for row in hess]
            inner.append((f(box), [g(box) for g in grad], rows))
        if self.betas:
            inner = [self._summed(inner)]
        value, outer, curved = self.k(tuple(ends(s[0]) for s in inner))
        return value, inner, outer, curved

    def _summed(self, inner: list[tuple[arb, list[arb], Any]]) -> tuple[arb, list[arb], Any]:
        """Σ βᵢ(cᵢ)."""
        total, grad = arb(0), [arb(0)] * self.d
        hess = [[arb(0)] * self.d for _ in range(self.d)]
        for beta, (c, dc, ddc) in zip(self.betas, inner, strict=True):
            b, (b1,), curved = beta((ends(c),))
            total = total + b
            grad = [g + b1 * s for g, s in zip(grad, dc, strict=True)]
            for i in range(self.d):
                for j in range(self.d):
                    hess[i][j] = hess[i][j] + b1 * ddc[i][j] + curved[0, 0] * dc[i] * dc[j]
        return total, grad, hess

    def casimirs(self, box: Box) -> tuple[list[arb], list[list[arb]]]:
        """The Casimirs and their gradients over a box."""
        tables = self._tables[1:]
        return [f(box) for f, _, _ in tables], [[g(box) for g in grad] for _, grad, _ in tables]

    def casimir_derivatives(self, order: int, box: Box) -> list[list[arb]]:
        """For each Casimir its derivatives of an order over a box, row-major in the indices."""
        values = {v: ball(*b) for v, b in zip(self.variables, box, strict=True)}
        rows = []
        for f, _, _ in self._tables[1:]:
            known: dict[tuple[int, ...], sp.Expr] = {(): f.expr}
            for k in range(1, order + 1):
                keys = combinations_with_replacement(range(self.d), k)
                known = {key: sp.diff(known[key[1:]], self.variables[key[0]]) for key in keys}
            found = {key: evaluate(entry, values) for key, entry in known.items()}
            rows.append([found[tuple(sorted(i))] for i in product(range(self.d), repeat=order)])
        return rows

    def hessian(self, box: Box, sign: int = 1) -> arb_mat:
        """A matrix L with ∇²V ⪰ L (sign 1) or ∇²V ⪯ L (sign −1) over a box.

        Where Φ is the sum, ∇²K and ∇²Hc enter through one matrix below (above) all of theirs.
        """
        H, first = self._tables[0][2], self.d - self.model.nc
        _, _, curved = self.hc(box[first:])
        _, inner, outer, curved_k = self._casimir(box)
        sharp = self.phi is None
        total = [[h(box) for h in row] for row in H]
        self._add(total, _loewner(curved, self.model.nc, sign) if sharp else curved, first)
        part = [[arb(0)] * self.d for _ in range(self.d)] if self.phi is not None else total
        weights = _loewner(curved_k, len(inner), sign) if sharp else curved_k
        for a, (_, _, ddc) in enumerate(inner):
            for i in range(self.d):
                for j in range(self.d):
                    part[i][j] = part[i][j] + outer[a] * ddc[i][j]
        for (a, b), w in weights.items():
            self._add_outer(part, w, inner[a][1], inner[b][1], a != b)
        return arb_mat(total) if self.phi is None else self._through_phi(box, total, part)

    @staticmethod
    def _add(total: list[list[arb]], block: Mapping[tuple[int, int], arb], first: int) -> None:
        for (i, j), h in block.items():
            total[first + i][first + j] = total[first + i][first + j] + h
            if i != j:
                total[first + j][first + i] = total[first + j][first + i] + h

    def _add_outer(self, total: Any, w: arb, u: list[arb], v: list[arb], both: bool) -> None:
        for i in range(self.d):
            for j in range(self.d):
                term = u[i] * v[j] + v[i] * u[j] if both else u[i] * v[j]
                total[i][j] = total[i][j] + w * term

    def _through_phi(self, box: Box, energy: Any, casimir: Any) -> arb_mat:
        e, de, C, dC = self._energy_and_casimir(box)
        if self.phi is None:
            return arb_mat(energy)
        _, (pe, pc), curved = self.phi((ends(e), ends(C)))
        result = [
            [pe * energy[i][j] + pc * casimir[i][j] for j in range(self.d)] for i in range(self.d)
        ]
        for (a, b), w in curved.items():
            self._add_outer(result, w, (de, dC)[a], (de, dC)[b], a != b)
        return arb_mat(result)

    def slope(self, box: Box) -> arb:
        """Φ₁ over a box."""
        if self.phi is None:
            return arb(1)
        e, _, C, _ = self._energy_and_casimir(box)
        return self.phi((ends(e), ends(C)))[1][0]


def ends(v: arb) -> tuple[float, float]:
    """Doubles around a ball."""
    lo, hi = float(v.lower()), float(v.upper())
    if not arb(lo) <= v.lower():
        lo = math.nextafter(lo, -math.inf)
    if not arb(hi) >= v.upper():
        hi = math.nextafter(hi, math.inf)
    return lo, hi


def _loewner(
    hess: Mapping[tuple[int, int], arb], size: int, sign: int
) -> dict[tuple[int, int], arb]:
    """Thin matrix ⪯ (sign 1) or ⪰ (sign −1) every symmetric matrix enclosed."""
    spread = [arb(0)] * size
    for (i, j), h in hess.items():
        spread[i] = spread[i] + h.rad()
        if i != j:
            spread[j] = spread[j] + h.rad()
    worst = spread[0]
    for s in spread[1:]:
        worst = worst.max(s)
    return {(i, j): h.mid() - sign * worst if i == j else h.mid() for (i, j), h in hess.items()}
