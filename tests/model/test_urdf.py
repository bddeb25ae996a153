"""Arms in URDF: M and V beside the kinetic energy of positions in motion, and what is refused."""

from xml.etree import ElementTree

import numpy as np
import pytest
import sympy as sp
from helpers.problems import PENDULUM
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.errors import ModelError
from necc_casadi.model.model_file import load_model, make_model
from necc_casadi.model.urdf import read_urdf

#: Two rods of 1 kg and 1 m in a vertical plane; q = 0 hangs.
ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 -0.5"/> <mass value="1"/>
      <inertia ixx="0.08" iyy="0.0833" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="lower">
    <inertial>
      <origin xyz="0 0 -0.5"/> <mass value="1"/>
      <inertia ixx="0.08" iyy="0.0833" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/> <axis xyz="0 -1 0"/>
    <limit lower="-3" upper="3" effort="40" velocity="5"/> <dynamics damping="0.1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/> <child link="lower"/> <origin xyz="0 0 -1"/> <axis xyz="0 -1 0"/>
    <limit lower="-2.5" upper="2.5" effort="15" velocity="5"/>
  </joint>
</robot>
"""


def written(folder, text, name="arm.urdf"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_two_rods(tmp_path):
    """The closed form of every textbook."""
    arm = read_urdf(written(tmp_path, ARM))
    q1, q2 = arm["q"]
    g, m1, m2 = arm["params"]
    rod = sp.Rational(833, 10000)
    lower = m2 / 4 + rod
    coupled = lower + m2 * sp.cos(q2) / 2
    upper = m1 / 4 + rod + m2 + m2 * sp.cos(q2) + lower
    assert (arm["M"] - sp.Matrix([[upper, coupled], [coupled, lower]])).expand().is_zero_matrix
    weight = g * (m1 / 2 + m2) * (1 - sp.cos(q1)) + g * m2 * (1 - sp.cos(q1 + q2)) / 2
    assert sp.expand(arm["V"] - weight) == 0
    assert arm["params"] == {g: sp.Rational(981, 100), m1: 1, m2: 1}
    assert sp.eye(2) == arm["B"]
    assert sp.diag(sp.Rational(1, 10), 0) == arm["friction"]
    assert arm["u_limits"] == [(-40, 40), (-15, 15)]
    assert arm["domain"] == {q1: (-3, 3), q2: (-sp.Rational(5, 2), sp.Rational(5, 2))}
    assert arm["inputs"] == ("tau_shoulder", "tau_elbow")
    assert arm["units"] == {q1: "rad", q2: "rad", "tau_shoulder": "N m", "tau_elbow": "N m"}


def test_an_arm_is_a_model(tmp_path):
    path = written(tmp_path, ARM)
    model = load_model(path, {"m_lower": "2"})
    plant = model.loop.plant
    assert plant.states == ("shoulder", "elbow", "p_shoulder", "p_elbow")
    assert plant.name == "arm"
    assert plant.inertia[1, 1] == sp.Rational(5833, 10000)
    assert plant.u_limits == ((-40, 40), (-15, 15))
    assert make_model(**read_urdf(path)).loop.plant.states == plant.states
    own = tmp_path / "own.py"
    own.write_text(
        "from pathlib import Path\nfrom necc_casadi import read_urdf\n"
        "globals().update(read_urdf(Path(__file__).with_name('arm.urdf')))\n"
        "u_limits = None\ntarget = {'shoulder': 0.5, 'elbow': 1}\n",
        encoding="utf-8",
    )
    assert load_model(own).loop.plant.u_limits is None


def test_drives(tmp_path):
    """By the transmissions or interfaces of a file, else by efforts that are not 0."""
    passive = ARM.replace('effort="15"', 'effort="0"')
    assert sp.Matrix([1, 0]) == read_urdf(written(tmp_path, passive))["B"]
    transmission = '<transmission name="t"><joint name="elbow"/></transmission></robot>'
    one = read_urdf(written(tmp_path, ARM.replace("</robot>", transmission)))
    assert sp.Matrix([0, 1]) == one["B"]
    assert one["u_limits"] == [(-15, 15)]
    control = """<ros2_control name="c" type="system">
      <joint name="shoulder"><command_interface name="effort"/></joint>
      <joint name="elbow"><state_interface name="position"/></joint></ros2_control></robot>"""
    assert sp.Matrix([1, 0]) == read_urdf(written(tmp_path, ARM.replace("</robot>", control)))["B"]


# -- M and V beside positions in motion --------------------------------------------------------


def turned(axis, angle):
    """Rodrigues' formula, in floats."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def numbers(element, label, default):
    text = default if element is None else element.get(label, default)
    return np.array([float(value) for value in text.split()])


def pose(origin):
    T = np.eye(4)
    roll, pitch, yaw = numbers(origin, "rpy", "0 0 0")
    T[:3, :3] = turned([0, 0, 1], yaw) @ turned([0, 1, 0], pitch) @ turned([1, 0, 0], roll)
    T[:3, 3] = numbers(origin, "xyz", "0 0 0")
    return T


