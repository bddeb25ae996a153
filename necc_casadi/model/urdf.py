"""Robot arms in URDF, as the names of a model file.

Every number is the rational that its text displays. Rotations are exactly orthogonal: a quarter
turn may be rounded or cut off (``1.57``), any other angle or axis is met within 1e-15.

References
----------
https://wiki.ros.org/urdf/XML
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.entries import not_psd
from necc_casadi.model.rigid_tree import Body, Motion, inertia_and_potential
from necc_casadi.symbolic.identifiers import identifiers
from necc_casadi.symbolic.rotations import rational_rotation, rational_unit
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.texts import escaped

__all__ = ["read_urdf"]


#: Kinds of joints that are covered, and what they do.
_MOTION: dict[str, Motion | None] = {
    "revolute": "turns", "continuous": "turns", "prismatic": "slides", "fixed": None,
}  # fmt: skip


#: The largest power of ten that a number may have.
_LARGEST = 100


def read_urdf(path: str | Path) -> dict[str, Any]:
    """An arm in URDF, as the names of a model file.

    Parameters
    ----------
    path
        A tree of links on revolute, continuous, prismatic and fixed joints. The root stands
        still; gravity points along its −z.

    Returns
    -------
    dict
        ``q, M, V, B, friction``, ``params`` (g and the masses), ``inputs``, ``units`` and, where
        the file has limits, ``domain`` and ``u_limits``: for :func:`make_model`, or for
        ``globals().update(…)`` in a model file. Joints are driven that the file's transmissions
        or command interfaces name; without any, all but those of effort 0.

    Raises
    ------
    ModelError
        ``model_file``, for what cannot be read or is no such arm.

    Examples
    --------
    >>> from necc_casadi import make_model, read_urdf
    >>> arm = read_urdf("arm.urdf")
    >>> arm["q"], arm["params"]
    ((shoulder, elbow), {g: 981/100, m_upper: 2, m_lower: 1})
    >>> make_model(**arm, target={"shoulder": 0.5, "elbow": 1}).loop.plant.m
    2
    """
    path = Path(path)
    root = _parsed(path)
    joints = _joints(root)
    moving = [joint for joint in joints if joint.motion]
    if not moving:
        raise _fault(f"{path.name} has no joint that moves", f"Kinds: {', '.join(_MOTION)}.")
    q = [sp.Symbol(word, real=True) for word in identifiers(joint.name for joint in moving)]
    g, masses = sp.Symbol("g", real=True), _masses(joints)
    place = {joint.child: i for i, joint in enumerate(joints)}
    bodies = [
        _body(joint, place.get(joint.parent), mass)
        for joint, (mass, _) in zip(joints, masses, strict=True)
    ]
    M, V = inertia_and_potential(bodies, q, g)
    for j, joint in enumerate(moving):
        if M[j, j] == 0:
            fault = f"joint {joint.name} moves no mass"
            raise _fault(fault, f"Give link {joint.child} an <inertial>.")
    values = {g: sp.Rational(981, 100), **dict(masses)}
    drives = _drives(root, moving)
    turns = [joint.motion == "turns" for joint in moving]
    inputs = {
        f"{'tau' if turns[j] else 'force'}_{q[j]}": "N m" if turns[j] else "N" for j in drives
    }
    return {
        "q": tuple(q),
        "M": M,
        "V": V,
        "B": sp.Matrix(len(q), len(drives), lambda i, k: int(i == drives[k])),
        "friction": sp.diag(*map(_damping, moving)),
        "params": {s: values[s] for s in values if s in M.free_symbols | V.free_symbols},
        "inputs": tuple(inputs),
        "units": {x: "rad" if turn else "m" for x, turn in zip(q, turns, strict=True)} | inputs,
        "name": root.get("name") or path.stem,
        **_domain(q, moving),
        **_efforts([moving[j] for j in drives]),
    }


def _parsed(path: Path) -> Element:
    """The root element; no entity is expanded, since no document type is let in."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
        raise _fault(f"{path} cannot be read: {reason}", "Name a URDF file.") from None
    if "<!DOCTYPE" in text:
        raise _fault(f"{path.name} declares a document type", "A URDF has none: take it out.")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as problem:
        raise _fault(f"{path.name} is no XML: {problem}", "Correct it there.") from None
    if any("xacro" in element.tag for element in root.iter()):
        remedy = f"Expand them first: xacro {path.name} > arm.urdf"
        raise _fault(f"{path.name} holds xacro macros", remedy)
    if root.tag != "robot":
        raise _fault(f"{path.name} holds <{root.tag}>, not <robot>", "Name a URDF file.")
    return root


