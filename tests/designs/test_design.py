"""design.json: bit for bit back, in another process too; what was edited is refused."""

import json
import subprocess
import sys

import numpy as np
import pytest
from helpers import reference

from necc_casadi.designs.design import Design
from necc_casadi.designs.layout import DESIGN_FORMAT
from necc_casadi.errors import OutputError
from necc_casadi.files import write_text

PROBE = """
import sys, hashlib, numpy as np
from necc_casadi.designs.design import Design
made = Design.load(sys.argv[1])
z = np.array([float.fromhex(v) for v in sys.argv[2].split(",")])
u, rate = made.control(z[:made.loop.plant.n], z[made.loop.plant.n:])
print(made.hash, made.V(z).hex(), *[float(v).hex() for v in (*u, *rate)])
"""


def test_loading_rebuilds_everything_bit_for_bit(any_design, points, tmp_path):
    loaded = Design.load(any_design.save(tmp_path / "design.json"))
    n = any_design.loop.plant.n
    assert loaded.text == any_design.text == (tmp_path / "design.json").read_text("utf-8")
    assert loaded.hash == any_design.hash
    for name in ("weights", "xi_star", "damping", "z_star", "z_bar"):
        assert np.array_equal(getattr(loaded, name), getattr(any_design, name))
    assert loaded.form == any_design.form
    assert loaded.loop.M == any_design.loop.M
    assert loaded.loop.plant.H == any_design.loop.plant.H
    assert loaded.casimirs.functions == any_design.casimirs.functions
    for z in points(any_design, 5, 3.0):
        assert loaded.V(z) == any_design.V(z)
        for a, b in zip(
            loaded.control(z[:n], z[n:]), any_design.control(z[:n], z[n:]), strict=True
        ):
            assert np.array_equal(a, b)
    for a, b in zip(loaded.linearise(), any_design.linearise(), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("name", ["default", "beta-sum neural"])
def test_another_process_with_another_hash_seed_agrees(designs, name, points, tmp_path):
    made = designs[name]
    path = made.save(tmp_path / "design.json")
    z = points(made, 1)[0]
    n = made.loop.plant.n
    u, rate = made.control(z[:n], z[n:])
    expected = [made.hash, made.V(z).hex(), *[float(v).hex() for v in (*u, *rate)]]
    for seed in ("1", "4242"):
        done = subprocess.run(
            [sys.executable, "-c", PROBE, str(path), ",".join(float(v).hex() for v in z)],
            capture_output=True, text=True, check=True,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path), "PATH": ""},
        )  # fmt: skip
        assert done.stdout.split() == expected


def test_a_folder_is_as_good_as_its_file(default_design, tmp_path):
    default_design.save(tmp_path / "design.json")
    assert Design.load(tmp_path).hash == default_design.hash


def test_the_file_is_plain_json_with_hexadecimal_weights(default_design):
    data = json.loads(default_design.text)
    assert data["format"] == DESIGN_FORMAT
    assert [float.fromhex(v) for v in data["weights"]] == default_design.weights.tolist()
    assert data["seed"] == 0
    assert {"necc-casadi", "casadi", "numpy", "sympy"} <= set(data["versions"])
    assert len(data["model_hash"]) == 64


def _edit(path, value):
    def change(data):
        *parents, last = path
        for key in parents:
            data = data[key]
        data[last] = value(data[last]) if callable(value) else value

    return change


EDITS = {
    "another format": _edit(["format"], DESIGN_FORMAT + 1),
    "no format": lambda data: data.pop("format"),
    "no verdict": lambda data: data.pop("verdict"),
    "another energy": _edit(["model", "H"], "p**2/2 + 2 - 2*cos(q)"),
    "code for energy": _edit(["model", "H"], "__import__('os').getcwd()"),
    "no energy": _edit(["model", "H"], None),
    "an unknown name": _edit(["model", "H"], "p**2 + zeta"),
    "J not skew": _edit(["model", "J"], [["0", "1"], ["1", "0"]]),
    "too few weights": _edit(["weights"], lambda w: w[:-1]),
    "nested weights": _edit(["weights"], lambda w: [w]),
    "no weights": _edit(["weights"], None),
    "weights that are nan": _edit(["weights"], lambda w: ["nan"] * len(w)),
    "weights that overflow": _edit(["weights"], lambda w: ["0x1p99999"] * len(w)),
    "weights that are words": _edit(["weights"], lambda w: ["much"] * len(w)),
    "an unknown activation": _edit(["form", "k", "activation"], "relu"),
    "negative widths": _edit(["form", "k", "hidden"], [-3]),
    "too many inputs": _edit(["form", "k", "inputs"], 7),
    "damping that feeds energy": _edit(["D"], [["-0x1p0"]]),
    "damping of another shape": _edit(["D"], ["0x1p0"]),
    "a coupling that feeds energy": _edit(["coupling"], [[["0x1p9"]], [["0x1p9"]]]),
    "a coupling of another shape": _edit(["coupling"], [["0x1p0"], ["0x1p0"]]),
    "half a coupling": _edit(["coupling"], [[["0x1p0"]]]),
    "an infinite coupling": _edit(["coupling"], [[["inf"]], [["-inf"]]]),
    "no controller state": _edit(["xi_star"], []),
    "half a target": _edit(["target"], lambda t: t[:1]),
    "a complex target": _edit(["target"], ["log(-1)", "0"]),
    "an infinite target": _edit(["target"], ["1e400", "0"]),
    "units that are a number": _edit(["model", "units"], 3),
    "an empty start": _edit(["starts"], [{}]),
    "clashing states": _edit(["model", "states"], ["q", "q"]),
}


