"""Attraction by dissipation that vanishes at z̄: claimed where both sides prove it, never else."""

import copy
import hashlib
import json

import pytest
import sympy as sp
from helpers.certificates import claim, verdicts, written
from helpers.commands import design as command
from helpers.constructed import make_design, mechanical
from helpers.dragged import ATTRACT, SWING, UNDECIDED, chain, dragged, on_momenta, p1, p3, q1
from helpers.oscillators import QUADRATIC

from necc_casadi.certificate.checker.reading import model_hash
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.cli.terminal import run


def local(design):
    return certify(design, region=False)


def stored(folder, name):
    return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))


def put(folder, design, certificate):
    """Both files, each with the hash that belongs to it: only a proof can tell what was changed."""
    design["model_hash"] = model_hash(design)
    text = json.dumps(design, ensure_ascii=False)
    certificate["design_hash"] = hashlib.sha256(text.encode()).hexdigest()
    folder.mkdir(exist_ok=True)
    (folder / "design.json").write_text(text, encoding="utf-8")
    (folder / "certificate.json").write_text(json.dumps(certificate), encoding="utf-8")


@pytest.mark.parametrize("R", ATTRACT.values(), ids=ATTRACT)
def test_both_prove_it_without_a_rate(R, tmp_path):
    design = dragged(R)
    certificate = local(design)
    assert certificate.certified
    assert certificate.stability == "asymptotic"
    assert certificate.attracts_at_no_rate
    assert claim(json.loads(certificate.to_json()), "attraction")["data"] == {}
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert all(verdicts(tmp_path).values())
    assert run(_certify, [str(tmp_path)]) == 0


def test_a_region_is_then_invariant(tmp_path):
    folder = written(dragged(ATTRACT["on one"]), tmp_path)
    assert claim(stored(folder, "certificate"), "region")["data"]["follows"] == "invariant"
    assert all(verdicts(folder).values())


@pytest.mark.parametrize("R", [*SWING.values(), *UNDECIDED.values()], ids=[*SWING, *UNDECIDED])
def test_what_is_not_proved_is_not_claimed(R):
    certificate = local(dragged(R))
    assert certificate.stability is None
    assert not certificate.certified


@pytest.fixture(scope="module")
def proved(tmp_path_factory):
    """(design, certificate) as data, of drag p₁² on one mass."""
    folder = tmp_path_factory.mktemp("proved")
    made = dragged(ATTRACT["on one"])
    made.save(folder / "design.json")
    (folder / "certificate.json").write_text(local(made).to_json(), encoding="utf-8")
    return stored(folder, "design"), stored(folder, "certificate")


@pytest.mark.parametrize("R", [*SWING.values(), *UNDECIDED.values()], ids=[*SWING, *UNDECIDED])
def test_a_claim_that_fails_is_refused(R, proved, tmp_path):
    """The proved certificate beside a design with other drag."""
    dragged(R).save(tmp_path / "other.json")
    put(tmp_path, stored(tmp_path, "other"), copy.deepcopy(proved[1]))
    held = verdicts(tmp_path)
    assert not held["attraction"]
    assert held["casimir"]
    assert run(_certify, [str(tmp_path)]) == 4


@pytest.mark.parametrize(
    ("entry", "holds"),
    [
        ("p1**2", True),
        ("3*p1**2", True),
        ("p1**2*p3**2", True),
        ("(p1 - p3)**2", True),
        ("p2**2", False),
        ("(p1 + p3)**2", False),
        ("(p1 + p3)**2*p1**2", False),
        ("(p1**2 + q1**3)**2", False),
        ("(p1**2 + q1**3)**2*p1**2", False),
        ("p1**3", False),
        ("-p1**2", False),
        ("0", False),
    ],
)
def test_drag_edited_in_the_design(entry, holds, proved, tmp_path):
    design, certificate = copy.deepcopy(proved)
    assert design["model"]["R"][3][3] == "p1**2"
    design["model"]["R"][3][3] = entry
    put(tmp_path, design, certificate)
    assert verdicts(tmp_path)["attraction"] == holds
    assert run(_certify, [str(tmp_path)]) == (0 if holds else 4)


def test_no_rate_can_be_claimed(proved, tmp_path):
    for rate in (0.0, 1e-9, 1.0):
        design, certificate = copy.deepcopy(proved)
        attraction = claim(certificate, "attraction")
        attraction["data"] = {"rate": rate}
        attraction["statement"] = statements.attraction(rate)
        put(tmp_path, design, certificate)
        assert not verdicts(tmp_path)["attraction"]


