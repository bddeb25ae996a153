"""The layout of design.json."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import cache
from typing import Any, get_args

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.cases import InitialXi
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.integral import integral_of, integral_text
from necc_casadi.designs.outcome import Residual, Start
from necc_casadi.designs.parametric_text import check_plants, plants_of, plants_text
from necc_casadi.designs.parts import Parts
from necc_casadi.lyapunov.damping import dissipates
from necc_casadi.lyapunov.networks import ACTIVATIONS, MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.controller import Controller
from necc_casadi.model.entries import Property
from necc_casadi.model.plant import Plant
from necc_casadi.model.shaped_loop import ShapedLoop, shaped_loop
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.expressions import parse, to_text
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.symbolic.identifiers import identifiers
from necc_casadi.texts import escaped
from necc_casadi.verdict.verdict import Verdict

__all__ = ["BROKEN", "DESIGN_FORMAT", "check_whole", "from_dict", "to_dict"]


#: Version of the layout of design.json.
DESIGN_FORMAT = 1


#: What reading a file that is no design can raise.
BROKEN = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)


def _hex(values: Vector) -> Any:
    return [_hex(v) for v in values] if np.ndim(values) else float(values).hex()


def _unhex(values: Any) -> Vector:
    if isinstance(values, list):
        return np.array([_unhex(v) for v in values], dtype=float)
    return np.float64(float.fromhex(values))  # type: ignore[return-value]


def to_dict(design: Parts) -> dict[str, Any]:
    """The content of design.json."""
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
        **_controller_text(design.loop, text),
        **_preliminary_text(plant, text),
        **({} if plant.inertia is None else {"inertia": text(plant.inertia)}),
        **({"inputs": list(plant.inputs)} if plant.inputs else {}),
        "units": dict(plant.units),
        "domain": {name: text(bounds) for name, bounds in plant.domain.items()},
        "u_limits": plant.u_limits,
        "sizes": {name: text(size) for name, size in plant.sizes.items()},
        "properties": [{"name": p.name, "proved": p.proved} for p in design.loop.properties],
        "plant_properties": len(plant.properties),
    }
    verdict = design.verdict
    return {
        "format": DESIGN_FORMAT,
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
        **_start_text(design),
        "D": _hex(design.D),
        "Dc": _hex(design.Dc),
        **_coupling_text(design.damping, design.loop.plant.m),
        **(
            {"setpoints": {k: text(v) for k, v in design.setpoints.items()}}
            if design.setpoints
            else {}
        ),
        **({} if design.told is None else {"told": plants_text(plant.states, design.told)}),
        **({} if design.integral is None else {"integral": integral_text(design.integral)}),
        "sizes": {**_sizes_text(design.sizes), "guessed": list(design.sizes.guessed)},
        "units": _sizes_text(design.units),
        "curvature": _hex(design.curvature),
        "seed": design.seed,
        "starts": [_of_input_alone(start) for start in design.starts],
        "learned": None if design.learned is None else asdict(design.learned),
        "weights": _hex(design.weights),
    }


_PRELIMINARY = ("f", "g", "u0", "gain")


def _preliminary_text(plant: Plant, text: Callable[[Any], Any]) -> dict[str, Any]:
    """Feedback ahead of the loop, where there is any."""
    if plant.preliminary is None:
        return {}
    return {"preliminary": {key: text(getattr(plant.preliminary, key)) for key in _PRELIMINARY}}


def _ahead_of(matrices: Mapping[str, sp.ImmutableMatrix]) -> Preliminary:
    return Preliminary(matrices["f"], matrices["g"], matrices["u0"], matrices["gain"])


def _controller_text(loop: ClosedLoop, text: Callable[[Any], Any]) -> dict[str, Any]:
    """Jc, Rc and Gc of the published loop, or γ and α of power shaping."""
    if isinstance(loop, ShapedLoop):
        return {"gamma": text(loop.shaping), "alpha": text(loop.alpha)}
    return {key: text(getattr(loop.controller, key)) for key in ("Jc", "Rc", "Gc")}


def _start_text(design: Parts) -> dict[str, Any]:
    """Where ξ starts, unless it is at ξ*."""
    gain = design.initial_gain
    return {
        **({} if design.initial_xi == "target" else {"initial_xi": design.initial_xi}),
        **({} if gain is None else {"initial_gain": _hex(gain)}),
    }


def _coupling_text(damping: Vector, m: int) -> dict[str, Any]:
    """The off-diagonal blocks of 𝒟, upper right and lower left, where they are not zero."""
    blocks = (damping[:m, m:], damping[m:, :m])
    return {"coupling": [_hex(block) for block in blocks]} if np.any(blocks) else {}


def _damping(data: Mapping[str, Any]) -> Vector:
    """𝒟, (m + channels)²; a file without a coupling holds diag(D, Dc)."""
    D, Dc = _unhex(data["D"]), _unhex(data["Dc"])
    m, k = len(D), len(Dc)
    rest = [np.zeros((m, k)), np.zeros((k, m))]
    upper, lower = map(_unhex, data["coupling"]) if "coupling" in data else rest
    shapes = [block.shape for block in (D, upper, lower, Dc)]
    if shapes != [(m, m), (m, k), (k, m), (k, k)]:
        raise ValueError("the blocks of the damping do not fit each other")
    return np.block([[D, upper], [lower, Dc]])


def _sizes_text(sizes: Sizes) -> dict[str, Any]:
    return {name: _hex(np.asarray(getattr(sizes, name))) for name in _SIZES}


def _of_input_alone(start: Start) -> dict[str, Any]:
    """A start without its seconds: a design is a function of its input."""
    return {key: value for key, value in asdict(start).items() if key != "seconds"}


def _model_hash(model: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(model, sort_keys=True).encode()).hexdigest()


def check_whole(design: Parts, data: Mapping[str, Any]) -> None:
    """Raise ValueError where the parts of a file do not belong together."""
    plant, controller, form = design.loop.plant, design.loop.controller, design.form
    n, nc, m = plant.n, controller.nc, plant.m
    r = len(design.casimirs.functions)
    if data["model_hash"] != _model_hash(data["model"]):
        raise ValueError("the model was edited: its hash differs")
    if len(plant.input_names) != m:
        raise ValueError("each input needs a name")
    shown = [plant.name, *design.loop.states, *plant.inputs, *plant.units.values()]
    if any(escaped(text) != text for text in shown):
        raise ValueError("a name or a unit holds characters that cannot be shown")
    shapes = {
        "weights": (design.weights, (form.size,)),
        "xi_star": (design.xi_star, (nc,)),
        "damping": (design.damping, (m + design.loop.channels,) * 2),
        "target": (to_floats(design.x_star), (n,)),
        "curvature": (design.curvature, (n + nc,)),
    }
    for label, group in (("sizes", design.sizes), ("units", design.units)):
        wanted = ((n + nc,), (m,), (), (), (r,))
        for name, shape in zip(_SIZES, wanted, strict=True):
            shapes[f"{label}: {name}"] = (np.asarray(getattr(group, name)), shape)
    if plant.inertia is not None and plant.inertia.shape != (n // 2, n - n // 2):
        raise ValueError("the inertia does not fit the momenta")
    if design.initial_gain is not None:
        shapes["initial_gain"] = (design.initial_gain, (nc, n))
    for name, (values, shape) in shapes.items():
        if np.shape(values) != shape or not np.all(np.isfinite(values)):
            raise ValueError(f"{name} must hold finite numbers of shape {shape}")
    for name in _SIZES:
        unit = np.asarray(getattr(design.units, name))
        if np.any(np.asarray(getattr(design.sizes, name)) <= 0) or np.any(unit <= 0):
            raise ValueError(f"sizes and units must be positive: {name}")
        if np.any(np.frexp(unit)[0] != 0.5):
            raise ValueError(f"units must be powers of two: {name}")
    for name, (lo, hi) in design.setpoints.items():
        if name not in plant.states or not bool(lo < hi) or lo.free_symbols | hi.free_symbols:
            raise ValueError("a set-point moves between two numbers, for a state")
    if design.told is not None:
        check_plants(design.told, plant)
    if design.integral is not None and len(design.integral.gain) != m:
        raise ValueError("an integral action needs one number for each input")
    if design.initial_xi not in get_args(InitialXi):
        raise ValueError(f"no such ξ(0): {design.initial_xi!r}")
    if (design.initial_gain is not None) != (design.initial_xi == "linear"):
        raise ValueError("a gain of ξ(0) belongs to a linear one, and to no other")
    if not dissipates(design.damping):
        raise ValueError("the symmetric part of the damping must be positive definite")
    inputs = [form.hc.inputs, form.k.inputs, *[beta.inputs for beta in form.betas]]
    if inputs != [nc, *([1] * (1 + r) if form.betas else [r])]:
        raise ValueError("the networks do not fit the controller and its Casimirs")
    for network in (form.hc, form.k, *form.betas):
        if network.activation not in ACTIVATIONS or min(network.hidden, default=1) < 1:
            raise ValueError(f"no such network: {network}")


_VERDICT_PLAIN = ("assignable", "reason", "explanation", "a_max", "stability", "witness")


_SIZES = ("state", "input", "energy", "time", "casimir")


_VERDICT_TEXT = ("lam", "xi_star", "invisible", "curvature")


def from_dict(data: Mapping[str, Any]) -> Parts:
    """The parts of the design in design.json; raises one of BROKEN where it holds none."""
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
    properties = tuple(Property.named(**p) for p in model["properties"])
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
        sizes={name: read(size) for name, size in model.get("sizes", {}).items()},
        inputs=tuple(model.get("inputs", ())),
        properties=properties[:split],
        preliminary=None
        if "preliminary" not in model
        else _ahead_of({k: matrix(model["preliminary"][k]) for k in _PRELIMINARY}),
        inertia=matrix(model["inertia"]) if "inertia" in model else None,
    )
    if "gamma" in model:
        gamma = read(model["gamma"])
        loop: ClosedLoop = shaped_loop(plant, gamma, matrix(model["alpha"]), z[n:])
    else:
        controller = Controller(
            xi=z[n:],
            Jc=matrix(model["Jc"]),
            Rc=matrix(model["Rc"]),
            Gc=matrix(model["Gc"]),
            properties=properties[split:],
        )
        loop = ClosedLoop(plant, controller)
    verdict = data["verdict"]
    return Parts(
        loop=loop,
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
        initial_xi=data.get("initial_xi", "target"),
        initial_gain=_unhex(data["initial_gain"]) if "initial_gain" in data else None,
        damping=_damping(data),
        a=float.fromhex(data["a"]),
        a_requested=float.fromhex(data["a_requested"]),
        **_scaling(data),
        seed=data["seed"],
        starts=tuple(Start(**start) for start in data["starts"]),
        setpoints={k: read(v) for k, v in data.get("setpoints", {}).items()},
        told=plants_of(data["told"]) if "told" in data else None,
        integral=integral_of(data["integral"]) if "integral" in data else None,
        learned=None if data["learned"] is None else Residual(**data["learned"]),
        versions=data["versions"],
    )


def _scaling(data: Mapping[str, Any]) -> dict[str, Any]:
    """Sizes, units and curvature; a file without them was designed in the units of its model."""
    if "sizes" not in data:
        return {}

    def read(values: Mapping[str, Any]) -> Sizes:
        return Sizes(
            state=_unhex(values["state"]),
            input=_unhex(values["input"]),
            energy=float(_unhex(values["energy"])),
            time=float(_unhex(values["time"])),
            casimir=_unhex(values["casimir"]),
            guessed=tuple(map(str, values.get("guessed", ()))),
        )

    return {
        "sizes": read(data["sizes"]),
        "units": read(data["units"]),
        "curvature": _unhex(data["curvature"]),
    }


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
