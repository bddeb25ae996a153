"""A user's model file to Plant and Controller; every number in it is taken as exact.

A model file is Python and runs as the user's own code. Only ``x, J, R, G, H`` are required; a
mechanical plant may give ``q, M, V, B`` in their place, a plant without such a form gives
``x, f, G``, one with inputs in J or R names them in ``u``.
"""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.cases import Measured
from necc_casadi.errors import InputError, ModelError
from necc_casadi.model import file_entries as entries
from necc_casadi.model.closed_loop import ClosedLoop, interconnect
from necc_casadi.model.control_affine import ControlAffine
from necc_casadi.model.controller import Controller, default_controller, make_controller
from necc_casadi.model.measurement import canonical_inertia
from necc_casadi.model.mechanical_file import MECHANICAL, Mechanical, is_mechanical, phase_space
from necc_casadi.model.modulated import (
    Modulated,
    System,
    make_control_affine,
    make_modulated,
)
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant, make_plant
from necc_casadi.model.ranges import Range, Ranges
from necc_casadi.model.reader import Reader, inputs_inside, printable, real, source, stands_inside
from necc_casadi.model.urdf import read_urdf
from necc_casadi.texts import escaped

__all__ = ["Model", "load_model", "make_model"]


_REQUIRED = ("x", "J", "R", "G", "H")


#: A plant without an energy.
_AFFINE = ("x", "f", "G")


_OPTIONAL = (
    "params", "xi", "Jc", "Rc", "Gc", "casimirs", "target", "domain", "sizes", "D", "Dc",
    "u_limits", "units", "name", "state_cost", "input_cost", "u", "E", "f", "measured",
    "uncertain", "setpoints", "disturbance", "runtime", "inputs",
)  # fmt: skip


_CONTROLLER = ("Jc", "Rc", "Gc")


#: Names at least this long are compared with what the file defines; alike from this ratio on.
_LONG, _ALIKE = 4, 0.8


@dataclass(frozen=True, eq=False)
class Model:
    """What a model file says (docs/contract.md#model-file).

    Examples
    --------
    >>> from necc_casadi import load_model
    >>> model = load_model("pendulum.py")
    >>> model.loop.plant.H
    p**2/2 - cos(q) + 1
    >>> model.target is None, model.D is None
    (True, True)
    """

    system: System
    controller: Controller | None = None  # None: one integrator per input
    casimirs: tuple[sp.Expr, ...] = ()  # supplied by the user, not yet proved
    target: Mapping[str, sp.Expr] | None = None  # state -> value
    D: Vector | None = None  # m × m
    Dc: Vector | None = None  # m × m
    state_cost: Vector | None = None  # n × n, ⪰ 0
    input_cost: Vector | None = None  # m × m, ≻ 0
    params: Mapping[str, sp.Expr] = field(default_factory=dict)  # values, exact
    notes: tuple[str, ...] = ()  # names in the file that look mistyped
    ranges: Ranges = field(default_factory=Ranges)  # of set-points and uncertain parameters
    told: Mapping[str, Range] = field(default_factory=dict)  # of parameters told at run time
    parametric: Parametric | None = None  # the plant before values were put in; None: no parameter

    @cached_property
    def loop(self) -> ClosedLoop:
        """The published loop of plant and controller.

        Raises
        ------
        ModelError
            ``model_file`` where the file gives no J(x), R(x), G and H.
        """
        if not isinstance(self.system, Plant):
            raise ModelError(
                "model_file",
                f"{self.system.name} has no J, R and H of the states alone",
                "Call find_method for the loop that holds its target.",
            )
        controller = self.controller or default_controller(self.system)
        return interconnect(self.system, controller)


def load_model(path: str | Path, overrides: Mapping[str, str] | None = None) -> Model:
    """Run a model file and check everything in it.

    Parameters
    ----------
    path
        The model file; or an arm in URDF, ``arm.urdf``, as :func:`read_urdf` reads it.
    overrides
        Values of parameters by name, as texts (``--param``).

    Returns
    -------
    Model
        Exact and checked; the target, supplied Casimirs and damping as the file gives them.

    Raises
    ------
    ModelError
        With the code of the first fault; docs/contract.md#errors lists them.

    Examples
    --------
    >>> from necc_casadi import load_model
    >>> load_model("pendulum.py").loop.plant.states
    ('q', 'p')
    >>> load_model("pendulum.py", {"k": "4"})
    Traceback (most recent call last):
    necc_casadi.errors.ModelError: --param k: the model has no parameter k
    Its parameters: none.
    """
    path = Path(path)
    if path.suffix == ".urdf":
        return _checked(path.name, escaped(path.stem), read_urdf(path), overrides or {})
    space = _execute(path)
    model = _checked(path.name, escaped(path.stem), space, overrides or {})
    return replace(model, notes=_mistyped(space))


