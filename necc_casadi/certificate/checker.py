"""The independent checker: re-proves each claim from design.json and certificate.json in Arb.

Nothing of the maker's arithmetic is used. A number in the certificate is a hint: it is accepted
only where it is proved again, and a claim that cannot be re-proved does not hold.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import itertools
import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi import exact as ex
from necc_casadi.certificate.balls import Box, Energy, Model, Net, ball, ends, evaluate
from necc_casadi.errors import OutputError

__all__ = ["Checked", "check"]

#: Of the matrix sign; it converges in about ten.
_NEWTON_STEPS = 60

#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14
#: The same where inputs are bounded: small levels need small boxes.
_INPUT_DEPTH = 28


@dataclass(frozen=True)
class Checked:
    """A claim after checking."""

    name: str
    holds: bool
    statement: str


def check(folder: Path) -> tuple[Checked, ...]:
    """Re-prove the certificate in a folder of necc-design.

    Raises
    ------
    OutputError
        When design.json or certificate.json is missing or unreadable.
    """
    design_text, certificate_text = (
        _read(folder / name) for name in ("design.json", "certificate.json")
    )
    remedy = "Run necc-design again."
    try:
        certificate = json.loads(certificate_text)
        model = Model(json.loads(design_text))
        claimed = {claim["name"]: claim for claim in certificate["claims"]}
        same = certificate["design_hash"] == hashlib.sha256(design_text.encode()).hexdigest()
        results = _Checker(model, certificate, claimed).everything()
    except (
        KeyError, TypeError, ValueError, AttributeError, IndexError, ZeroDivisionError,
        binascii.Error, zlib.error,
    ) as problem:  # fmt: skip
        raise OutputError(
            "output", f"{folder} holds no readable certificate: {problem!r}", remedy
        ) from None
    text = "the certificate is about this design.json" if same else "design.json has changed"
    return Checked("design", same, text), *results


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise OutputError(
            "output", f"{path} cannot be read: {problem}", "Name a folder of necc-design."
        ) from None


class _Checker:
    def __init__(
        self, model: Model, certificate: Mapping[str, Any], claimed: Mapping[str, Any]
    ) -> None:
        self.model, self.certificate, self.claimed = model, certificate, claimed
        self.full = Energy(model, range(len(model.z)))
        self._reduced: dict[tuple[int, ...], Energy] = {}

    def reduced(self, active: Sequence[int]) -> Energy:
        """V in some of the states, the others at rest; one object, which keeps its results."""
        key = tuple(active)
        if key not in self._reduced:
            self._reduced[key] = Energy(self.model, active)
        return self._reduced[key]

    def everything(self) -> list[Checked]:
        results = [self.equilibrium(), self.casimir(), self.structure(), self.slope()]
        results.append(self.damping())
        basis = all(r.holds for r in results[1:])
        results.append(Checked("decrease", basis, "V never increases along the loop"))
        sound = all(r.holds for r in results)
        stability = self.certificate["stability"]
        if stability == "asymptotic":
            results.append(self.attraction(sound))
        else:
            holds = sound and stability == "stable"
            results.append(Checked("stability", holds, "z̄ is stable"))
        settled = results[-1].holds
        if "region" in self.claimed or self.certificate["region"] is not None:
            results.append(self.region(settled, stability))
        limits = self.claimed.get("input_limits", {"holds": False})["holds"]
        if limits or self.certificate["level_u"] is not None:
            results.append(self.input_limits(results[-1].name == "region" and results[-1].holds))
        claimed = self.claimed.get("global", {"holds": False})["holds"]
        if claimed or self.certificate["is_global"]:
            results.append(self.everywhere(settled and stability == "asymptotic"))
        return results

    # --- the whole space --------------------------------------------------------------------------

    def everywhere(self, sound: bool) -> Checked:
        """∇²V ⪰ μI and ∂²H/∂s² ⪰ μI for all states, by periodicity and bounds of the networks."""
        text = "z̄ is globally asymptotically stable"
        model, form = self.model, self.model.form
        constant = not (model.Jcl - model.Rcl).free_symbols and not model.ports.free_symbols
        if not (sound and constant and form["phi"] is None and not form["betas"]):
            return Checked("global", False, text)
        named = self.claimed.get("global", {}).get("data", {}).get("resting", ())
        resting = [i for i in range(len(model.z)) if i in named]
        active = [i for i in range(len(model.z)) if i not in resting]
        y, s = ([model.z[i] for i in chosen] for chosen in (active, resting))
        slopes = [[sp.diff(c, v) for v in y] for c in model.casimirs]
        floors = self._floors()
        holds = (
            floors is not None
            and not sp.Matrix(slopes).free_symbols
            and self._at_rest(resting)
            and self._invariant_points(resting)
            and self._bowl(sp.hessian(model.H, s) if s else sp.eye(1), None)
            and self._bowl(
                sp.hessian(model.H.subs(dict.fromkeys(s, 0)), y), self._from_nets(slopes, floors)
            )
        )
        return Checked("global", holds, text)

    def _floors(self) -> list[arb_mat] | None:
        """Matrices below ∇²Hc and ∇²K for all arguments."""
        nets = (self.full.hc, self.full.k)
        shapes = (self.model.form["hc"], self.model.form["k"])
        if any(len(shape["hidden"]) > 1 for shape in shapes):
            return None
        return [net.floor(shape["activation"]) for net, shape in zip(nets, shapes, strict=True)]

    def _from_nets(self, slopes: list[list[sp.Expr]], floors: list[arb_mat]) -> arb_mat:
        N = arb_mat([[evaluate(v, {}) for v in row] for row in slopes])
        total = N.transpose() * floors[1] * N
        first = total.nrows() - self.model.nc
        for i in range(self.model.nc):
            for j in range(self.model.nc):
                total[first + i, first + j] = total[first + i, first + j] + floors[0][i, j]
        return total

    def _bowl(self, matrix: sp.Matrix, added: arb_mat | None) -> bool:
        """Whether matrix + added ≻ 0 for all values of its symbols, in each of which it repeats."""
        symbols = sorted(matrix.free_symbols, key=str)
        shifted = [matrix.subs(v, v + 2 * sp.pi) - matrix for v in symbols]
        if not all(ex.is_zero(entry) is True for change in shifted for entry in change):
            return False

        def test(box: Box) -> bool:
            values = {v: ball(*b) for v, b in zip(symbols, box, strict=True)}
            A = arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])
            return _positive(A if added is None else A + added, 1e-9)

        return everywhere(tuple((-3.15, 3.15) for _ in symbols), test, _DEPTH)

    # --- equilibrium ------------------------------------------------------------------------------

    def equilibrium(self) -> Checked:
        """One critical point in the ball, ∇²V ⪰ μI there, and the distances."""
        c = self.certificate
        if c["mu"] is None or c["radius"] is None:
            return Checked("equilibrium", False, "no equilibrium is claimed")
        mu, radius = float(c["mu"]), float(c["radius"])
        target = self.model.target_balls()
        g = _norm(self.full.gradient(tuple(ends(t) for t in target)))
        data = self.claimed["equilibrium"]["data"]
        holds = mu > 0 and radius > 0 and bool(g < arb(mu) * arb(radius))
        holds = holds and bool(g <= float(data["gradient_norm"]))
        holds = holds and bool(g / mu <= float(c["bound_rigorous"])) and self._enclosed(target)
        cube = tuple(ends(t + ball(-radius, radius)) for t in target)
        holds = holds and self._everywhere(
            cube,
            lambda box: _positive(self.full.hessian(box), mu),
            self.full,
            self._bending(),
        )
        text = f"one critical point within {radius:.3g} of z*, ‖z̄ − z*‖ ≤ {c['bound_rigorous']:.3g}"
        return Checked("equilibrium", holds, text)

    def _bending(self) -> list[bool]:
        """Which coordinates ∇²V varies with: it pays to halve no other side of a box."""
        model = self.model
        found = set(model.z[model.n :]).union(*(c.free_symbols for c in model.casimirs))
        for term in sp.Add.make_args(model.H):
            for slope in (sp.diff(term, v) for v in term.free_symbols):
                found.update(*(sp.diff(slope, s).free_symbols for s in slope.free_symbols))
        return [v in found for v in model.z]

    def _enclosed(self, target: list[arb]) -> bool:
        """The minimum is within the claimed distance of the claimed z̄, inside the ball."""
        c = self.certificate
        z_bar = [float(v) for v in c["z_bar"]]
        residual = _norm(self.full.gradient(tuple((v, v) for v in z_bar)))
        near = _norm([t - v for t, v in zip(target, z_bar, strict=True)])
        return bool(residual / float(c["mu"]) <= float(c["enclosure"])) and bool(
            near < float(c["radius"])
        )

    def _z_bar(self, active: Sequence[int]) -> Box:
        radius, z = float(self.certificate["enclosure"]), self.certificate["z_bar"]
        return tuple(ends(arb(float(z[i])) + ball(-radius, radius)) for i in active)

    # --- decrease ---------------------------------------------------------------------------------

    def casimir(self) -> Checked:
        """∇CᵀM = 0 for every closed form."""
        M = self.model.Jcl - self.model.Rcl
        rows = [sp.Matrix([[sp.diff(c, v) for v in self.model.z]]) * M for c in self.model.casimirs]
        holds = all(ex.is_zero(entry) is True for row in rows for entry in row)
        return Checked("casimir", holds, "∇Cᵀ(Jcl − Rcl) = 0 exactly")

    def structure(self) -> Checked:
        """Skewness and semidefiniteness, exactly."""
        m = self.model
        skew = all(ex.is_zero(e) is True for A in (m.J, m.Jc) for e in A + A.T)
        symmetric = all(ex.is_zero(e) is True for A in (m.R, m.Rc) for e in A - A.T)
        dissipative = all(ex.is_positive_semidefinite(A) is True for A in (m.R, m.Rc))
        return Checked("structure", skew and symmetric and dissipative, "J, Jc skew; R, Rc ⪰ 0")

    def slope(self) -> Checked:
        """Φ₁ > 0: the sum has 1, the neural form δ."""
        least = self._delta()
        claimed = float(self.claimed["slope"]["data"]["slope"])
        finite = all(math.isfinite(w) for w in self.model.weights)
        return Checked("slope", finite and 0 < claimed <= least, f"Φ₁ ≥ {least:g}")

    def _delta(self) -> float:
        phi = self.model.form["phi"]
        return 1.0 if phi is None else float(phi["delta"])

    def damping(self) -> Checked:
        """D, Dc ≻ 0 by elimination over the rationals."""
        holds = all(_exactly_positive(A) for A in (self.model.D, self.model.Dc))
        return Checked("damping", holds, "D ≻ 0, Dc ≻ 0")

    def attraction(self, sound: bool) -> Checked:
        """The linearisation plus the claimed rate is Hurwitz, by a Lyapunov inequality."""
        rate = float(self.claimed["attraction"]["data"]["rate"])
        text = f"z̄ attracts: eigenvalues have real parts below {-rate:.3g}"
        if not sound or not rate >= 0:
            return Checked("attraction", False, text)
        box = self._z_bar(range(len(self.model.z)))
        A = self._linearisation(box)
        n = A.nrows()
        for i in range(n):
            A[i, i] = A[i, i] + rate
        P = _lyapunov(_middle(A))
        if P is None:
            return Checked("attraction", False, text)
        P_exact = arb_mat(P.tolist())
        rate_matrix = -(P_exact * A + (P_exact * A).transpose())
        return Checked("attraction", _positive(P_exact, 0) and _positive(rate_matrix, 0), text)

    def _linearisation(self, box: Box) -> arb_mat:
        model = self.model
        values = {s: ball(*b) for s, b in zip(model.z, box, strict=True)}

        def enclose(matrix: sp.Matrix) -> arb_mat:
            return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])

        ports, m = enclose(model.ports), model.m
        damping = arb_mat(2 * m, 2 * m)
        for i in range(m):
            for j in range(m):
                damping[i, j], damping[m + i, m + j] = arb(model.D[i][j]), arb(model.Dc[i][j])
        M = enclose(sp.Matrix(model.Jcl - model.Rcl))
        slope = self.full.slope(box)
        return (M / slope - ports * damping * ports.transpose()) * _hull(self.full, box)

    # --- region -----------------------------------------------------------------------------------

    def region(self, sound: bool, stability: str | None) -> Checked:
        """The component of {V ≤ c} around z̄ lies in the domain, and only z̄ is critical in it."""
        region = self.certificate["region"]
        if region is None or not sound:
            return Checked("region", False, "no region is proved")
        level, active = float(region["level"]), [int(i) for i in region["active"]]
        resting = [i for i in range(len(self.model.z)) if i not in active]
        text = f"the component of {{V ≤ {level:.6g}}} around z̄ is invariant and in the domain"
        energy = self.reduced(active)
        z_bar = self._z_bar(active)
        bottom = energy.value(z_bar)
        holds = level == self.certificate["level"] and bool(bottom < level)
        holds = holds and self._at_rest(resting) and self._momenta(resting, active, level, bottom)
        holds = holds and _PROOFS[region["method"]](self, energy, region, z_bar).holds(
            self.claimed["region"]["data"], self.certificate["domain_share"]
        )
        converges = stability == "asymptotic" and self._invariant_points(resting)
        said = "converges" in self.claimed["region"]["statement"]
        if said and not converges:
            return Checked("region", False, "convergence from all of the region is not re-proved")
        if converges:
            text += "; every solution from it converges to z̄"
        elif stability == "asymptotic":
            text += "; z̄ is locally asymptotically stable"
        return Checked("region", holds, text)

    def input_limits(self, sound: bool) -> Checked:
        """U stays within the model's limits wherever V ≤ c_u on the cells of the region."""
        level, region = self.certificate["level_u"], self.certificate["region"]
        if level is None or self.model.u_limits is None or not sound:
            return Checked("input_limits", False, "no input limits are proved to be kept")
        active = [int(i) for i in region["active"]]
        energy, z_bar = self.reduced(active), self._z_bar(active)
        proof = _PROOFS[region["method"]](self, energy, region, z_bar)
        if isinstance(proof, _Chart):
            return Checked("input_limits", False, "no input limits in the coordinates (c, ξ)")
        inputs = _Inputs(self.model, energy, float(level))
        holds = bool(energy.value(z_bar) < float(level)) and float(level) <= float(region["level"])
        holds = holds and inputs.covered() and all(inputs.kept(box) for box in proof.boxes())
        text = f"u stays within its limits on {{V ≤ {float(level):.6g}}} around z̄"
        return Checked("input_limits", holds, text)

    def _at_rest(self, resting: Sequence[int]) -> bool:
        """H = ½ sᵀA(y)s + U(y) in the resting plant states s, which no Casimir contains."""
        model = self.model
        s = [model.z[i] for i in resting]
        zero = dict.fromkeys(s, 0)
        if any(i >= model.n for i in resting) or any(c.has(*s) for c in model.casimirs if s):
            return False
        A = sp.hessian(model.H, s) if s else sp.zeros(0)
        kinetic = (sp.Matrix([s]) * A * sp.Matrix(s))[0] / 2 if s else sp.Integer(0)
        flat = all(ex.is_zero(sp.diff(a, v)) is True for a in A for v in s)
        return flat and ex.is_zero(model.H - model.H.subs(zero) - kinetic) is True

    def _momenta(
        self, resting: Sequence[int], active: Sequence[int], level: float, bottom: arb
    ) -> bool:
        """½ δ sᵀA(y)s > c − V(z̄) wherever a resting state leaves the domain, and A ≻ 0."""
        bounds = self.model.bounds()
        symbols = [self.model.z[i] for i in resting]
        A = sp.hessian(self.model.H, symbols) if symbols else sp.zeros(0)
        cube = tuple((ends(bounds[i][0])[0], ends(bounds[i][1])[1]) for i in active)
        variables = [self.model.z[i] for i in active]
        for k, i in enumerate(resting):
            lo, hi = bounds[i]
            reach = (-lo).min(hi)
            if not reach > 0:
                return False
            needed = 2 * (level - bottom) / (self._delta() * reach * reach)

            def stiff(box: Box, k: int = k, needed: arb = needed) -> bool:
                values = {v: ball(*b) for v, b in zip(variables, box, strict=True)}
                matrix = arb_mat([[evaluate(e, values) for e in row] for row in A.tolist()])
                matrix[k, k] = matrix[k, k] - needed
                return _positive(matrix, 0)

            if not self._everywhere(cube, stiff, None, [A.has(v) for v in variables]):
                return False
        return True

    def _invariant_points(self, resting: Sequence[int]) -> bool:
        """On E only momenta could move, and they stay where ∂H/∂s = 0: see theory of the class."""
        model = self.model
        damped = model.ports.T
        if not model.Rcl.free_symbols:
            damped = damped.col_join(model.Rcl)
        if damped.free_symbols:
            return False
        silent = damped.nullspace()
        if not silent:
            return True
        N = sp.Matrix.hstack(*silent)
        motion = model.Jcl * N
        if motion.free_symbols or motion.rank() < N.cols:
            return False
        rows = [i for i in range(motion.rows) if any(e != 0 for e in motion.row(i))]
        return all(i in resting and all(e == 0 for e in N.row(i)) for i in rows)

    def _everywhere(
        self,
        box: Box,
        test: Callable[[Box], bool],
        energy: Energy | None,
        counts: Sequence[bool] | None = None,
        depth: int = _DEPTH,
    ) -> bool:
        """Whether a test holds on a box, halved along its widest sides where it must be."""
        return everywhere(box, test, depth, counts)


