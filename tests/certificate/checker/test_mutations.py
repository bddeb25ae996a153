"""Anything changed in a certificate or in its design is found, or what it says is still true."""

import copy
import hashlib
import json

import numpy as np
import pytest
from helpers.oscillators import soft_pendulum
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.reading import model_hash
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.design import Design
from necc_casadi.errors import OutputError


def leaves(data, path=()):
    """Paths of all numbers, words and truth values."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        if isinstance(value, (dict, list)):
            yield from leaves(value, (*path, key))
        else:
            yield (*path, key)


def at(data, path):
    for key in path:
        data = data[key]
    return data


def put(data, path, value):
    at(data, path[:-1])[path[-1]] = value


@pytest.fixture(scope="module")
def stored():
    """(design, certificate) of a design, as data."""
    made = soft_pendulum()
    return json.loads(made.text), json.loads(certify(made).to_json())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("mutated")


def accepted(folder, design, certificate) -> bool:
    """Whether every claim holds; a folder that cannot be read is not accepted."""
    text = json.dumps(design, ensure_ascii=False)
    certificate = {**certificate, "design_hash": hashlib.sha256(text.encode()).hexdigest()}
    (folder / "design.json").write_text(text, encoding="utf-8")
    (folder / "certificate.json").write_text(json.dumps(certificate), encoding="utf-8")
    try:
        return all(result.holds for result in check(folder))
    except OutputError:
        return False


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(0.5, 2.0).map(lambda factor: ("times", factor)),
    st.integers(-3, 3).map(lambda step: ("plus", step)),
)
OTHER = st.sampled_from([None, True, False, "", "z̄ is globally stable", [], {}, 1e308, -1, 0])


def mutated(value, drawn):
    """A number changed a little or wholly, a word cut or changed, or anything else."""
    if isinstance(drawn, tuple) and isinstance(value, (int, float)) and value is not True:
        kind, amount = drawn
        return value * amount if kind == "times" else value + amount
    if isinstance(value, str) and isinstance(drawn, float):
        return value[: int(abs(drawn)) % (len(value) + 1)]
    return drawn if not isinstance(drawn, tuple) else "other words"


#: Of these a smaller number claims less, of those a larger one; all are proved for what they say.
SMALLER = {"mu", "rate", "slope", "level_above_minimum"}
LARGER = {"bound_rigorous", "gradient_norm"}
#: What rounding adds to a bound that another arithmetic may do without.
ROUNDED = 1e-3


def claims_less(path, old, new) -> bool:
    """Whether the changed number claims less than the one that was proved."""
    if isinstance(new, bool) or not isinstance(new, (int, float)):
        return False
    if path[0] == "reach":
        return new < old if path[-1] == 0 else new > old
    if path[-1] in SMALLER:
        return new < old
    if path[-1] == "bound_rigorous":  # rounded outwards: the checker proves a little less, too
        return new > (1 - ROUNDED) * old
    return path[-1] in LARGER and new > old


def is_a_hint(path) -> bool:
    """Numbers from which the checker finds a proof: another proof is as good.

    z̄ is claimed to lie within `enclosure` of `z_bar`, ‖∇V(z*)‖ below `gradient_norm` and Ω within
    `reach`, which is proved of them as they stand.
    """
    return path[0] in ("z_bar", "enclosure", "region", "reach") or path[-1] == "gradient_norm"


def mutation_is_found(folder, stored, index, drawn):
    design, certificate = copy.deepcopy(stored[0]), copy.deepcopy(stored[1])
    paths = [path for path in leaves(certificate) if path != ("design_hash",)]
    path = paths[index % len(paths)]
    old = at(certificate, path)
    new = mutated(old, drawn)
    assume(json.dumps(new) != json.dumps(old))
    assume(not (isinstance(new, (int, float)) and isinstance(old, (int, float)) and new == old
                and type(new) is not bool and type(old) is not bool))  # fmt: skip
    put(certificate, path, new)
    if accepted(folder, design, certificate):
        assert is_a_hint(path) or claims_less(path, old, new), (path, old, new)


SETTINGS = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.too_slow, HealthCheck.function_scoped_fixture,
                              HealthCheck.filter_too_much],
}  # fmt: skip
DRAWN = (st.integers(0, 10_000), st.one_of(NUMBERS, OTHER))


@settings(max_examples=50, **SETTINGS)
@given(*DRAWN)
@example(0, ("times", 1.5))
def test_a_changed_certificate_is_rejected(folder, stored, index, drawn):
    mutation_is_found(folder, stored, index, drawn)


@pytest.mark.slow
@settings(max_examples=1000, **SETTINGS)
@given(*DRAWN)
def test_a_thousand_changed_certificates_are_rejected(folder, stored, index, drawn):
    mutation_is_found(folder, stored, index, drawn)


#: Parts of design.json on which a proof rests; the others are a record of how it was made.
PROVED = ("model", "form", "weights", "xi_star", "D", "Dc", "casimirs", "target", "units")


RECORDS = {("model", key) for key in ("name", "units", "properties", "plant_properties")}


def changed_text(text, drawn):
    if not isinstance(drawn, tuple):
        return mutated(text, drawn)
    kind, amount = drawn
    try:
        number = float.fromhex(text)
        return (number * amount if kind == "times" else number + amount).hex()
    except ValueError:
        return f"{amount}*({text})" if kind == "times" else f"({text}) + {amount}"


def holds_numerically(text, certificate) -> bool:
    """What the certificate says at z̄ and of the structure, evaluated by CasADi in doubles."""
    try:
        made = Design.from_text(text)
    except OutputError:
        return True  # nobody simulates or exports it
    z, rng = np.array(certificate["z_bar"]), np.random.default_rng(0)
    law = made.lyapunov
    gradient = np.asarray(law.gradient(z), float).ravel()
    curvature = np.linalg.eigvalsh(np.asarray(law.hessian(z), float))[0]
    rate = next(c for c in certificate["claims"] if c["name"] == "attraction")["data"]["rate"]
    spectrum = np.linalg.eigvals(made.lyapunov.linearisation(z)).real.max()
    structured = True
    for x in made.z_star[: made.loop.plant.n] + rng.normal(size=(5, made.loop.plant.n)):
        values = dict(zip(made.loop.plant.x, x, strict=True))
        J, R = (np.array(m.subs(values).evalf(), float)
                for m in (made.loop.plant.J, made.loop.plant.R))  # fmt: skip
        structured &= bool(np.abs(J + J.T).max() == 0 and np.linalg.eigvalsh(R)[0] >= -1e-12)
    return bool(
        structured
        and np.abs(gradient).max() < 1e-9
        and curvature > 0.99 * certificate["mu"]
        and spectrum < -0.99 * rate
        and min(np.linalg.eigvalsh(D)[0] for D in (made.D, made.Dc)) > 0
    )


def design_mutation_is_found(folder, stored, index, drawn):
    """A changed design is accepted only if the certificate is true of it as well."""
    design, certificate = copy.deepcopy(stored[0]), stored[1]
    paths = [path for path in leaves(design) if path[0] in PROVED and path[:2] not in RECORDS]
    path = paths[index % len(paths)]
    old = at(design, path)
    new = changed_text(old, drawn) if isinstance(old, str) else mutated(old, drawn)
    assume(json.dumps(new) != json.dumps(old))
    put(design, path, new)
    design["model_hash"] = model_hash(design)
    if accepted(folder, design, certificate):
        text = (folder / "design.json").read_text(encoding="utf-8")
        assert holds_numerically(text, certificate), (path, old, new)


def test_an_edited_model_is_rejected_by_its_hash(folder, stored):
    design = copy.deepcopy(stored[0])
    design["model"]["name"] = "other"
    assert not accepted(folder, design, stored[1])
    design["model_hash"] = model_hash(design)
    assert accepted(folder, design, stored[1])


@settings(max_examples=50, **SETTINGS)
@given(*DRAWN)
def test_a_changed_design_is_rejected(folder, stored, index, drawn):
    design_mutation_is_found(folder, stored, index, drawn)


@pytest.mark.slow
@settings(max_examples=1000, **SETTINGS)
@given(*DRAWN)
def test_a_thousand_changed_designs_are_rejected(folder, stored, index, drawn):
    design_mutation_is_found(folder, stored, index, drawn)


def test_what_was_not_changed_is_accepted(folder, stored):
    assert accepted(folder, *stored)
    assert holds_numerically((folder / "design.json").read_text(encoding="utf-8"), stored[1])