def _fault(message: str, remedy: str) -> ModelError:
    return ModelError("model_file", escaped(message), escaped(remedy))


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint and the link that it carries."""

    name: str
    motion: Motion | None
    parent: str
    child: str
    entry: Element
    link: Element

    def number(self, part: str, label: str) -> sp.Rational | None:
        """An attribute of a part of the joint; None where it is not given."""
        entry = self.entry.find(part)
        if entry is None or label not in entry.attrib:
            return None
        return _rationals(f"joint {self.name}", entry, label, "0")[0]


def _joints(root: Element) -> list[_Joint]:
    """The joints of a tree, each after the one that it hangs on."""
    links = _by_name(root, "link")
    waiting: dict[str, _Joint] = {}
    for name, entry in _by_name(root, "joint").items():
        parent, child = (_link(name, entry, end, links) for end in ("parent", "child"))
        if child in waiting:
            fault = f"link {child} hangs on two joints, {waiting[child].name} and {name}"
            raise _fault(fault, "Only trees are covered: write a closed loop by q, M, V and B.")
        waiting[child] = _Joint(name, _motion(name, entry), parent, child, entry, links[child])
    roots = [link for link in links if link not in waiting]
    if len(roots) > 1:
        fault = f"links {roots[0]} and {roots[1]} hang on no joint"
        raise _fault(fault, "One link is the ground; each other one hangs on a joint.")
    order: list[_Joint] = []
    while ready := next((j for j in waiting.values() if j.parent in roots), None):
        order.append(waiting.pop(ready.child))
        roots.append(ready.child)
    lost = [joint.name for joint in waiting.values()]
    if lost or not links:
        fault = f"joints {', '.join(lost[:4])} close a loop" if lost else "there is no <link>"
        raise _fault(fault, "A tree of links that hang on the ground is covered.")
    return order


def _by_name(root: Element, tag: str) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for entry in root.findall(tag):
        name = entry.get("name", "")
        if not name or name in found:
            fault = f"two of <{tag}> have the name {name}" if name else f"a <{tag}> has no name"
            raise _fault(fault, "Give each a name of its own.")
        found[name] = entry
    return found


def _link(name: str, entry: Element, end: str, links: Mapping[str, Element]) -> str:
    """The link that is the parent or the child of a joint."""
    part = entry.find(end)
    link = "" if part is None else part.get("link", "")
    if link not in links:
        fault = f"joint {name}: its {end} {link!r} is no link"
        raise _fault(fault, f"Links: {', '.join(list(links)[:8]) or 'none'}.")
    return link


def _motion(name: str, entry: Element) -> Motion | None:
    kind = "mimic" if entry.find("mimic") is not None else entry.get("type", "")
    if kind not in _MOTION:
        remedy = f"Kinds: {', '.join(_MOTION)}; write a plant of others by q, M, V and B."
        raise _fault(f"joint {name} is of the kind {kind!r}", remedy)
    return _MOTION[kind]


def _damping(joint: _Joint) -> sp.Rational | int:
    dry = joint.number("dynamics", "friction")
    if dry:
        fault = f"joint {joint.name} has dry friction {dry}, and only damping is covered"
        raise _fault(fault, 'Set friction="0", and measure the offset that it leaves.')
    return joint.number("dynamics", "damping") or 0


def _drives(root: Element, moving: Sequence[_Joint]) -> list[int]:
    """The joints that are driven, by their number."""
    parts = ("transmission/joint", "ros2_control/joint[command_interface]")
    named = {joint.get("name") for part in parts for joint in root.iterfind(part)}
    driven = [
        joint.name in named if named else joint.number("limit", "effort") != 0 for joint in moving
    ]
    if not any(driven):
        raise _fault("no joint is driven", "Give one an effort that is not 0 in its <limit>.")
    return [j for j, drive in enumerate(driven) if drive]


def _domain(q: Sequence[sp.Symbol], moving: Sequence[_Joint]) -> dict[str, Any]:
    """The `domain`, where joints have stops; a stop that is not given is at 0."""
    stops = [(joint.number("limit", "lower"), joint.number("limit", "upper")) for joint in moving]
    sides = {
        x: (lo or 0, hi or 0)
        for x, (lo, hi) in zip(q, stops, strict=True)
        if (lo, hi) != (None, None)
    }
    return {"domain": sides} if sides else {}


def _efforts(driven: Sequence[_Joint]) -> dict[str, Any]:
    """`u_limits`, where joints have limits of their efforts."""
    efforts = {joint.name: joint.number("limit", "effort") for joint in driven}
    known = [(-effort, effort) for effort in efforts.values() if effort is not None]
    if known and len(known) < len(efforts):
        without = next(name for name, effort in efforts.items() if effort is None)
        fault = f"joint {without} has no effort in its <limit>, but others have"
        raise _fault(fault, "Give every joint that is driven a limit, or none.")
    return {"u_limits": known} if known else {}


def _masses(joints: Sequence[_Joint]) -> list[tuple[sp.Expr, sp.Expr]]:
    """Symbol and value of each link's mass; 0 and 0 where it has none."""
    result: list[tuple[sp.Expr, sp.Expr]] = []
    for joint, word in zip(
        joints, identifiers(f"m_{joint.child}" for joint in joints), strict=True
    ):
        entry = joint.link.find("inertial/mass")
        where = f"link {joint.child}"
        value = sp.Integer(0) if entry is None else _rationals(where, entry, "value", "0")[0]
        if value < 0:
            raise _fault(f"{where}: its mass is {value}", "Masses are positive.")
        result.append((sp.Symbol(word, real=True) if value else value, value))
    return result


