"""One statement of a certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["CERTIFICATE_FILE", "CERTIFICATE_FORMAT", "DESIGN_FILE", "PLANT_FILE", "Claim"]


#: Version of the layout of certificate.json.
CERTIFICATE_FORMAT = 5


#: Names in a folder of necc-design: what is claimed, and what it is claimed about.
CERTIFICATE_FILE, DESIGN_FILE, PLANT_FILE = "certificate.json", "design.json", "plant.json"


@dataclass(frozen=True)
class Claim:
    """A statement in plain words, and whether it is proved."""

    name: str
    holds: bool
    statement: str
    data: Mapping[str, Any] = field(default_factory=dict)  # numbers that the checker needs
