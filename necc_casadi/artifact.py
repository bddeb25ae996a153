"""Design: everything a finished design is, saved and loaded without ``eval`` and without pickle.

``design.json`` holds expressions as text that :func:`necc_casadi.expressions.parse` reads, and
every float as an exact hexadecimal literal, so that a loaded design is the saved one bit for bit.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from necc_casadi import __version__
from necc_casadi.assignability import Verdict
from necc_casadi.casimirs import Casimirs
from necc_casadi.errors import OutputError
from necc_casadi.expressions import identifiers, parse, to_text
from necc_casadi.learned import Residual
from necc_casadi.loop import ClosedLoop, Controller
from necc_casadi.lyapunov import Form, LyapunovFunction, make_terms
from necc_casadi.networks import ACTIVATIONS, MonotonePhi, Network, Vector
from necc_casadi.outcome import Start
from necc_casadi.plant import Plant, Property

__all__ = ["FORMAT", "Design", "write_text"]

#: Version of the layout of design.json.
FORMAT = 1


@dataclass(frozen=True, eq=False)
class Design:
    """A finished design: model, Casimirs, verdict, weights, equilibrium and damping."""

    loop: ClosedLoop
    casimirs: Casimirs
    x_star: tuple[sp.Expr, ...]  # (n,) exact
    verdict: Verdict
    form: Form
    weights: Vector  # (form.size,)
    xi_star: Vector  # (nc,)
    D: Vector  # m × m
    Dc: Vector  # m × m
    a: float  # curvature asked of ∇²V(z*)
    a_requested: float
    seed: int
    starts: tuple[Start, ...] = ()
    learned: Residual | None = None  # of a learned Casimir; None: Casimirs in closed form
    versions: Mapping[str, str] = field(default_factory=lambda: package_versions())

    @cached_property
    def lyapunov(self) -> LyapunovFunction:
        """V, its derivatives and the control law as CasADi functions."""
        terms = make_terms(self.loop, self.casimirs)
        return LyapunovFunction(terms, self.form, self.weights, self.D, self.Dc)

    @cached_property
    def z_star(self) -> Vector:
        """(x*, ξ*) in double precision, (n + nc,)."""
        return np.concatenate([[float(sp.N(v, 20)) for v in self.x_star], self.xi_star])

    def control(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> tuple[Vector, Vector]:
        """The controller: plant state (n,), controller state (nc,) -> u (m,), ξ̇ (nc,)."""
        u, xi_dot = self.lyapunov.control_law(np.asarray(x, float), np.asarray(xi, float))
        return np.asarray(u, float).ravel(), np.asarray(xi_dot, float).ravel()

    def V(self, z: npt.ArrayLike) -> float:
        """The Lyapunov function at z = (x, ξ), (n + nc,)."""
        return float(self.lyapunov.V(np.asarray(z, float)))

    @cached_property
    def z_bar(self) -> Vector:
        """The minimum of V near z*, by Newton's method on ∇V, (n + nc,)."""
        z = self.z_star
        for _ in range(20):
            g = np.asarray(self.lyapunov.gradient(z), float).ravel()
            step = np.linalg.lstsq(np.asarray(self.lyapunov.hessian(z), float), g, rcond=None)[0]
            z = z - step
            if np.linalg.norm(step) <= 4 * np.finfo(float).eps * max(1.0, float(np.linalg.norm(z))):
                break
        return z

    def linearise(self) -> tuple[Vector, Vector, Vector, Vector]:
        """State-space matrices (A, B, C, D) of the damped loop at z̄, ready for python-control.

        Inputs are the ports (v, v_c) added to the damping, outputs are (y, y_c):
        A (n + nc)², B (n + nc) × 2m, C 2m × (n + nc), D = 0.
        """
        z = self.z_bar
        values = dict(zip(self.loop.z, z, strict=True))
        B = np.array(self.loop.ports.subs(values).evalf(), dtype=float)
        return (
            self.lyapunov.linearisation(z),
            B,
            self._port_jacobian(z),
            np.zeros((B.shape[1],) * 2),
        )

    def _port_jacobian(self, z: Vector) -> Vector:
        import casadi as ca

        V, terms = self.lyapunov, self.lyapunov.terms
        s = ca.MX.sym("z", z.size)
        x, xi = s[: terms.n], s[terms.n :]
        s_c = ca.MX.sym("xi", terms.nc)
        energy = self.form.controller_energy(ca.DM(self.weights))(s_c)
        grad_Hc = ca.Function("grad_Hc", [s_c], [ca.gradient(energy, s_c)])
        y = ca.vertcat(V.terms.G(x).T @ terms.grad_H(x), terms.Gc(xi).T @ grad_Hc(xi))
        return np.asarray(ca.Function("C", [s], [ca.jacobian(y, s)])(z), float)

    @cached_property
    def text(self) -> str:
        """The exact content of design.json."""
        return json.dumps(_to_dict(self), indent=1, ensure_ascii=False) + "\n"

    @cached_property
    def hash(self) -> str:
        """SHA-256 of design.json."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def save(self, path: str | Path) -> Path:
        """Write design.json at `path`, whole or not at all."""
        return write_text(Path(path), self.text)

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """Read a design.json, or the folder that holds one.

        Raises
        ------
        OutputError
            When there is none, or it is not a design of this format.
        """
        path = Path(path)
        path = path / "design.json" if path.is_dir() else path
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as problem:
            reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
            raise OutputError(
                "output", f"{path} cannot be read: {reason}", "Name a folder of necc-design."
            ) from None
        return cls.from_text(text, str(path))

    @classmethod
    def from_text(cls, text: str, label: str = "design.json") -> Design:
        """Rebuild a design from the content of design.json; `label` names it in errors."""
        remedy = f"Design it again; this version reads format {FORMAT}."
        try:
            data = json.loads(text)
            if data.get("format") != FORMAT:
                raise OutputError("output", f"{label} has format {data.get('format')!r}", remedy)
            design = _from_dict(data)
            _check_whole(design, data)
            return design
        except _BROKEN as problem:
            raise OutputError("output", f"{label} is not a design: {problem!r}", remedy) from None


#: What reading a file that is no design can raise.
_BROKEN = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)


def package_versions() -> dict[str, str]:
    """Versions of this package and of those whose arithmetic a design rests on."""
    others = ("casadi", "numpy", "sympy", "python-flint")
    return {"necc-casadi": __version__} | {name: metadata.version(name) for name in others}


def write_text(path: Path, content: str | bytes) -> Path:
    """Write a file under a temporary name and rename it into place.

    Raises
    ------
    OutputError
        When the folder cannot be made or written; nothing is left behind then.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as problem:
        raise OutputError(
            "output",
            f"{path} cannot be written: {problem.strerror or problem}",
            "Choose a folder that can be written with --out.",
        ) from None
    return path


