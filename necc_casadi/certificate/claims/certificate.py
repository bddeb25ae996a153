"""Certificate: the claims about a design and the numbers that the checker needs."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from typing import Any

from necc_casadi.certificate.claims.claim import CERTIFICATE_FORMAT, Claim
from necc_casadi.certificate.claims.regions import ChartRegion, EllipsoidRegion, GridRegion, Region
from necc_casadi.errors import OutputError

__all__ = ["Certificate"]


@dataclass(frozen=True)
class Certificate:
    """What is proved about a design, for the continuous-time, unsaturated loop.

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
    z_bar: tuple[float, ...]  # (N,)
    enclosure: float | None  # the minimum of V is this close to z_bar
    mu: float | None  # ∇²V ⪰ μI on the ball around z*
    radius: float | None  # of that ball
    bound_rigorous: float | None  # ‖z̄ − z*‖ ≤ g/μ
    stability: str | None  # "asymptotic", "stable" or None
    level: float | None = None  # c of the region {V ≤ c}
    level_u: float | None = None  # c_u ≤ c with u within its limits on {V ≤ c_u}
    limited_by: str | None = None
    domain_share: float | None = None  # of the domain, momenta at rest: a lower bound
    is_global: bool = False
    region: Region | None = None

    @property
    def certified(self) -> bool:
        """Whether every claim that exit code 0 rests on holds."""
        made = {claim.name for claim in self.claims}
        held = {claim.name for claim in self.claims if claim.holds}
        needed = {"equilibrium", "decrease"} | (made & {"region"})
        return needed <= held and self.stability is not None

    def to_json(self) -> str:
        """The content of certificate.json."""
        data = {"format": CERTIFICATE_FORMAT, **asdict(self)}
        return json.dumps(_finite(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str, label: str = "certificate.json") -> Certificate:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        OutputError
            When it is not a certificate of this format.
        """
        remedy = f"Design it again; this version reads format {CERTIFICATE_FORMAT}."
        try:
            data = json.loads(text)
            if data.pop("format") != CERTIFICATE_FORMAT:
                raise OutputError("output", f"{label} has another format", remedy)
            data["claims"] = tuple(Claim(**claim) for claim in data["claims"])
            data["z_bar"] = tuple(float(v) for v in data["z_bar"])
            if data["region"] is not None:
                data["region"] = _region(data["region"])
            return cls(**{f.name: data[f.name] for f in fields(cls)})
        except (KeyError, TypeError, ValueError, AttributeError) as problem:
            raise OutputError(
                "output", f"{label} is not a certificate: {problem!r}", remedy
            ) from None


def _region(data: dict[str, Any]) -> Region:
    def tuples(value: Any) -> Any:
        return tuple(tuples(v) for v in value) if isinstance(value, list) else value

    kinds: dict[str, type[Region]] = {
        "grid": GridRegion,
        "core": EllipsoidRegion,
        "chart": ChartRegion,
    }
    kind = kinds[data["method"]]
    return kind(**{key: tuples(value) for key, value in data.items()})


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
