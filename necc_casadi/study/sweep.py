"""Many designs of one model: set-points, parameters and seeds on a grid, one row each."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from necc_casadi.errors import InputError
from necc_casadi.model.model_file import Model
from necc_casadi.model.target import free_coordinates
from necc_casadi.pipeline.request import Request
from necc_casadi.pipeline.run import run_design
from necc_casadi.report.findings import Findings
from necc_casadi.study.rows import Row
from necc_casadi.study.vary import Axis, grid
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.floats import to_float

__all__ = ["TARGET", "Sweep", "what_varies"]


#: Stands for the whole text of the target.
TARGET = "target"


#: What each design is described by.
_FOUND = (
    "status", "code", "reason", "stability", "a_max", "loss", "distance", "spectral_abscissa",
    "proved", "global", "level_above_minimum", "domain_share", "simulated_share", "arrived",
    "settled", "settling_time", "peak_u", "cost_to_lqr",
)  # fmt: skip


@dataclass(frozen=True)
class Sweep:
    """Designs are numbered along the grid; each is what ``necc-design`` makes of its values."""

    request: Request
    source: str  # content of the model file
    states: tuple[str, ...]
    axes: tuple[Axis, ...]

    @property
    def count(self) -> int:
        """Number of designs."""
        return int(np.prod([len(axis.values) for axis in self.axes]))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the values in a row."""
        return (*(axis.name for axis in self.axes), *_FOUND)

    @property
    def study(self) -> Mapping[str, Any]:
        """What tells this study from others."""
        asked = asdict(self.request)
        for place in ("model", "out", "command", "plots", "format"):
            asked.pop(place)
        return {
            "study": "sweep",
            "format": 1,
            "model": hashlib.sha256(self.source.encode()).hexdigest(),
            "vary": {axis.name: list(axis.values) for axis in self.axes},
            "asked": asked,
        }

    def row(self, index: int) -> Row:
        """The design of this number: verdict, proofs and responses; or why there is none."""
        values = grid(self.axes, index)
        numbers = [_plain(axis, values[axis.name]) for axis in self.axes]
        try:
            return [*numbers, *_described(self._found(values))]
        except InputError as problem:
            return [*numbers, "error", problem.code, *[None] * (len(_FOUND) - 2)]

    def _found(self, values: Mapping[str, str]) -> Findings:
        seed = int(values["seed"]) if "seed" in values else self.request.chosen.seed
        target = self._target(values)
        changed = [
            f"{name}={value}"
            for name, value in values.items()
            if name not in (TARGET, "seed", *self.states)
        ]
        request = replace(
            self.request,
            out=None,
            target=target,
            param=(*self.request.param, *changed),
            chosen=replace(self.request.chosen, seed=seed),
        )
        if isinstance(request.model, Path) and not _holds(request.model, self.source):
            with tempfile.TemporaryDirectory() as folder:  # a worker on another machine
                model = Path(folder) / request.model.name
                model.write_text(self.source, encoding="utf-8")
                return run_design(replace(request, model=model), _quiet)
        return run_design(request, _quiet)

    def _target(self, values: Mapping[str, str]) -> str | None:
        """The text of the target, with the states that vary in place of their values."""
        if TARGET in values:
            return values[TARGET]
        moved = {name: value for name, value in values.items() if name in self.states}
        if not moved:
            return self.request.target
        said = dict(part.split("=", 1) for part in (self.request.target or "").split(",") if part)
        return ",".join(f"{name}={value}" for name, value in {**said, **moved}.items())


def what_varies(model: Model, target: str | None) -> list[str]:
    """Names that ``--vary`` knows for a model, with the target that is given beside it.

    States may vary beside a target that names states.
    """
    _, dimension = free_coordinates(model.loop.plant)
    names = [TARGET] if target is None and dimension > 0 else []
    named = target is None or all("=" in part for part in target.split(","))
    states = list(model.loop.plant.states) if named else []
    return [*names, *states, *model.params]


def _holds(path: Path, source: str) -> bool:
    try:
        return path.read_text(encoding="utf-8") == source
    except (OSError, UnicodeDecodeError):
        return False


def _plain(axis: Axis, value: str) -> float | int:
    return int(value) if axis.name == "seed" else to_float(parse(value))


def _described(found: Findings) -> Row:
    published = found.found.published
    verdict = None if published is None else published.verdict
    made, certificate = found.design, found.certificate
    measures, choice = found.measures, found.choice
    settled = [r.settling_time for r in found.responses if r.converged]
    claims = () if certificate is None else certificate.claims
    return [
        found.status,
        None,
        None if verdict is None else verdict.reason,
        certificate.stability if certificate is not None else verdict and verdict.stability,
        None if verdict is None else verdict.a_max,
        None if measures is None else measures.loss,
        None if measures is None else measures.distance,
        None if measures is None else float(measures.spectrum[0].real),
        " ".join(claim.name for claim in claims if claim.holds) or None,
        None if certificate is None else certificate.is_global,
        None if certificate is None else certificate.level_above_minimum,
        found.domain_share,
        found.simulated_share,
        None if choice is None else choice.kept.arrivals,
        len(settled) if made is not None else None,
        max(settled, default=None),
        max((r.peak_input for r in found.responses), default=None),
        None if choice is None else choice.kept.cost_to_lqr,
    ]


def _quiet(_text: str) -> None:
    """Workers say nothing."""