# --- the layout of design.json ------------------------------------------------------------------


def _hex(values: Vector) -> Any:
    return [_hex(v) for v in values] if np.ndim(values) else float(values).hex()


def _unhex(values: Any) -> Vector:
    if isinstance(values, list):
        return np.array([_unhex(v) for v in values], dtype=float)
    return np.float64(float.fromhex(values))  # type: ignore[return-value]


def _to_dict(design: Design) -> dict[str, Any]:
    symbols = identifiers(design.loop.states)
    rename = {s: sp.Symbol(i, real=True) for s, i in zip(design.loop.z, symbols, strict=True)}

    @cache  # large matrices hold few different entries
    def entry(value: sp.Expr) -> str:
        return to_text(value.xreplace(rename))

    def text(value: Any) -> Any:
        if value is None:
            return None
        if isinstance(value, sp.MatrixBase):
            return [[entry(v) for v in row] for row in value.tolist()]
        if isinstance(value, (tuple, list)):
            return [text(v) for v in value]
        return entry(sp.sympify(value))

    plant, controller = design.loop.plant, design.loop.controller
    model = {
        "name": plant.name,
        "states": list(plant.states),
        "controller_states": list(controller.states),
        "symbols": symbols,
        **{key: text(getattr(plant, key)) for key in ("J", "R", "G", "H")},
        **{key: text(getattr(controller, key)) for key in ("Jc", "Rc", "Gc")},
        "units": dict(plant.units),
        "domain": {name: text(bounds) for name, bounds in plant.domain.items()},
        "u_limits": plant.u_limits,
        "properties": [asdict(p) for p in design.loop.properties],
        "plant_properties": len(plant.properties),
    }
    verdict = design.verdict
    return {
        "format": FORMAT,
        "versions": dict(design.versions),
        "model": model,
        "model_hash": _model_hash(model),
        "casimirs": {
            "functions": text(design.casimirs.functions),
            "kernel_rank": design.casimirs.kernel_rank,
            "generic_count": design.casimirs.generic_count,
            "origins": list(design.casimirs.origins),
            "count_proved": design.casimirs.count_proved,
        },
        "target": text(design.x_star),
        "verdict": {
            **{k: getattr(verdict, k) for k in _VERDICT_PLAIN},
            **{k: text(getattr(verdict, k)) for k in _VERDICT_TEXT},
        },
        "form": {
            "hc": asdict(design.form.hc),
            "k": asdict(design.form.k),
            "betas": [asdict(beta) for beta in design.form.betas],
            "phi": None if design.form.phi is None else asdict(design.form.phi),
        },
        "a": float(design.a).hex(),
        "a_requested": float(design.a_requested).hex(),
        "xi_star": _hex(design.xi_star),
        "D": _hex(design.D),
        "Dc": _hex(design.Dc),
        "seed": design.seed,
        "starts": [asdict(start) for start in design.starts],
        "learned": None if design.learned is None else asdict(design.learned),
        "weights": _hex(design.weights),
    }


def _model_hash(model: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(model, sort_keys=True).encode()).hexdigest()