def poses(text, q: dict):
    """Frame of every link's inertia in the world, as 4 × 4, with mass and inertia."""
    root, at = ElementTree.fromstring(text), {"base": np.eye(4)}
    for joint in root.iter("joint"):
        T = at[joint.find("parent").get("link")] @ pose(joint.find("origin"))
        axis, move = numbers(joint.find("axis"), "xyz", "1 0 0"), np.eye(4)
        if joint.get("type") == "revolute":
            move[:3, :3] = turned(axis, q[joint.get("name")])
        elif joint.get("type") == "prismatic":
            move[:3, 3] = axis / np.linalg.norm(axis) * q[joint.get("name")]
        at[joint.find("child").get("link")] = T @ move
    for link in root.iter("link"):
        if link.find("inertial") is not None:
            inertial = link.find("inertial")
            xx, xy, xz, yy, yz, zz = (
                float(inertial.find("inertia").get(f"i{axes}"))
                for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
            )
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            mass = float(inertial.find("mass").get("value"))
            yield at[link.get("name")] @ pose(inertial.find("origin")), mass, inertia


def energies(text, q, qdot, step=1e-5):
    """Kinetic and potential energy by central differences of positions."""
    kinetic = potential = 0.0
    moved = (list(poses(text, {x: q[x] + sign * step * qdot[x] for x in q})) for sign in (1, -1))
    for (T, mass, inertia), (ahead, *_), (behind, *_) in zip(poses(text, q), *moved, strict=True):
        rate = (ahead - behind) / (2 * step)
        spin = T[:3, :3].T @ rate[:3, :3]
        omega = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        kinetic += mass * rate[:3, 3] @ rate[:3, 3] / 2 + omega @ inertia @ omega / 2
        potential += mass * 9.81 * T[2, 3]
    return kinetic, potential


short = st.integers(-20, 20).map(lambda k: k / 10)  # no angle is a quarter turn cut off
triple = st.tuples(short, short, short).map(lambda v: f"{v[0]} {v[1]} {v[2]}")
moments = st.tuples(*[st.integers(1, 50)] * 3)


@st.composite
def robots(draw):
    """Trees of up to three joints that move, fixed ones between them."""
    kinds = draw(
        st.lists(st.sampled_from(["revolute", "prismatic", "fixed"]), min_size=2, max_size=3)
    )
    kinds.append("revolute")
    parts = ["<link name='base'/>"]
    for i, kind in enumerate(kinds):
        parent = draw(st.sampled_from(["base", *(f"l{j}" for j in range(i))]))
        a, b, c = draw(moments)
        axis = draw(triple.filter(lambda text: any(map(float, text.split()))))
        parts.append(
            f"<link name='l{i}'><inertial><origin xyz='{draw(triple)}' rpy='{draw(triple)}'/>"
            f"<mass value='{draw(st.integers(1, 9))}'/><inertia ixx='{b + c}' iyy='{a + c}' "
            f"izz='{a + b}' ixy='0.1' ixz='-0.2' iyz='0.3'/></inertial></link>"
            f"<joint name='j{i}' type='{kind}'><parent link='{parent}'/><child link='l{i}'/>"
            f"<origin xyz='{draw(triple)}' rpy='{draw(triple)}'/><axis xyz='{axis}'/></joint>"
        )
    return f"<robot name='r'>{''.join(parts)}</robot>"


@settings(max_examples=8, deadline=None)
@given(robots(), st.lists(short, min_size=8, max_size=8))
def test_energies_are_those_of_positions_in_motion(tmp_path_factory, text, values):
    arm = read_urdf(written(tmp_path_factory.mktemp("arm"), text))
    names = [str(x) for x in arm["q"]]
    q, rates = dict(zip(names, values, strict=False)), dict(zip(names, values[4:], strict=False))
    at = {**arm["params"], **{x: q[str(x)] for x in arm["q"]}}
    M, qdot = np.array(arm["M"].subs(at).evalf(), dtype=float), np.array(list(rates.values()))
    kinetic, potential = energies(text, q, rates)
    _, at_rest = energies(text, dict.fromkeys(names, 0), rates)
    assert qdot @ M @ qdot / 2 == pytest.approx(kinetic, rel=1e-6, abs=1e-6)
    assert float(arm["V"].subs(at)) == pytest.approx(potential - at_rest, rel=1e-9, abs=1e-8)


@pytest.mark.parametrize("text", ["1.57", "1.5708", "1.570796", "1.5707963267948966", "-4.71"])
def test_quarter_turns_rounded_or_cut_off_are_exact(tmp_path, text):
    """A joint about the vertical feels no weight."""
    turned = ARM.replace('<axis xyz="0 -1 0"/>', "").replace(
        '<child link="upper"/>', f'<child link="upper"/><origin rpy="0 {text} 0"/>'
    )
    arm = read_urdf(written(tmp_path, turned))
    assert not arm["V"].has(arm["q"][0])
    near = read_urdf(written(tmp_path, turned.replace(f"0 {text} 0", "0 1.5 0")))
    assert near["V"].has(near["q"][0])