def test_nothing_else_may_stand_beside_it(proved, tmp_path):
    design, certificate = copy.deepcopy(proved)
    claim(certificate, "attraction")["data"] = {"branches": 2}
    put(tmp_path, design, certificate)
    assert not verdicts(tmp_path)["contents"]
    design, certificate = copy.deepcopy(proved)
    claim(certificate, "attraction")["statement"] += " within a second"
    put(tmp_path, design, certificate)
    assert not verdicts(tmp_path)["attraction"]


def test_what_is_less_than_a_rate_may_be_claimed(tmp_path):
    """Of two truths the weaker: constant drag, no rate."""
    folder = tmp_path / "made"
    folder.mkdir()
    made = dragged(on_momenta(1))
    made.save(folder / "design.json")
    (folder / "certificate.json").write_text(local(made).to_json(), encoding="utf-8")
    design, certificate = stored(folder, "design"), stored(folder, "certificate")
    attraction = claim(certificate, "attraction")
    assert attraction["data"]["rate"] > 0
    attraction["data"], attraction["statement"] = {}, statements.attraction(None)
    put(tmp_path, design, certificate)
    assert all(verdicts(tmp_path).values())


@pytest.mark.parametrize("target", ["1/3", "sqrt(2)/3"])
def test_a_gain_that_vanishes_at_the_target_but_maybe_not_at_the_minimum(target, tmp_path):
    """z̄ is known up to rounding: that φ(z̄) = 0 is neither proved nor needed."""
    q = sp.sympify(target)
    middle = float(2 * q)
    weights = [0, 0, 1.0, middle, 0, 0, 1.0, 2 * middle]
    plant = chain(on_momenta((q1 - q) ** 2 * p1**2))
    # q₂ = 2q₁ = 2q₃, where the springs pull with 2q₂ − q₁ − q₃ = q₂ = −K′ = −Hc′
    made = make_design(plant, [q, 2 * q, q, 0, 0, 0], QUADRATIC, weights, [0.0])
    folder = written(made, tmp_path)
    certificate = stored(folder, "certificate")
    assert certificate["stability"] == "asymptotic"
    assert claim(certificate, "attraction")["data"] == {}
    assert all(verdicts(folder).values())


def test_other_units_change_nothing(tmp_path):
    """Masses of 10⁻⁶, with drag in the same units."""
    small = sp.Rational(1, 10**6)
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2) / small / 2
            + (q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2 + q3**2) / 2
        ),
        3, inputs=[1], R=on_momenta(10**5 * p1**2, (p1 - p3) ** 4),
    )  # fmt: skip
    made = make_design(plant, [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    certificate = local(made)
    assert certificate.attracts_at_no_rate
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert all(verdicts(tmp_path).values())


MODEL = """
import sympy as sp
q1, q2, q3, p1, p2, p3 = x = sp.symbols("q1:4 p1:4", real=True)
J = sp.zeros(6, 6)
J[:3, 3:], J[3:, :3] = sp.eye(3), -sp.eye(3)
R = sp.diag(0, 0, 0, p1**2, 0, p3**2)
G = sp.Matrix([0, 0, 0, 0, 1, 0])
H = (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2 + q3**2) / 2
"""


@pytest.mark.slow
def test_a_design_from_model_to_certificate(tmp_path):
    (tmp_path / "chain.py").write_text(MODEL, encoding="utf-8")
    out = tmp_path / "made"
    options = ("--target=q1=1/2,q2=1,q3=1/2", f"--out={out}", "--no-plots", "--compare", "-v")
    code, text, _ = command(tmp_path / "chain.py", *options, "--sample-time=0.01")
    assert code == 0
    assert "certified, asymptotically stable (at no proved rate)" in text.splitlines()[0]
    assert "spectral abscissa 0 1/s" in text
    assert "simulated  not known" in text
    assert "phase margin" not in text
    assert "stable at 0.01 s is not known" in " ".join(text.split())
    assert run(_certify, [str(out)]) == 0
    code, text, _ = command(tmp_path / "chain.py", *options, "--settle=20", "--json")
    data = json.loads(text)
    assert code == 4
    assert data["asked"]["rate_reached"] == data["design"]["spectral_abscissa"] == 0