def make_model(**names: Any) -> Model:
    """Check what a model file would say, given as arguments, as in a notebook.

    Parameters
    ----------
    names
        As in a model file (docs/contract.md#model-file): ``x, J, R, G, H``, or ``q, M, V, B`` and
        ``friction``, or ``x, f, G``; with ``params``, ``sizes``, ``u_limits``, ``domain``, ….

    Returns
    -------
    Model
        Exact and checked; :func:`necc_casadi.run` takes it.

    Raises
    ------
    ModelError
        As :func:`load_model`, and ``model_file`` for a name that no model has.

    Examples
    --------
    >>> import sympy as sp
    >>> from necc_casadi import make_model
    >>> q, g = sp.symbols("q g")
    >>> model = make_model(q=q, M=1, V=g * (1 - sp.cos(q)), B=1, params={g: 9.81}, name="arm")
    >>> model.loop.plant.states, model.loop.plant.H
    (('q', 'p_q'), p_q**2/2 - 981*cos(q)/100 + 981/100)
    >>> make_model(q=q, M=1, V=0, B=1, frction=1)
    Traceback (most recent call last):
    necc_casadi.errors.ModelError: no model has a name frction
    Did you mean friction?
    """
    known = dict.fromkeys((*_REQUIRED, *MECHANICAL, "friction", *_OPTIONAL))
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            remedy = f"Did you mean {near[0]}?" if near else f"Names: {', '.join(known)}."
            raise ModelError("model_file", f"no model has a name {escaped(name)}", remedy)
    return _checked("make_model", "plant", names, {})


def _checked(source: str, title: str, space: dict[str, Any], overrides: Mapping[str, str]) -> Model:
    """The model that names and values make; `source` is what gave them."""
    missing = _missing(space)
    if missing:
        raise ModelError(
            "model_file",
            f"{source} does not define {', '.join(missing)}",
            "A model file defines x, J, R, G and H with sympy (or x, f, G; or q, M, V, B).",
        )
    try:
        return _build(title, space, overrides)
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, KeyError, IndexError) as problem:
        raise ModelError(
            "model_file",
            f"{source}: a name has a value of the wrong kind ({' '.join(str(problem).split())})",
            "Compare it with examples/pendulum.py.",
        ) from None


def _missing(space: Mapping[str, Any]) -> list[str]:
    """The names that a model needs and this one lacks."""
    if is_mechanical(space):
        return []
    if "f" in space and not {"J", "R", "H"} & set(space):
        return [name for name in _AFFINE if name not in space]
    inside = any(stands_inside(space, symbol) for symbol in inputs_inside(space))
    without = {"G"} if inside else set()
    return [name for name in _REQUIRED if name not in {*space, *without}]


def _execute(path: Path) -> dict[str, Any]:
    """Run the file; what it prints goes to stderr, so that stdout stays ours."""
    try:
        source = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
        raise ModelError(
            "model_file", f"{path} cannot be read: {reason}", "Name a model file in Python."
        ) from None
    space: dict[str, Any] = {"__name__": "necc_model", "__file__": str(path)}
    sys.path.insert(0, str(path.resolve().parent))
    try:
        with contextlib.redirect_stdout(sys.stderr):
            exec(compile(source, str(path), "exec"), space)
    except SyntaxError as problem:
        raise ModelError(
            "model_file",
            f"{path.name}, line {problem.lineno}: {problem.msg}",
            "Correct the Python syntax there.",
        ) from None
    except InputError:
        raise
    except (Exception, SystemExit) as problem:
        frames = traceback.extract_tb(problem.__traceback__)
        line = next((f.lineno for f in reversed(frames) if f.filename == str(path)), "?")
        text = " ".join(str(problem).split()) or type(problem).__name__
        raise ModelError(
            "model_file",
            f"{path.name}, line {line}: {type(problem).__name__}: {text}",
            "Run the file with python to see the whole error.",
        ) from None
    finally:
        sys.path.remove(str(path.resolve().parent))
    return space


def _mistyped(space: Mapping[str, Any]) -> tuple[str, ...]:
    """Names that nothing reads, though they look like an optional name that the file lacks."""
    optional = (*_OPTIONAL, "friction") if is_mechanical(space) else _OPTIONAL
    absent = [name for name in optional if name not in space and len(name) >= _LONG]
    near = {
        name: get_close_matches(name, absent, n=1, cutoff=_ALIKE)
        for name in space
        if name not in (*_REQUIRED, *optional) and not name.startswith("_")
    }
    return tuple(
        f"the model file's {name} is not read: did you mean {meant[0]}?"
        for name, meant in near.items()
        if meant
    )


def _build(title: str, space: dict[str, Any], overrides: Mapping[str, str]) -> Model:
    if is_mechanical(space):
        space = {**space, "x": phase_space(space["q"])}
    file = Reader(space, overrides)
    plant = _plant(title, file)
    controller = _controller(plant, file) if isinstance(plant, Plant) else None
    inner = () if controller is None else controller.states
    states = (*plant.states, *inner)
    plant = replace(plant, inputs=entries.inputs(file, plant.m, states))
    plant = replace(
        plant,
        domain=entries.sides_of_states(file, "domain", states),
        sizes=entries.sizes(file, (*states, *plant.input_names)),
    )
    named = "target" in space and space["target"] is not None
    return Model(
        system=plant,
        controller=controller,
        casimirs=tuple(file.read(c) for c in space.get("casimirs", ())),
        target={k: file.read(v) for k, v in file.table("target").items()} if named else None,
        D=entries.damping(file, "D", plant.m),
        Dc=entries.damping(file, "Dc", plant.m),
        state_cost=entries.weight(file, "state_cost", plant.n, strict=False),
        input_cost=entries.weight(file, "input_cost", plant.m, strict=True),
        params=file.parameters,
        ranges=Ranges(
            entries.sides_of_states(file, "setpoints", plant.states),
            entries.parameters(file, "uncertain"),
            entries.disturbance(file, plant.m),
        ),
        told=entries.told(file),
        parametric=_parametric(file),
    )