@pytest.mark.parametrize("name", EDITS)
def test_edited_files_are_refused(default_design, tmp_path, name):
    data = json.loads(default_design.text)
    EDITS[name](data)
    path = tmp_path / "design.json"
    path.write_text(json.dumps(data))
    with pytest.raises(OutputError) as caught:
        Design.load(path)
    assert caught.value.code == "output"
    assert str(path) in caught.value.fault


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[1]", b"0", b"null", b"\xff", b"[" * 100_000, b'{"format": 1}', b"x = 1\n"],
)
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "design.json"
    path.write_bytes(content)
    with pytest.raises(OutputError):
        Design.load(path)
    with pytest.raises(OutputError):
        Design.load(tmp_path / "none")


def test_truncated_anywhere_it_is_refused(default_design):
    text = default_design.text
    for end in range(0, len(text) - 3, len(text) // 40):
        with pytest.raises(OutputError):
            Design.from_text(text[:end])


def test_writing_is_whole_or_not_at_all(tmp_path):
    target = tmp_path / "a" / "b" / "text"
    assert write_text(target, "one") == target
    write_text(target, b"two")
    assert target.read_bytes() == b"two"
    (tmp_path / "taken" / "inside").mkdir(parents=True)
    for blocked in (tmp_path / "taken", target / "below"):
        with pytest.raises(OutputError):
            write_text(blocked, "three")
    assert {p.name for p in tmp_path.rglob("*")} == {"a", "b", "text", "taken", "inside"}


def test_linearise_by_finite_differences(any_design):
    """A, B, C, D of ż = f(z) + 𝒢(v, v_c), outputs y = Gᵀ∇H, y_c = Gcᵀ∇Hc."""
    import sympy as sp

    A, B, C, D = any_design.linearise()
    loop, z, n = any_design.loop, any_design.z_bar, any_design.loop.plant.n
    m = loop.plant.m

    def f(s):
        return np.asarray(any_design.lyapunov.vector_field(s)).ravel()

    G, Gc, grad_H = (
        sp.lambdify([loop.z], sp.Matrix(v), "numpy")
        for v in (loop.plant.G, loop.controller.Gc, loop.plant.grad_H)
    )
    theta = any_design.form.split(any_design.weights)[0]

    def outputs(s):
        y = np.asarray(G(s), float).T @ np.asarray(grad_H(s), float).ravel()
        slope = reference.jacobian(
            lambda xi: reference.network(any_design.form.hc, theta, xi), s[n:]
        )
        return np.concatenate([y, np.asarray(Gc(s), float).T @ slope.ravel()])

    np.testing.assert_allclose(A, reference.jacobian(f, z), atol=1e-7)
    np.testing.assert_allclose(C, reference.jacobian(outputs, z, 1e-2), atol=1e-6)
    assert B.shape == (loop.n, 2 * m)
    np.testing.assert_allclose(B[:n, :m], np.asarray(G(z), float), atol=1e-14)
    np.testing.assert_allclose(B[n:, m:], np.asarray(Gc(z), float), atol=1e-14)
    assert not B[:n, m:].any()
    assert not B[n:, :m].any()
    assert np.array_equal(D, np.zeros((2 * m, 2 * m)))


def test_z_bar_is_a_minimum_near_the_target(any_design):
    V, z = any_design.lyapunov, any_design.z_bar
    assert np.linalg.norm(np.asarray(V.gradient(z))) <= 1e-12
    assert np.linalg.eigvalsh(np.asarray(V.hessian(z)))[0] > 0
    assert np.linalg.norm(z - any_design.z_star) <= 1e-8