def _check_whole(design: Design, data: Mapping[str, Any]) -> None:
    """Raise ValueError where the parts of a file do not belong together."""
    plant, controller, form = design.loop.plant, design.loop.controller, design.form
    n, nc, m = plant.n, controller.nc, plant.m
    r = len(design.casimirs.functions)
    if data["model_hash"] != _model_hash(data["model"]):
        raise ValueError("the model was edited: its hash differs")
    shapes = {
        "weights": (design.weights, (form.size,)),
        "xi_star": (design.xi_star, (nc,)),
        "D": (design.D, (m, m)),
        "Dc": (design.Dc, (m, m)),
        "target": (np.array([float(sp.N(v, 20)) for v in design.x_star]), (n,)),
    }
    for name, (values, shape) in shapes.items():
        if np.shape(values) != shape or not np.all(np.isfinite(values)):
            raise ValueError(f"{name} must hold finite numbers of shape {shape}")
    if min(np.linalg.eigvalsh(damping)[0] for damping in (design.D, design.Dc)) <= 0:
        raise ValueError("D and Dc must be positive definite")
    inputs = [form.hc.inputs, form.k.inputs, *[beta.inputs for beta in form.betas]]
    if inputs != [nc, *([1] * (1 + r) if form.betas else [r])]:
        raise ValueError("the networks do not fit the controller and its Casimirs")
    for network in (form.hc, form.k, *form.betas):
        if network.activation not in ACTIVATIONS or min(network.hidden, default=1) < 1:
            raise ValueError(f"no such network: {network}")


_VERDICT_PLAIN = ("assignable", "reason", "explanation", "a_max", "stability", "witness")
_VERDICT_TEXT = ("lam", "xi_star", "invisible", "curvature")


def _from_dict(data: Mapping[str, Any]) -> Design:
    model = data["model"]
    names = [*model["states"], *model["controller_states"]]
    symbols = {
        identifier: sp.Symbol(name, real=True)
        for identifier, name in zip(model["symbols"], names, strict=True)
    }

    @cache  # large matrices hold few different entries
    def entry(text: str) -> sp.Expr:
        return parse(text, symbols)

    def read(value: Any) -> Any:
        if value is None:
            return None
        return tuple(read(v) for v in value) if isinstance(value, list) else entry(value)

    def matrix(value: Any, columns: int = 0) -> sp.ImmutableMatrix:
        rows = [list(read(row)) for row in value]
        entries = [entry for row in rows for entry in row]
        return sp.ImmutableMatrix(len(rows), len(rows[0]) if rows else columns, entries)

    z = tuple(symbols.values())
    n = len(model["states"])
    properties = tuple(Property(**p) for p in model["properties"])
    split = model["plant_properties"]
    plant = Plant(
        name=model["name"],
        x=z[:n],
        J=matrix(model["J"]),
        R=matrix(model["R"]),
        G=matrix(model["G"]),
        H=read(model["H"]),
        units=model["units"],
        domain={name: read(bounds) for name, bounds in model["domain"].items()},
        u_limits=None
        if model["u_limits"] is None
        else tuple((float(lo), float(hi)) for lo, hi in model["u_limits"]),
        properties=properties[:split],
    )
    controller = Controller(
        xi=z[n:],
        Jc=matrix(model["Jc"]),
        Rc=matrix(model["Rc"]),
        Gc=matrix(model["Gc"]),
        properties=properties[split:],
    )
    verdict = data["verdict"]
    return Design(
        loop=ClosedLoop(plant, controller),
        casimirs=Casimirs(
            functions=read(data["casimirs"]["functions"]),
            kernel_rank=data["casimirs"]["kernel_rank"],
            generic_count=data["casimirs"]["generic_count"],
            origins=tuple(data["casimirs"]["origins"]),
            count_proved=data["casimirs"]["count_proved"],
        ),
        x_star=read(data["target"]),
        verdict=Verdict(
            **{k: verdict[k] for k in _VERDICT_PLAIN},
            lam=read(verdict["lam"]),
            xi_star=read(verdict["xi_star"]),
            invisible=matrix(verdict["invisible"]),
            curvature=None if verdict["curvature"] is None else matrix(verdict["curvature"]),
        ),
        form=_form(data["form"]),
        weights=_unhex(data["weights"]),
        xi_star=_unhex(data["xi_star"]),
        D=_unhex(data["D"]),
        Dc=_unhex(data["Dc"]),
        a=float.fromhex(data["a"]),
        a_requested=float.fromhex(data["a_requested"]),
        seed=data["seed"],
        starts=tuple(Start(**start) for start in data["starts"]),
        learned=None if data["learned"] is None else Residual(**data["learned"]),
        versions=data["versions"],
    )


def _form(data: Mapping[str, Any]) -> Form:
    def network(d: Mapping[str, Any]) -> Network:
        return Network(**{**d, "hidden": tuple(d["hidden"])})

    phi = data["phi"]
    return Form(
        hc=network(data["hc"]),
        k=network(data["k"]),
        betas=tuple(network(d) for d in data["betas"]),
        phi=None if phi is None else MonotonePhi(hidden=phi["hidden"], delta=phi["delta"]),
    )