def _body(joint: _Joint, parent: int | None, mass: sp.Expr) -> Body:
    """A joint and its link, in numbers."""
    where, link = f"joint {joint.name}", f"link {joint.child}"
    rotation, offset = _origin(where, joint.entry)
    axis = _rationals(where, joint.entry.find("axis"), "xyz", "1 0 0")
    if not any(axis):
        raise _fault(f"{where}: its axis is 0 0 0", "Give its direction, as 0 0 1.")
    inertial = joint.link.find("inertial")
    turned, centre = _origin(link, inertial)
    entry = None if inertial is None else inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        _rationals(link, entry, f"i{axes}", "0")[0] for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    inertia = sp.Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if is_positive_semidefinite(inertia) is False:
        fault, _ = not_psd(inertia, "inertia", {})
        raise _fault(f"{link}: {fault}", "A body resists turning about every axis.")
    turned_inertia = turned @ np.array(inertia) @ turned.T
    return Body(
        parent, joint.motion, rotation, offset, rational_unit(axis), mass, centre, turned_inertia
    )


def _rationals(where: str, entry: Element | None, label: str, default: str) -> list[sp.Rational]:
    """The numbers of an attribute, as many as its default has."""
    return [sp.Rational(str(number)) for number in _decimals(where, entry, label, default)]


def _decimals(where: str, entry: Element | None, label: str, default: str) -> list[Decimal]:
    text = default if entry is None else entry.get(label, default)
    try:
        numbers = [Decimal(word) for word in text.split()]
    except InvalidOperation:
        numbers = []
    usable = all(x.is_finite() and (not x or abs(x.adjusted()) <= _LARGEST) for x in numbers)
    if not usable or len(numbers) != len(default.split()):
        tag = "" if entry is None else f", <{entry.tag}>"
        fault = f"{where}{tag}: {label} = {text[:60]!r}"
        raise _fault(fault, f"Write {len(default.split())} finite number(s), as {default!r}.")
    return numbers


def _origin(where: str, entry: Element | None) -> tuple[Any, Any]:
    """Rotation, 3 × 3, and offset, (3,), of a part's <origin>."""
    origin = None if entry is None else entry.find("origin")
    roll, pitch, yaw = (
        rational_rotation(axis, angle)
        for axis, angle in enumerate(_decimals(where, origin, "rpy", "0 0 0"))
    )
    return yaw @ pitch @ roll, np.array(_rationals(where, origin, "xyz", "0 0 0"))
