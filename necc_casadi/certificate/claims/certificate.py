"""Certificate: the claims about a design and the numbers that the checker needs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import CERTIFICATE_FILE, CERTIFICATE_FORMAT, Claim
from necc_casadi.certificate.claims.curved import CurvedRegion
from necc_casadi.certificate.claims.disturbed import DisturbedRegion
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.claims.regions import (
    Lyapunov,
    Obstacle,
    Region,
    Side,
    Stability,
)
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.claims.units import Units
from necc_casadi.errors import OutputError

__all__ = ["Certificate"]


#: Claims that are needed where they are made.
_ASKED = {"region", "measurement", "integral", "local_integral", "setpoints", "family"}


@dataclass(frozen=True)
class Certificate:
    """What is proved about a design, for the continuous-time, unsaturated loop.

    Claims `sampled` and `disturbed` are about the loop of the C code.

    Every claim is about the V of the stored weights, read as exact binary numbers
    (docs/certificate-format.md).

    Examples
    --------
    >>> from necc_casadi import certify, design, find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> certificate = certify(made, region=False)
    >>> [claim.name for claim in certificate.claims if claim.holds][:3]
    ['equilibrium', 'casimir', 'structure']
    >>> certificate.from_json(certificate.to_json()) == certificate
    True
    """

    design_hash: str  # SHA-256 of design.json
    claims: tuple[Claim, ...]
    units: Units  # natural units, in those of the model
    z_bar: tuple[float, ...]  # (N,)
    enclosure: float | None  # the minimum of V is this close to z_bar, natural units
    mu: float | None  # ∇²V ⪰ μI on the ball around z*, natural units
    radius: float | None  # of that ball, natural units
    bound_rigorous: float | None  # ‖z̄ − z*‖ ≤ g/μ
    stability: Stability | None
    level: float | None = None  # c of the region {V ≤ c}
    level_above_minimum: float | None = None  # c − V(z̄) is at least this
    level_u: float | None = None  # c_u ≤ c with u within its limits on {V ≤ c_u}
    level_clipped: float | None = None  # c_y ≤ c with claims that hold for clipped u on {V ≤ c_y}
    obstacle: Obstacle | None = None  # what the region stays just below
    #: state → least and greatest value on the region; None: an angle that may take every value
    reach: Mapping[str, Side | None] | None = None
    is_global: bool = False
    region: Region | CurvedRegion | None = None  # in natural units

    @property
    def certified(self) -> bool:
        """Whether every claim that exit code 0 rests on holds."""
        made = {claim.name for claim in self.claims}
        held = {claim.name for claim in self.claims if claim.holds and not claim.data.get("left")}
        if "everywhere" in held:  # which says more of a family
            held.add("family")
        needed = {"equilibrium", "decrease"} | (made & _ASKED)
        return needed <= held and self.stability is not None

    @property
    def attracts_at_no_rate(self) -> bool:
        """Whether z̄ is proved to attract, and nothing of how fast."""
        rates = ("rate" in claim.data for claim in self.claims if claim.name == "attraction")
        return self.stability == "asymptotic" and not any(rates)

    @property
    def of_the_whole_space(self) -> bool:
        """Whether what is claimed of solutions is claimed from everywhere."""
        return any(claim.name == "global" and claim.holds for claim in self.claims)

    @property
    def sampled(self) -> SampledRegion | None:
        """The region of the sampled loop, natural units; None: none is proved."""
        held = (c for c in self.claims if c.name == "sampled" and c.holds)
        return next((SampledRegion.read(claim.data) for claim in held), None)

    @property
    def disturbed(self) -> DisturbedRegion | None:
        """Where that loop stays under disturbances, natural units; None: nothing is proved."""
        held = (c for c in self.claims if c.name == "disturbed" and c.holds)
        return next((DisturbedRegion.read(claim.data) for claim in held), None)

    @property
    def limited_by(self) -> str | None:
        """What the region stays just below, in words."""
        return None if self.obstacle is None else statements.limited_by(self.obstacle)

    @property
    def obstacle_share(self) -> float | None:
        """How much of the obstacle's height above V(z̄) the region reaches."""
        if self.obstacle is None or self.level_above_minimum is None:
            return None
        return self.level_above_minimum / self.obstacle.level_above_minimum

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether a state z (N,) is in Ω, by plain evaluation of V; False where none is proved.

        Where the whole space is proved and no region besides, every finite state is.
        """
        if self.region is None:
            return self.of_the_whole_space and all(map(math.isfinite, z))
        units = self.units.state
        natural = [v / unit for v, unit in zip(z, units, strict=True)]

        def value(at: Sequence[float]) -> float:
            return V([v * unit for v, unit in zip(at, units, strict=True)]) / self.units.energy

        return self.region.contains(value, natural)

    def having(self, *claims: Claim) -> Certificate:
        """The certificate with more claims."""
        return replace(self, claims=(*self.claims, *claims))

    def to_json(self) -> str:
        """The content of certificate.json."""
        data = {"format": CERTIFICATE_FORMAT, **asdict(self)}
        return json.dumps(_finite(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str, label: str = CERTIFICATE_FILE) -> Certificate:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        OutputError
            When it is not a certificate of this format.
        """
        try:
            return cls.read(json.loads(text), label)
        except (KeyError, TypeError, ValueError, AttributeError) as problem:
            fault = f"{label} is not a certificate: {problem!r}"
            raise OutputError("output", fault, _REMEDY) from None

    @classmethod
    def read(cls, data: Mapping[str, Any], label: str = CERTIFICATE_FILE) -> Certificate:
        """The object of certificate.json, of which every entry is asked for.

        What is within the `data` of a claim is left to whoever proves the claim.

        Raises
        ------
        OutputError
            When it has another format.
        KeyError, TypeError, ValueError
            When an entry is missing or has another type.
        """
        if (found := data["format"]) != CERTIFICATE_FORMAT:
            raise OutputError("output", f"{label} has format {found!r:.20}", _REMEDY)
        return read_as(cls, data, region=_read_region)


def _read_region(data: Mapping[str, Any]) -> Region | CurvedRegion:
    return read_as(CurvedRegion, data) if data["method"] == "curved" else read_as(Region, data)


_REMEDY = f"Run necc-design again; this version reads format {CERTIFICATE_FORMAT}."


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