def _plant(title: str, file: Reader) -> System:
    """The plant, in the form that the file gives it."""
    space, x, limits = file.space, [real(s) for s in file.states], entries.limits(file)
    about: dict[str, Any] = {
        "name": printable(str(space.get("name", title)), "name"),
        "units": {
            name: printable(str(unit), f"units[{escaped(name)}]")
            for name, unit in file.table("units").items()
        },
        "u_limits": limits,
    }
    if "J" not in space and not is_mechanical(space):
        plant: Modulated | ControlAffine = make_control_affine(
            x, file.attempt("f"), file.attempt("G"), **about
        )
    else:
        J, R, G, H = _structure(file, x)
        if not file.inputs and source(space) is None:
            return _measured(make_plant(x, J, R, G, H, **about), file)
        E = None if source(space) is None else file.read(source(space))
        plant = make_modulated(x, [real(s) for s in file.inputs], J, R, G, E, H, **about)
    if _wants_velocity(file):
        raise ModelError(
            "model_file",
            f"measured = 'velocity', but {title} gives no momenta",
            _NO_VELOCITY,
        )
    if limits is not None and len(limits) != plant.m:
        raise ModelError(
            "limits",
            f"u_limits has {len(limits)} entries, but there are {plant.m} inputs",
            "Give one (lo, hi) pair per input.",
        )
    return plant


_NO_VELOCITY = "Leave `measured` out: the controller takes the states."


def _wants_velocity(file: Reader) -> bool:
    """Whether the controller takes q̇; by default it does where M, V and B are the whole plant."""
    alone = is_mechanical(file.space) and not file.inputs and source(file.space) is None
    value = file.space.get("measured", "velocity" if alone else "state")
    if value not in get_args(Measured):
        raise ModelError(
            "model_file",
            f"measured = {value!r}",
            f"Use {' or '.join(map(repr, get_args(Measured)))}.",
        )
    return bool(value == "velocity")


def _measured(plant: Plant, file: Reader) -> Plant:
    """The plant with its inertia where q̇ is measured in place of p."""
    if not _wants_velocity(file):
        return plant
    if not is_mechanical(file.space):
        return replace(plant, inertia=canonical_inertia(plant))
    parts = (file.attempt(name) for name in ("M", "V", "B", "friction"))
    return replace(plant, inertia=sp.ImmutableMatrix(Mechanical.of(plant.x, *parts).M))


def _structure(file: Reader, x: Sequence[sp.Symbol]) -> tuple[Any, Any, Any, Any]:
    """J, R, G (None where there is none) and H, with the parameters' values in them."""
    if is_mechanical(file.space):
        mechanical = Mechanical.of(x, *(file.attempt(name) for name in ("M", "V", "B", "friction")))
        mechanical.check()
        return mechanical.structure
    J, R, G, H = (file.attempt(name) for name in ("J", "R", "G", "H"))
    return J, R, G, H


def _parametric(file: Reader) -> Parametric | None:
    """The plant with its parameters as symbols; it was checked with their values."""
    if not file.parameters or file.inputs or source(file.space) is not None:
        return None
    if is_mechanical(file.space):
        x = [real(s) for s in file.states]
        parts = (file.unvalued(name) for name in ("M", "V", "B", "friction"))
        J, R, G, H = Mechanical.formal(x, *parts).structure
    elif {"J", "R", "G", "H"} <= set(file.space):
        J, R, G, H = (file.unvalued(name) for name in ("J", "R", "G", "H"))
    else:
        return None
    energy = H[0, 0] if isinstance(H, sp.MatrixBase) else H
    matrix = sp.ImmutableMatrix
    return Parametric(matrix(J), matrix(R), matrix(G), energy, file.parameters)


def _controller(plant: Plant, file: Reader) -> Controller:
    given = {name: file.read(file.space[name]) for name in _CONTROLLER if name in file.space}
    if not given and "xi" not in file.space:
        return default_controller(plant)
    xi = [real(s) for s in file.xi]
    if "xi" not in file.space:
        nc = max(sp.Matrix(matrix).rows for matrix in given.values())
        xi = list(sp.symbols([f"xi{i + 1}" for i in range(nc)], real=True))
    nc = len(xi)
    matrices = {"Jc": sp.zeros(nc, nc), "Rc": sp.zeros(nc, nc), "Gc": sp.eye(nc)} | given
    return make_controller(plant, xi, **matrices)