def test_a_turn_about_y_lowers_what_stands_along_x(tmp_path):
    text = ARM.replace('xyz="0 -1 0"', 'xyz="0 1 0"').replace("0 0 -0.5", "0.5 0 0")
    arm = read_urdf(written(tmp_path, text.replace('mass value="1"', 'mass value="2"', 1)))
    g, upper, lower = arm["params"]
    shoulder, elbow = arm["q"]
    height = -upper * sp.sin(shoulder) / 2 - lower * sp.sin(shoulder + elbow) / 2
    height += lower * (1 - sp.cos(shoulder))  # the elbow hangs below the shoulder
    assert sp.expand(arm["V"] - g * height) == 0


# -- what is refused ---------------------------------------------------------------------------

BOMB = """<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>
<robot name="&b;"/>"""
INERTIA = '<inertia ixx="0.08" iyy="0.0833" izz="0" ixy="0" ixz="0" iyz="0"/>'
FAULTS = {
    "no XML": ("<robot", "no XML"),
    "another document": ("<html/>", "<html>, not <robot>"),
    "entities": (BOMB, "document type"),
    "macros": ('<robot xmlns:xacro="http://ros.org/xacro"><xacro:a/></robot>', "xacro"),
    "no link": ("<robot/>", "no <link>"),
    "no joint": ('<robot><link name="base"/></robot>', "no joint that moves"),
    "two grounds": (ARM.replace("</robot>", '<link name="free"/></robot>'), "hang on no joint"),
    "two parents": (
        ARM.replace(
            '<parent link="base"/> <child link="upper"/>',
            '<parent link="base"/> <child link="lower"/>',
        ),
        "hangs on two joints, shoulder and elbow",
    ),
    "a ring": (ARM.replace('<parent link="base"/>', '<parent link="lower"/>'), "close a loop"),
    "no such link": (ARM.replace('child link="lower"', 'child link="hand"'), "'hand' is no link"),
    "a joint twice": (ARM.replace('"elbow"', '"shoulder"'), "shoulder"),
    "a ball": (ARM.replace('"elbow" type="revolute"', '"elbow" type="floating"'), "'floating'"),
    "a mimic": (
        ARM.replace("</joint>\n</robot>", '<mimic joint="shoulder"/></joint></robot>'),
        "mimic",
    ),
    "a negative mass": (ARM.replace('mass value="1"', 'mass value="-1"', 1), "its mass is -1"),
    "a negative inertia": (ARM.replace('iyy="0.0833"', 'iyy="-0.1"'), "inertia[1,1] = -0.1"),
    "an inertia beyond any body": (ARM.replace('ixy="0"', 'ixy="1"'), "semidefinite"),
    "no inertia behind a joint": (
        ARM.replace(INERTIA, "").replace("0 0 -0.5", "0 0 0"),
        "joint elbow moves no mass",
    ),
    "no number": (ARM.replace('xyz="0 0 -1"', 'xyz="0 0 x"'), "xyz = '0 0 x'"),
    "no finite number": (ARM.replace('damping="0.1"', 'damping="nan"'), "damping = 'nan'"),
    "a number of 10^9 digits": (ARM.replace('damping="0.1"', 'damping="1e999999999"'), "damping"),
    "two numbers of three": (ARM.replace('xyz="0 0 -1"', 'xyz="0 -1"'), "xyz = '0 -1'"),
    "no axis": (ARM.replace('xyz="0 -1 0"', 'xyz="0 0 0"'), "axis is 0 0 0"),
    "stops in the wrong order": (ARM.replace('lower="-3"', 'lower="4"'), "domain[shoulder]"),
    "negative damping": (ARM.replace('damping="0.1"', 'damping="-0.1"'), "friction"),
    "dry friction": (ARM.replace("damping=", 'friction="0.2" damping='), "dry friction 1/5"),
    "no drive": (
        ARM.replace('effort="40"', 'effort="0"').replace('effort="15"', 'effort="0"'),
        "driven",
    ),
    "one effort": (ARM.replace('effort="15"', ""), "joint elbow has no effort"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_refused_in_two_lines(tmp_path, fault):
    text, piece = FAULTS[fault]
    with pytest.raises(ModelError) as caught:
        load_model(written(tmp_path, text))
    assert len(str(caught.value).splitlines()) == 2
    assert piece in str(caught.value) or piece == caught.value.code


def test_a_joint_that_moves_no_mass_is_named(tmp_path):
    text = ARM.split('<link name="lower">')[0] + '<link name="lower"/>' + ARM.split("</link>")[2]
    with pytest.raises(ModelError, match=r"joint elbow moves no mass"):
        read_urdf(written(tmp_path, text))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        read_urdf(tmp_path / "absent.urdf")
    path = tmp_path / "binary.urdf"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match="not UTF-8"):
        read_urdf(path)


def test_other_models_are_not_taken_for_urdf():
    assert load_model(PENDULUM).loop.plant.states == ("q", "p")
