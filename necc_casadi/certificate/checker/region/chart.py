"""A region in the coordinates (c, ξ), where V is a sum and which the states map to one-to-one.

The steps are those of the prover's chart.py, which gives the argument; none of its numbers counts
before it is proved here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, norm
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.evidence import Evidence, Obligation
from necc_casadi.certificate.checker.region.fibre import Fibre, FibreChart
from necc_casadi.certificate.checker.region.shells import NetworkCurvature, Shells
from necc_casadi.certificate.checker.region.sizes import ball_volume, sides_of, sizes_hold
from necc_casadi.certificate.checker.region.transport import Transport
from necc_casadi.certificate.claims.regions import ChartRegion, LimitedBy, Rows

__all__ = ["ChartProof"]


#: Shells of |η| on the way from the fibre.
_STEPS = 16


#: Parts per axis on which ∂c/∂q is bounded for the volume, and of ways along which V is.
_COARSE, _PIECES = 3, 32


class ChartProof:
    """V = e₀ + K(c) + Hc(ξ): growth of K and Hc, a fibre without folds, motion within the domain.

    Where V ≤ c, k(|α|) + k_H(|η|) is at most c − V(ȳ), with α = A_K(c − c̄), η = A_H(ξ − ξ̄). On the
    fibre ξ = ξ̄ the cells with |α| ≤ a lie inside its box, and ∂α/∂q is regular on them; from there
    q stays in the domain while ξ moves to |η| ≤ b along the Casimirs.
    """

    def __init__(self, evidence: Evidence, energy: Energy, region: ChartRegion, z_bar: Box) -> None:
        self.model, self.energy, self.region, self.z_bar = evidence.model, energy, region, z_bar
        self.d, self.r = len(region.center), len(region.middle)
        self.q_bar, self.xi_bar = region.center[: self.r], region.center[self.r :]
        self.A_K, self.A_H = _matrix(region.scale_k), _matrix(region.scale_h)
        self.q, self.xi = energy.variables[: self.r], energy.variables[self.r :]
        self.resting = [i for i in range(len(self.model.z)) if i not in region.active]

    def hull(self) -> Box:
        """A box of the active states that holds the region: q in the domain, |η| ≤ b."""
        bounds = [self.model.bounds[i] for i in self.region.active[: self.r]]
        q = [(ends(lo)[0], ends(hi)[1]) for lo, hi in bounds]
        return (*q, *self.hc.box(self.region.b))

    def boxes(self) -> list[Box] | None:
        """No boxes of the region are known but its hull."""
        return None

    def ends_at(self, limit: LimitedBy) -> bool:
        """No cell limits a region in these coordinates."""
        return False

    def obligations(self, sizes: Mapping[str, float], share: float) -> list[Obligation]:
        """The sum, growth of K and Hc, the fibre, the motion from it, and the sizes."""
        region = self.region
        return [
            ("V is a sum in (c, ξ)", self._separate),
            ("the scales are regular", self._scaled),
            ("a, b and `above` are positive", lambda: min(region.a, region.b, region.above) > 0),
            ("V ≤ c near z̄", self._holds_z_bar),
            ("K rises on its shells, and is curved as claimed", lambda: self.k.holds()),
            ("Hc rises on its shells, and is curved as claimed", lambda: self.hc.holds()),
            ("|α| ≤ a and |η| ≤ b where V ≤ c", self._bounded),
            ("ξ stays in the domain", self._xi_inside),
            ("the fibre has no fold where |α| ≤ a", lambda: self.fibre is not None),
            ("q stays in the domain on the way to |η| ≤ b", lambda: self.reached is not None),
            ("the sizes claimed", lambda: sizes_hold(self._sizes(sizes), sizes, share)),
        ]

    @cached_property
    def k(self) -> Shells:
        """Growth of K."""
        region, f = self.region, NetworkCurvature(self.energy.k)
        return Shells(f, region.middle, self.A_K, region.radii_k, region.nu_k, region.above)

    @cached_property
    def hc(self) -> Shells:
        """Growth of Hc."""
        region, f = self.region, NetworkCurvature(self.energy.hc)
        return Shells(f, self.xi_bar, self.A_H, region.radii_h, region.nu_h, region.above)

    @cached_property
    def columns(self) -> tuple[sp.Matrix, sp.Matrix]:
        """(A(q), B(ξ)): the columns of Jcl − Rcl that belong to the momenta."""
        M = self.model.Jcl - self.model.Rcl
        columns = M.extract(list(self.region.active), self.resting)
        return columns[: self.r, :], columns[self.r :, :]

    def _separate(self) -> bool:
        """V = K(c) + Hc(ξ) up to a constant, and motions along Casimirs from the momenta."""
        model, energy = self.model, self.energy
        counted = self.d == energy.d == self.r + model.nc and self.r == len(model.casimirs)
        last = list(energy.active[self.r :]) == list(range(model.n, model.n + model.nc))
        last = last and list(self.xi_bar) == model.xi_star
        if not (counted and last and len(self.resting) == model.nc):
            return False
        along, across = self.columns
        apart = not (along.free_symbols - set(self.q) or across.free_symbols - set(self.xi))
        return apart and energy.phi is None and not energy.betas and not self._rest.free_symbols

    @property
    def _rest(self) -> sp.Expr:
        """H with the momenta at rest: e₀, where it is constant."""
        at_rest = dict.fromkeys((self.model.z[i] for i in self.resting), 0)
        return sp.sympify(self.model.H).subs(at_rest)

    def _scaled(self) -> bool:
        sizes = ((self.A_K, self.r), (self.A_H, self.model.nc))
        square = all((A.nrows(), A.ncols()) == (size, size) for A, size in sizes)
        boxed = len(self.region.fibre) == self.r
        return square and boxed and all(bool(abs(A.det()) > 0) for A, _ in sizes)

    def _holds_z_bar(self) -> bool:
        pairs = zip(self.region.center, self.z_bar, strict=True)
        near = tuple((min(c, lo), max(c, hi)) for c, (lo, hi) in pairs)
        return bool(self.energy.value(near) <= self.region.level)

    @cached_property
    def height(self) -> arb:
        """What K and Hc may rise by together where V ≤ c."""
        return arb(arb(self.region.level) - self._bottom + self.k.dip() + self.hc.dip())

    @cached_property
    def _bottom(self) -> arb:
        """e₀ + K(c̄) + Hc(ξ̄), above which K and Hc grow."""
        return arb(evaluate(self._rest, {}) + self.k.bottom + self.hc.bottom)

    def _bounded(self) -> bool:
        """|α| ≤ a and |η| ≤ b wherever V ≤ c, on the shells."""
        a, b = self.region.a, self.region.b
        reached = a <= self.region.radii_k[-1] and b <= self.region.radii_h[-1]
        outside = self.k.at(arb(a)) > self.height and self.hc.at(arb(b)) > self.height
        return reached and bool(outside)

    def _xi_inside(self) -> bool:
        states = self.region.active[self.r :]
        return self.model.in_domain(states, self.hc.box(self.region.b))

    @cached_property
    def _tapes(self) -> tuple[Tape, Tape]:
        """C and ∂c/∂q."""
        casimirs, y = self.model.casimirs, self.energy.variables
        return Tape(casimirs, y), Tape([sp.diff(c, s) for c in casimirs for s in self.q], y)

    @cached_property
    def fibre(self) -> Fibre | None:
        """Cells of the fibre that cover |α| ≤ a; None where they are not proved to."""
        chart = FibreChart(*self._tapes, self.xi_bar, self.region.middle, self.A_K)
        box: Box = tuple((lo, hi) for lo, hi in self.region.fibre)
        return chart.cover(box, self.q_bar, self.region.a)

    @cached_property
    def reached(self) -> list[arb] | None:
        """A box in the domain that q does not leave on the way to |η| ≤ b; None: not proved."""
        return None if self.fibre is None else self._transported(self.fibre)

    def _transported(self, fibre: Fibre) -> list[arb] | None:
        radii = [arb(self.region.b) * k / _STEPS for k in range(_STEPS + 1)]
        starts = [fibre.within(self._radius(self.height - self.hc.at(rho))) for rho in radii[:-1]]
        along, across = self.columns
        cut = [k for k, s in enumerate(self.q) if along.has(s)]
        transport = Transport(
            Tape(list(along), self.q), Tape(list(across), self.xi), cut,
            self.xi_bar, self.A_H.inv(), radii, starts,
        )  # fmt: skip
        states = self.region.active[: self.r]

        def inside(box: list[arb]) -> bool:
            return self.model.in_domain(states, [(v.lower(), v.upper()) for v in box])

        return transport.hull(inside)

    def _radius(self, height: arb) -> arb:
        """A radius beyond which K rises by more than `height`, at most a; by bisection."""
        low, high = arb(0), arb(self.region.a)
        for _ in range(30):
            middle = arb(((low + high) / 2).mid())
            low, high = (low, middle) if self.k.at(middle) > height else (middle, high)
        return high

    # --- sizes ------------------------------------------------------------------------------------

    def _sizes(self, claimed: Mapping[str, float]) -> dict[str, arb]:
        """Lower bounds of what Ω covers; a claimed reach in q counts where it is proved."""
        model, active, fibre = self.model, self.region.active, self.fibre
        rho = self._inner()
        scale = abs(self.A_K.det() * self.A_H.det())
        volume = ball_volume(self.d) * rho**self.d / (scale * self._steepest())
        covered = sum((_volume(cell) for cell in fibre.around(rho)), arb(0)) if fibre else arb(0)
        reach = {f"reach_{model.states[i]}": k for k, i in enumerate(active[: self.r])}
        far = {name: claimed[name] for name in reach if name in claimed}
        # every ξ with |η| ≤ rho is reached from q̄ along the Casimirs
        half = zip(active[self.r :], self.hc.half_axes(rho), strict=True)
        return {
            "volume": volume,
            "domain_share": volume / sides_of(model, active),
            "slice_share": covered / sides_of(model, active[: self.r]),
            **{
                name: arb(s)
                for name, s in far.items()
                if self._reaches(reach[name], (arb(s) + self._offset(reach[name])).upper())
            },
            **{
                f"reach_{model.states[i]}": h - self._offset(self.r + k)
                for k, (i, h) in enumerate(half)
            },
        }

    def _inner(self) -> arb:
        """A radius of (α, η) up to which V ≤ c."""
        region = self.region
        height = (arb(region.level) - self._bottom).max(arb(0))
        slope = norm([self.k.slope, self.hc.slope])
        root = (slope * slope + 2 * region.above * height).sqrt()
        return arb(((root - slope) / region.above).lower().min(arb(region.a)).min(arb(region.b)))

    def _steepest(self) -> arb:
        """An upper bound of Π ‖∂cᵢ/∂q‖ on the region."""
        sides = [*(ends(v) for v in self.reached or []), *self.hc.box(self.region.b)]
        cuts = [
            list(pairwise([*(lo + (hi - lo) * k / _COARSE for k in range(_COARSE)), hi]))
            for lo, hi in sides
        ]
        most = arb(0)
        for box in itertools.product(*cuts):
            slopes, product = self._tapes[1]([ball(*b) for b in box]), arb(1)
            for i in range(self.r):
                product = product * norm(slopes[i * self.r : (i + 1) * self.r]).upper()
            most = most.max(product)
        return most

    def _offset(self, k: int) -> arb:
        """How far z̄ may be from ȳ in a state."""
        return arb(abs(ball(*self.z_bar[k]) - self.region.center[k]).upper())

    @cached_property
    def _ways(self) -> np.ndarray[Any, Any]:
        """Directions in which Ω reaches far in each state, a guess."""
        at: Box = tuple((v, v) for v in self.region.center)
        return np.asarray(np.linalg.inv(middle_of(self.energy.hessian(at))))

    def _reaches(self, k: int, s: arb) -> bool:
        """Whether straight ways to points s away in the k-th state, on both sides, stay in Ω."""
        way, far = self._ways[k] / self._ways[k, k], math.nextafter(float(s), math.inf)
        return all(self._below(sign * far, way.tolist()) for sign in (-1.0, 1.0))

    def _below(self, s: float, way: Sequence[float]) -> bool:
        for k in range(_PIECES):
            low, high = s * k / _PIECES, s * (k + 1) / _PIECES
            pairs = [
                (c + low * w, c + high * w) for c, w in zip(self.region.center, way, strict=True)
            ]
            piece: Box = tuple((min(p), max(p)) for p in pairs)
            inside = self.model.in_domain(self.region.active, piece)
            if not (inside and bool(self.energy.value(piece) <= self.region.level)):
                return False
        return True


def _volume(cell: Box) -> arb:
    result = arb(1)
    for lo, hi in cell:
        result = result * (arb(hi) - arb(lo))
    return result


def _matrix(rows: Rows) -> arb_mat:
    return arb_mat([list(row) for row in rows])