def everywhere(
    box: Box, test: Callable[[Box], bool], depth: int, counts: Sequence[bool] | None = None
) -> bool:
    """Whether `test` holds on pieces that cover a box; only sides that count are halved."""
    if test(box):
        return True
    widths = [hi - lo for lo, hi in box]
    if counts is not None:
        widths = [w if c else 0.0 for w, c in zip(widths, counts, strict=True)]
    k = max(range(len(box)), key=widths.__getitem__, default=-1)
    if depth == 0 or k < 0 or widths[k] <= 0:
        return False
    lo, hi = box[k]
    middle = lo / 2 + hi / 2
    halves = ((lo, middle), (middle, hi))
    return all(
        everywhere((*box[:k], half, *box[k + 1 :]), test, depth - 1, counts) for half in halves
    )


class _Grid:
    """Cells [kh, (k+1)h]: V > c around the marked ones, no critical point but z̄ in them."""

    def __init__(
        self, checker: _Checker, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level = float(region["level"])
        self.first, self.shape = ([int(v) for v in region[key]] for key in ("first", "shape"))
        self.step = [float(v) for v in region["step"]]
        self.low, self.high = ([int(v) for v in ends] for ends in region["core"])
        bits = np.frombuffer(zlib.decompress(base64.b64decode(region["cells"])), dtype=np.uint8)
        count = math.prod(self.shape)
        self.cells = {
            tuple(int(v) for v in np.unravel_index(i, self.shape))
            for i in np.flatnonzero(np.unpackbits(bits, count=count))
        }

    def box(self, cell: Sequence[int]) -> Box:
        return tuple(
            ((f + k) * h, (f + k + 1) * h)
            for f, k, h in zip(self.first, cell, self.step, strict=True)
        )

    def boxes(self) -> list[Box]:
        """Boxes that cover the region."""
        return [self.box(cell) for cell in self.cells]

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        return (
            all(math.frexp(h)[0] == 0.5 for h in self.step)
            and self._in_domain()
            and self._core()
            and all(self._regular(cell) and self._enclosed(cell) for cell in self.cells)
            and self._covers(data, share)
        )

    def _in_domain(self) -> bool:
        bounds = self.checker.model.bounds()
        return all(
            bool(bounds[i][0] <= f * h) and bool((f + n) * h <= bounds[i][1])
            for i, f, n, h in zip(
                self.energy.active, self.first, self.shape, self.step, strict=True
            )
        )

    def _core(self) -> bool:
        """z̄ is inside a block of cells on which V is convex, and in a marked cell."""
        block = [range(a, b + 1) for a, b in zip(self.low, self.high, strict=True)]
        lo, hi = self.box(self.low), self.box(self.high)
        inside = all(
            a[0] <= z[0] and z[1] <= b[1] for a, b, z in zip(lo, hi, self.z_bar, strict=True)
        )
        within = all(
            a >= 0 and b < n for a, b, n in zip(self.low, self.high, self.shape, strict=True)
        )
        cells = list(itertools.product(*block))
        return (
            inside
            and within
            and self._marked()
            and all(
                everywhere(self.box(c), lambda b: _positive(self.energy.hessian(b), 0), 6)
                for c in cells
            )
        )

    def _marked(self) -> bool:
        return any(
            all(
                lo <= z[1] and z[0] <= hi
                for (lo, hi), z in zip(self.box(c), self.z_bar, strict=True)
            )
            for c in self.cells
        )

    def _regular(self, cell: tuple[int, ...]) -> bool:
        if all(a <= k <= b for a, k, b in zip(self.low, cell, self.high, strict=True)):
            return True

        def test(box: Box) -> bool:
            gradient = self.energy.gradient(box)
            decided = any(bool(g > 0) or bool(g < 0) for g in gradient)
            finite = all(g.is_finite() for g in gradient)
            return (decided and finite) or bool(self.energy.value(box) > self.level)

        return everywhere(self.box(cell), test, 8)

    def _enclosed(self, cell: tuple[int, ...]) -> bool:
        """V > c on every face of a marked cell that no other marked cell shares."""
        box = self.box(cell)
        for axis, (lo, hi) in enumerate(box):
            for move, end in ((-1, lo), (1, hi)):
                other = (*cell[:axis], cell[axis] + move, *cell[axis + 1 :])
                face = (*box[:axis], (end, end), *box[axis + 1 :])
                if other not in self.cells and not everywhere(
                    face, lambda b: bool(self.energy.value(b) > self.level), 10
                ):
                    return False
        return True

    def _covers(self, data: Mapping[str, Any], share: float) -> bool:
        inside = [c for c in self.cells if self._below(self.box(c))]
        plant = [k for k, i in enumerate(self.energy.active) if i < self.checker.model.n]
        shadows = {tuple(c[k] for k in plant) for c in inside}
        everything = range(len(self.shape))
        return (
            share == data["domain_share"]
            and bool(self._share(len(inside), everything) >= float(share))
            and bool(self._share(len(shadows), plant) >= float(data["plant_share"]))
        )

    def _below(self, box: Box) -> bool:
        return everywhere(box, lambda b: bool(self.energy.value(b) <= self.level), 3)

    def _share(self, count: int, axes: Sequence[int]) -> arb:
        bounds = self.checker.model.bounds()
        result = arb(count) * (1 + arb(2) ** -40)  # the maker divides by a rounded volume
        for k in axes:
            lo, hi = bounds[self.energy.active[k]]
            result = result * self.step[k] / (hi - lo)
        return arb(result.upper())


class _Core:
    """Shells ‖Lᵀe‖ ≤ rⱼ with ∇²V ⪰ νⱼLLᵀ, integrated twice along rays from the centre."""

    def __init__(
        self, checker: _Checker, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level, self.above = float(region["level"]), float(region["above"])
        self.center = [float(v) for v in region["center"]]
        L = [[float(v) for v in row] for row in region["L"]]
        self.d = len(self.center)
        self.Lt = arb_mat(L).transpose()
        self.P = arb_mat(L) * self.Lt
        self.inverse = self.Lt.inv()
        self.radii, self.nu, self.step = (
            [float(v) for v in region[key]] for key in ("radii", "nu", "step")
        )

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        increasing = all(a < b for a, b in zip([0.0, *self.radii], self.radii, strict=False))
        sound = increasing and all(h > 0 for h in self.step) and len(self.nu) == len(self.radii)
        return (
            sound
            and self._in_domain()
            and bool(self._length(self.z_bar) < self.radii[0])
            and self._climbs()
            and all(self._curved(box) for box in self._cells())
            and self._covers(data, share)
        )

    def _half(self, radius: float | arb) -> list[arb]:
        rows = self.inverse.tolist()
        return [arb(radius) * _norm(row) for row in rows]

    def _in_domain(self) -> bool:
        bounds = self.checker.model.bounds()
        return all(
            bool(bounds[i][0] <= c - h) and bool(c + h <= bounds[i][1])
            for i, c, h in zip(
                self.energy.active, self.center, self._half(self.radii[-1]), strict=True
            )
        )

    def _length(self, box: Box) -> arb:
        """‖Lᵀe‖ over a box."""
        e = arb_mat([[ball(*b) - c] for b, c in zip(box, self.center, strict=True)])
        return _norm([row[0] for row in (self.Lt * e).tolist()])

    def _climbs(self) -> bool:
        at: Box = tuple((c, c) for c in self.center)
        g = arb_mat([[v] for v in self.energy.gradient(at)])
        slope = -_norm([row[0] for row in (self.inverse.transpose() * g).tolist()])
        height, inner = self.energy.value(at), arb(0)
        for outer, nu in zip(self.radii, self.nu, strict=True):
            width = outer - inner
            end = slope + nu * width
            if not end > 0:
                return False
            height, slope, inner = height + width * (slope + end) / 2, end, arb(outer)
        return bool(height > self.level)

    def boxes(self) -> list[Box]:
        """Boxes that cover the region."""
        return self._cells()

    def _cells(self) -> list[Box]:
        """Cells at multiples of the step that may meet the ellipsoid."""
        axes = []
        for c, h, s in zip(self.center, self._half(self.radii[-1]), self.step, strict=True):
            first = math.floor(float((c - h).lower()) / s) - 1
            last = math.floor(float((c + h).upper()) / s) + 1
            axes.append([(k * s, (k + 1) * s) for k in range(first, last + 1)])
        boxes = itertools.product(*axes)
        return [box for box in boxes if not self._length(box) > self.radii[-1]]

    def _curved(self, box: Box) -> bool:
        def test(piece: Box) -> bool:
            length = self._length(piece)
            if length > self.radii[-1]:
                return True
            inner = [0.0, *self.radii[:-1]]
            met = [
                nu
                for a, b, nu in zip(inner, self.radii, self.nu, strict=True)
                if not (length < a or length > b)
            ]
            return _positive(self.energy.hessian(piece) - self.P * arb(max(met)), 0)

        return everywhere(box, test, 10)

    def _covers(self, data: Mapping[str, Any], share: float) -> bool:
        """The ellipsoid ½ above |e|² ≤ height is in the region; its size is as claimed."""
        bottom = self.energy.value(self.z_bar)
        radius = (2 * (self.level - bottom) / self.above).sqrt().min(arb(self.radii[-1]))
        bounds = [self.checker.model.bounds()[i] for i in self.energy.active]
        volume = arb.pi() ** (arb(self.d) / 2) / (arb(self.d) / 2 + 1).gamma() * radius**self.d
        for k, (lo, hi) in enumerate(bounds):
            volume = volume / self.Lt[k, k] / (hi - lo)
        states = [self.checker.model.states[i] for i in self.energy.active]
        reach = dict(zip(states, self._half(radius), strict=True))
        sizes = all(
            bool(reach[key.removeprefix("reach_")] >= float(value))
            for key, value in data.items()
            if key.startswith("reach_")
        )
        claimed = share == data["domain_share"] and bool(volume >= float(share)) and sizes
        return claimed and all(self._flat(box, radius) for box in self._cells())

    def _flat(self, box: Box, radius: arb) -> bool:
        def test(piece: Box) -> bool:
            if self._length(piece) > radius:
                return True
            return _positive(self.P * arb(self.above) - self.energy.hessian(piece, -1), 0)

        return everywhere(box, test, 10)


class _Chart:
    """V = K(c) + Hc(ξ) in coordinates g = (c, ξ): the map y → g is one-to-one on an ellipsoid.

    y = ȳ + Bw with |w| ≤ ρ, θ = A(g − ḡ), A = diag(A_K, A_H), M = Dθ at ȳ, βₖ ≥ ‖A Dᵏc(B·, …)‖ at ȳ
    and, for the last k, on the ellipsoid. By Taylor's formula ‖Dθ − M‖ ≤ Σ βₖ ρᵏ⁻¹/(k−1)! and
    ||θ| − |Mw|| ≤ |θ(0)| + Σ βₖ |w|ᵏ/k!. V is convex in g on |θ| ≤ size, and above c on its border.
    """

    def __init__(
        self, checker: _Checker, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level, self.radius, self.size, self.nu, self.above, self.inner = (
            float(region[key]) for key in ("level", "radius", "size", "nu", "above", "inner")
        )
        self.center, self.middle, self.bends = (
            [float(v) for v in region[key]] for key in ("center", "middle", "bends")
        )
        self.B, self.A_K, self.A_H = (
            arb_mat([[float(v) for v in row] for row in region[key]])
            for key in ("basis", "scale_k", "scale_h")
        )
        self.d, self.r = len(self.center), len(self.middle)
        self.half = [arb(self.radius) * _norm(row) for row in self.B.tolist()]

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        if not (self._separate() and self._in_domain()):
            return False
        self.eta, self.offset = self._linear()
        shift = [[ball(*z) - c] for z, c in zip(self.z_bar, self.center, strict=True)]
        near = self.B.inv() * arb_mat(shift)
        return (
            min(self.radius, self.size, self.nu, self.above, self.inner, *self.bends) > 0
            and bool(_norm([row[0] for row in near.tolist()]) < self.inner)
            and self._one_to_one()
            and self._rises()
            and self._covers(data, share)
            and all(self._bend(k, beta) for k, beta in enumerate(self.bends, 2))
            and self._curved(self.energy.k, self.middle, self.A_K)
            and self._curved(self.energy.hc, self.center[self.r :], self.A_H)
        )

    def _separate(self) -> bool:
        """V = K(c) + Hc(ξ) up to a constant, in as many coordinates as there are states."""
        model, energy = self.checker.model, self.energy
        resting = {v: 0 for i, v in enumerate(model.z) if i not in energy.active}
        constant = not sp.sympify(model.H).subs(resting).free_symbols
        counted = self.d == energy.d == self.r + model.nc and self.r == len(model.casimirs)
        last = list(energy.active[self.r :]) == list(range(model.n, model.n + model.nc))
        shapes = [(m.nrows(), m.ncols()) for m in (self.B, self.A_K, self.A_H)]
        square = shapes == [(self.d, self.d), (self.r, self.r), (model.nc, model.nc)]
        plain = energy.phi is None and not energy.betas and len(self.bends) >= 2
        return constant and counted and last and square and plain

    def _in_domain(self) -> bool:
        bounds = self.checker.model.bounds()
        return all(
            bool(bounds[i][0] <= c - h) and bool(c + h <= bounds[i][1])
            for i, c, h in zip(self.energy.active, self.center, self.half, strict=True)
        )

    def _linear(self) -> tuple[arb, arb]:
        """(η, |θ(0)|): the singular values of M are within η of 1."""
        at: Box = tuple((c, c) for c in self.center)
        values, slopes = self.energy.casimirs(at)
        rows = (self.A_K * arb_mat(slopes)).tolist()
        rows += [[arb(0)] * self.r + row for row in self.A_H.tolist()]
        M = arb_mat(rows) * self.B
        gram = (M.transpose() * M).tolist()
        eta = _norm([v - int(i == j) for i, row in enumerate(gram) for j, v in enumerate(row)])
        shift = self.A_K * arb_mat([[v - m] for v, m in zip(values, self.middle, strict=True)])
        return eta, _norm([row[0] for row in shift.tolist()])

    def _one_to_one(self) -> bool:
        """On the ellipsoid, whose image covers |θ| ≤ size."""
        rho = arb(self.radius)
        turn = sum((b * rho ** (k - 1) / math.factorial(k - 1) for k, b in self._orders()), arb(0))
        least = (1 - self.eta) * rho - self.offset - self._curl(rho)
        return bool(turn < 1 - self.eta) and bool(least > self.size)

    def _orders(self) -> list[tuple[int, arb]]:
        return [(k, arb(b)) for k, b in enumerate(self.bends, 2)]

    def _curl(self, r: arb) -> arb:
        return sum((b * r**k / math.factorial(k) for k, b in self._orders()), arb(0))

    def _rises(self) -> bool:
        """V > c on |θ| = size, and V ≤ c on |w| ≤ inner."""
        k, dk, _ = self.energy.k(tuple((v, v) for v in self.middle))
        hc, dhc, _ = self.energy.hc(tuple((v, v) for v in self.center[self.r :]))
        parts = [
            A.inv().transpose() * arb_mat([[v] for v in g])
            for A, g in ((self.A_K, dk), (self.A_H, dhc))
        ]
        slope = _norm([row[0] for part in parts for row in part.tolist()])
        size, r = arb(self.size), arb(self.inner)
        most = (1 + self.eta) * r + self.offset + self._curl(r)  # of |θ| on |w| ≤ inner
        border = k + hc - slope * size + arb(self.nu) * size * size / 2
        highest = k + hc + slope * most + arb(self.above) * most * most / 2
        within = self.inner <= self.radius and bool(most <= size)
        return within and bool(border > self.level) and bool(highest <= self.level)

    def _bend(self, order: int, beta: float) -> bool:
        """βₖ bounds the tensor, flattened to a matrix, in the spectral norm."""
        last = order == len(self.bends) + 1
        pairs = zip(self.center, self.half, strict=True)
        box = tuple(ends(c + h * ball(-1, 1)) if last else (c, c) for c, h in pairs)
        rows = self.energy.casimir_derivatives(order, box)
        A, B = self.A_K, self.B
        if last:  # only magnitudes count where entries vary independently
            rows = [[abs(v).upper() for v in row] for row in rows]
            A, B = (arb_mat([[abs(v) for v in row] for row in X.tolist()]) for X in (A, B))
        flat = [v for row in (A * arb_mat(rows)).tolist() for v in row]
        for _ in range(order):
            n = len(flat) // self.d
            turned = (arb_mat(n, self.d, flat) * B).tolist()
            per = n // self.r  # the axis that was turned moves behind the rows of A
            flat = [
                turned[a * per + i][j]
                for a in range(self.r)
                for j in range(self.d)
                for i in range(per)
            ]
        X = arb_mat(self.r * self.d ** (order // 2), self.d ** (order - order // 2), flat)
        gram = X * X.transpose() if X.nrows() <= X.ncols() else X.transpose() * X
        room = -gram
        for i in range(room.nrows()):
            room[i, i] = room[i, i] + arb(beta) * arb(beta)
        return _positive(room, 0)

    def _curved(self, net: Net, middle: list[float], A: arb_mat) -> bool:
        """ν AᵀA ⪯ ∇² ⪯ above AᵀA on |A(v − middle)| ≤ size."""
        P, inverse = A.transpose() * A, A.inv()
        half = [arb(self.size) * _norm(row) for row in inverse.tolist()]
        box = tuple(ends(m + h * ball(-1, 1)) for m, h in zip(middle, half, strict=True))

        def test(piece: Box) -> bool:
            e = arb_mat([[ball(*b) - m] for b, m in zip(piece, middle, strict=True)])
            if _norm([row[0] for row in (A * e).tolist()]) > self.size:
                return True
            pairs, n = net(piece)[2], len(middle)
            hess = arb_mat([[pairs[min(i, j), max(i, j)] for j in range(n)] for i in range(n)])
            return _positive(hess - P * arb(self.nu), 0) and _positive(
                P * arb(self.above) - hess, 0
            )

        return everywhere(box, test, _DEPTH)

    def _covers(self, data: Mapping[str, Any], share: float) -> bool:
        """The ellipsoid |w| ≤ inner is in the region; its size is as claimed."""
        r, d = arb(self.inner), arb(self.d)
        volume = arb.pi() ** (d / 2) / (d / 2 + 1).gamma() * r**self.d * abs(self.B.det())
        for i in self.energy.active:
            lo, hi = self.checker.model.bounds()[i]
            volume = volume / (hi - lo)
        states = [self.checker.model.states[i] for i in self.energy.active]
        half = [r * _norm(row) for row in self.B.tolist()]
        reach = dict(zip(states, half, strict=True))
        sizes = all(
            bool(reach[key.removeprefix("reach_")] >= float(value))
            for key, value in data.items()
            if key.startswith("reach_")
        )
        return share == data["domain_share"] and bool(volume >= float(share)) and sizes


_PROOFS: dict[str, type[_Grid] | type[_Core] | type[_Chart]] = {
    "grid": _Grid,
    "core": _Core,
    "chart": _Chart,
}


class _Inputs:
    """u = −Gcᵀ∇Hc − D Gᵀ ∂V/∂x over boxes, the momenta s within ½ δ sᵀAs ≤ c_u − V(y, 0)."""

    def __init__(self, model: Model, energy: Energy, level: float) -> None:
        self.model, self.energy, self.level = model, energy, level
        self.resting = [i for i in range(len(model.z)) if i not in energy.active]
        self.driven = [
            (k, i) for k, i in enumerate(energy.active) if i < model.n and any(model.G.row(i))
        ]
        s = [model.z[i] for i in self.resting]
        self.A = sp.hessian(model.H, s) if s else sp.zeros(0)

    def covered(self) -> bool:
        """Whether the momenta enter u through Gᵀ Φ₁ A s alone."""
        model, s = self.model, [self.model.z[i] for i in self.resting]
        if not s:
            return True
        coupled = any(self.A.has(model.z[i]) for _, i in self.driven)
        return not (coupled or model.G.has(*s) or (self.driven and self.energy.phi is not None))

    def kept(self, box: Box) -> bool:
        """Whether u is within the limits wherever V ≤ c_u over a box."""
        return everywhere(box, self._within, _INPUT_DEPTH)

    def _within(self, box: Box) -> bool:
        room = self.level - self.energy.value(box)
        if room < 0:
            return True
        if not room.is_finite():
            return False
        model, gradient = self.model, self.energy.gradient(box)
        values = {v: ball(*b) for v, b in zip(self.energy.variables, box, strict=True)}
        slopes = self.energy.hc(box[-model.nc :])[1]
        G = [[evaluate(e, values) for e in row] for row in model.G.tolist()]
        Gc = [[evaluate(e, values) for e in row] for row in model.Gc.tolist()]
        stiff = [[evaluate(e, values) for e in row] for row in self.A.tolist()]
        for k, (lo, hi) in enumerate(model.u_limits or ()):
            damped = [sum((model.D[k][j] * g for j, g in enumerate(row)), arb(0)) for row in G]
            u = -sum((Gc[j][k] * slope for j, slope in enumerate(slopes)), arb(0))
            u = u - sum((damped[i] * gradient[at] for at, i in self.driven), arb(0))
            swing = self._swing([damped[i] for i in self.resting], stiff, room)
            if not (bool(u - swing >= float(lo)) and bool(u + swing <= float(hi))):
                return False
        return True

    def _swing(self, w: list[arb], A: list[list[arb]], room: arb) -> arb:
        """The most that Φ₁ wᵀAs can be."""
        form = sum((a * x * y for x, row in zip(w, A, strict=True)
                    for y, a in zip(w, row, strict=True)), arb(0))  # fmt: skip
        most = (form * 2 * room.upper()).upper()
        if not most.is_finite():
            return arb("inf")
        phi = self.energy.phi
        root = most.max(arb(0)).sqrt()
        if phi is None:
            return arb(root.upper())
        first, second = phi.layers[0][0], phi.layers[1][0]
        delta = arb(self.model.form["phi"]["delta"])
        slope = sum((first[i, 0] * second[0, i] for i in range(first.nrows())), delta)
        return arb((root * slope / delta.sqrt()).upper())


# --- small tools ----------------------------------------------------------------------------------


def _norm(v: Sequence[arb]) -> arb:
    if not all(x.is_finite() for x in v):
        return arb.nan()
    ends = [(x.abs_lower(), x.abs_upper()) for x in v]  # a ball around 0 squares badly
    low, high = (sum((end[k] * end[k] for end in ends), arb(0)) for k in (0, 1))
    return max(low.lower(), arb(0)).sqrt().union(high.upper().sqrt())


def _middle(A: arb_mat) -> np.ndarray[Any, Any]:
    return np.array([[float(v.mid()) for v in row] for row in A.tolist()])


def _hull(energy: Energy, box: Box) -> arb_mat:
    """∇²V over a box: between its bounds from below and from above, entry by entry.

    From L ⪯ A ⪯ U follows |A − (L+U)/2| ≤ ½ tr(U − L) in every entry.
    """
    low, high = energy.hessian(box), energy.hessian(box, -1)
    slack = arb(0)
    for i in range(low.nrows()):
        slack = slack + (high[i, i] - low[i, i]).abs_upper()
    middle = (low + high) / 2
    width = ball(-1.0, 1.0) * slack
    return arb_mat([[v + width for v in row] for row in middle.tolist()])


def _positive(A: arb_mat, mu: float) -> bool:
    """Whether A − μI ≻ 0: close to diagonal in the eigenvectors of its middle, then Gershgorin."""
    n = A.nrows()
    middle = _middle(A)
    if not np.isfinite(middle).all():
        return False
    values, vectors = np.linalg.eigh((middle + middle.T) / 2 - mu * np.eye(n))
    if values[0] <= 0:
        return False
    S = arb_mat((vectors / np.sqrt(values)).T.tolist())
    shifted = arb_mat(A)
    for i in range(n):
        shifted[i, i] = shifted[i, i] - mu
    B = S * shifted * S.transpose()
    rows = B.tolist()
    return all(
        bool(row[i] > sum((abs(v) for j, v in enumerate(row) if j != i), arb(0)))
        for i, row in enumerate(rows)
    )


def _lyapunov(A: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """A guess of P with AᵀP + PA = −I; what it is worth is decided afterwards.

    Newton's iteration for the matrix sign of [[A, 0], [I, −Aᵀ]], which is [[−I, 0], [2P, I]] where
    every eigenvalue of A has a negative real part.
    """
    if not np.isfinite(A).all():
        return None
    identity = np.eye(len(A))
    S, Q = A, identity
    for _ in range(_NEWTON_STEPS):
        try:
            inverse = np.linalg.inv(S)
        except np.linalg.LinAlgError:
            return None
        scale = np.sqrt(np.linalg.norm(inverse) / np.linalg.norm(S))
        S = (scale * S + inverse / scale) / 2
        Q = (scale * Q + inverse.T @ Q @ inverse / scale) / 2
        if not np.isfinite(Q).all() or np.abs(S + identity).max() < 1e-13 * len(A):
            break
    symmetric: np.ndarray[Any, Any] = (Q + Q.T) / 4
    return symmetric


def _exactly_positive(A: list[list[float]]) -> bool:
    """Whether the symmetric part is ≻ 0: pivots of exact elimination."""
    if not all(math.isfinite(v) for row in A for v in row):
        return False
    n = len(A)
    S = [[Fraction(A[i][j]) + Fraction(A[j][i]) for j in range(n)] for i in range(n)]
    for k in range(n):
        if S[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            factor = S[i][k] / S[k][k]
            S[i] = [a - factor * b for a, b in zip(S[i], S[k], strict=True)]
    return True
