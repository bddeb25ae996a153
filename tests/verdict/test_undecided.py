"""Verdicts rest on proofs: exact numbers of any size, identities in disguise, analytic pieces."""

import json

import pytest
from helpers.commands import design

STATES = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / 2 + 1 - sp.cos(q)
"""
SADDLE = """
import sympy as sp
a, b, c, pa, pb, pc = x = sp.symbols("a b c p_a p_b p_c", real=True)
Z, E = sp.zeros(3, 3), sp.eye(3)
J = sp.Matrix(sp.BlockMatrix([[Z, E], [-E, Z]]))
R = sp.zeros(6, 6)
G = sp.Matrix([0, 0, 0, 0, 0, 1])
s = sp.Rational(1, 10**10)
kinetic = (pa**2 + pb**2 + pc**2) * 10**15 / 2
"""
ACROSS = """
import sympy as sp
q, p, s = x = sp.symbols("q p s", real=True)
f = {f}
J = sp.Matrix([[0, 1, f], [-1, 0, 0], [-f, 0, 0]])
R = sp.diag(0, 0, 1)
G = sp.Matrix([0, 1, 0])
H = p**2 / 2 + 1 - sp.cos(q) + s**2 / 2
"""
GRAVITY = """
import sympy as sp
w, g = sp.symbols("w1:4", real=True), sp.symbols("g1:4", real=True)
def cross(a):
    return sp.Matrix([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
x = (*w, *g)
J = sp.Matrix(sp.BlockMatrix([[cross(w), cross(g)], [cross(g), sp.zeros(3, 3)]]))
R = sp.zeros(6, 6)
G = sp.Matrix(sp.BlockMatrix([[sp.eye(3)], [sp.zeros(3, 3)]]))
H = (w[0] ** 2 + w[1] ** 2 + w[2] ** 2) / 2 + g[2]
"""


@pytest.fixture
def check(tmp_path):
    """(exit code, JSON) of --check for a model in text."""

    def run(text, target, *options):
        path = tmp_path / "model.py"
        path.write_text(text, encoding="utf-8")
        code, out, err = design(path, "--check", "--json", f"--target={target}", *options)
        assert "Traceback" not in err
        return code, json.loads(out)

    return run


def reason(result):
    code, data = result
    return code, data["verdict"]["reason"]


def error(result):
    code, data = result
    assert code == 2
    return data["error"]["code"], data["error"]["message"]


@pytest.mark.parametrize(
    ("energy", "expected"),
    [
        ("s * (5 * a**2 / 2 + 5 * b**2 / 2 - 9 * a * b)", (3, "invisible_negative_curvature")),
        ("s * (9 * a**2 / 2 + 9 * b**2 / 2 - 9 * a * b)", (3, "invisible_flat_curvature")),
        ("s * (9 * a**2 / 2 + 9 * b**2 / 2 - 5 * a * b)", (0, "ok")),
        ("sp.sqrt(2) * s**2 * (a - sp.sqrt(3) * b)**2", (3, "invisible_flat_curvature")),
        ("sp.sqrt(2) * s**2 * (a - sp.sqrt(3) * b)**2 + s**5 * b**2", (0, "ok")),
        (
            "sp.sqrt(2) * s**2 * (a - sp.sqrt(3) * b)**2 - s**5 * b**2",
            (3, "invisible_negative_curvature"),
        ),
    ],
)
def test_curvature_of_any_size_is_decided(check, energy, expected):
    text = SADDLE + f"H = kinetic + s * c**2 + {energy}\n"
    assert reason(check(text, "c=0.1,a=0,b=0")) == expected


@pytest.mark.parametrize("size", ["1", "1e-13", "1e-200"])
def test_negative_friction_of_any_size_is_found(check, size):
    text = STATES + (
        f'R = sp.diag(0, sp.Rational("{size}") * (sp.tanh(q) - sp.Rational(1, 10)))\n'
        "H = p**2 / 2 + q**2 / 2\n"
    )
    code, message = error(check(text, "q=1/5"))
    assert code == "r_not_psd"
    assert "R[1,1] = -" in message
    assert "q = " in message


def test_a_small_excess_off_the_diagonal_is_found(check):
    text = STATES + "e = sp.Rational(1, 10**13); R = sp.Matrix([[1, 1 + e], [1 + e, 1]])\n"
    assert error(check(text, "q=1,p=0"))[0] == "r_not_psd"
    text = STATES + "J = sp.Matrix([[0, 1 + sp.sin(q) / 10**15], [-1, 0]])\n"
    assert error(check(text, "q=1,p=0"))[0] == "j_not_skew"


@pytest.mark.parametrize("mass", ["1", "2e-11", "3e13"])
def test_a_bare_value_is_ambiguous_in_every_unit(check, mass):
    text = f"""
import sympy as sp
q1, q2, p1, p2 = x = sp.symbols("q1 q2 p1 p2", real=True)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 1, 0])
k = sp.Rational(1, 20)
H = (p1**2 + p2**2) / (2 * sp.Rational("{mass}")) + q1**2 + q2**2 + k * (q1 - q2) ** 2
"""
    code, message = error(check(text, "2e-6"))
    assert code == "target_ambiguous"
    assert "q1, q2" in message


PIECES = {
    "root of a square": "sp.sqrt(q**4 - 2*q**2 + 1) + q**2 - 1",
    "arc sine": "sp.asin(sp.sin(q)) - q",
    "arc tangents": "sp.atan(q) + sp.atan(1/q) - sp.pi/2",
    "square root of a square of a cosine": "sp.sqrt(1 - sp.sin(q)**2) - sp.cos(q)",
}


@pytest.mark.parametrize("f", PIECES.values(), ids=PIECES)
def test_a_coupling_that_vanishes_around_the_target_does_not_refuse_it(check, f):
    code, data = check(ACROSS.format(f=f), "q=1/2,p=0,s=0")
    assert (code, data["verdict"]["reason"]) == (0, "ok")
    assert data["verdict"]["casimirs"] == ["q - xi1"]
    assert any("branch point" in note for note in data["notes"])


def test_the_same_coupling_on_another_piece_is_there(check):
    code, data = check(ACROSS.format(f=PIECES["root of a square"]), "q=3,p=0,s=0")
    assert code in (3, 4)
    assert data["verdict"]["casimirs"] == []


@pytest.mark.parametrize("q1", [1, 30, 300, 3000])
def test_a_term_that_cancels_however_large_is_no_force(check, q1):
    text = """
import sympy as sp
q1, q2, p1, p2 = x = sp.symbols("q1 q2 p1 p2", real=True)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, 0, 1)
G = sp.Matrix([0, 0, 1, 0])
zero = (sp.exp(q1) + 1) ** 2 - sp.exp(2 * q1) - 2 * sp.exp(q1) - 1
H = p1**2 / 2 + p2**2 / 2 + q1**2 / 2 + q2**2 / 2 + q2 * zero
"""
    assert reason(check(text, f"q1={q1}")) == (0, "ok")


ZERO = "sp.atan(sp.Rational(1, 2)) + sp.atan(sp.Rational(1, 3)) - sp.pi / 4"
UNKNOWN = "2 ** sp.log(3) - 3 ** sp.log(2)"


@pytest.mark.parametrize("as_parameter", [True, False])
@pytest.mark.parametrize(("value", "expected"), [(ZERO, (0, "ok")), (UNKNOWN, (4, "undecided"))])
def test_a_friction_that_may_be_zero(check, value, expected, as_parameter):
    r = 'r = sp.Symbol("r"); params = {r: %s}' if as_parameter else "r = %s"
    assert reason(check(STATES + r % value + "\nR = sp.diag(r, 0)\n", "pi/4")) == expected


@pytest.mark.parametrize("target", ["pi/4", "q=pi/4,p=0"])
def test_an_input_that_may_not_be_there_is_never_relied_on(check, target):
    assert error(check(STATES + f"G = sp.Matrix([0, {ZERO}])\n", target))[0] == "g_rank"
    result = check(STATES + f"G = sp.Matrix([0, {UNKNOWN}])\n", target)
    assert reason(result) == (4, "undecided")
    assert "no proof was found whether" in result[1]["verdict"]["explanation"]
    assert result[1]["verdict"]["kernel_rank"] is None


def test_an_input_that_vanishes_at_the_target_is_none(check):
    assert error(check(STATES + "G = sp.Matrix([0, q])\n", "q=0,p=0"))[0] == "g_rank"
    text = STATES + "G = sp.Matrix([0, sp.atan(q) + sp.atan(1/q) - sp.pi/2])\n"
    assert error(check(text, "q=1,p=0"))[0] == "g_rank"
    assert reason(check(text, "q=-1,p=0")) == (0, "ok")


@pytest.mark.parametrize(
    ("third", "reason", "stability"),
    [(-1, "ok", "stable"), (1, "invisible_negative_curvature", None)],
)
def test_a_proposal_that_fails_is_dropped(check, third, reason, stability):
    """What the published loop refuses is held by another method."""
    code, data = check(GRAVITY, f"w1=0,w2=0,w3=0,g1=0,g2=0,g3={third}")
    assert (code, data["verdict"]["reason"]) == (0, reason)
    assert data["verdict"]["casimirs"] == ["g1**2 + g2**2 + g3**2"]
    assert data["verdict"]["stability"] == stability
    assert (data["method"]["name"] == "interconnection") == (reason == "ok")


LEAKS = {
    "tank": ("x1", "sp.zeros(1, 1)", "sp.eye(1)", "[1]", "x1=1", "R[0,0]", "x1"),
    "converter": (
        "x1 x2", "sp.Matrix([[0, -1], [1, 0]]) / 2", "sp.diag(0, sp.Rational(1, 10))", "[1, 0]",
        "x1=0.2,x2=1", "R[1,1]", "x2",
    ),
    "two tanks": (
        "x1 x2 x3", "sp.Matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])", "sp.diag(0, 0, 3)",
        "[[1, 0], [0, 0], [0, 1]]", "x1=0,x2=1,x3=2", "R[2,2]", "x3",
    ),
}  # fmt: skip


@pytest.mark.parametrize("leak", LEAKS.values(), ids=LEAKS)
def test_what_dissipates_at_rest_is_named(check, leak):
    names, J, R, G, target, entry, state = leak
    text = f"""
import sympy as sp
x = sp.symbols("{names},", real=True)
J, R, G = {J}, {R}, sp.Matrix({G})
H = sum(s**2 for s in x) / 2
""".replace(",,", ",").replace(" ", " ")
    text = text.replace(f'"{names},"', f'"{names.replace(" ", ",")},"')
    code, data = check(text, target, "--method=interconnection")
    assert (code, data["verdict"]["reason"]) == (3, "invisible_gradient")
    said = data["verdict"]["explanation"]
    assert said.startswith(f"{state} is invisible")
    assert f"Dissipation obstacle: {entry} = " in said
    assert f"dissipates in {state}," in said
    assert "controller structure (Jc, Gc)" not in said
    assert "Actuate" not in said


def test_no_actuation_is_advised_where_there_is_one(check):
    text = """
import sympy as sp
a, b = x = sp.symbols("a b", real=True)
J = sp.zeros(2, 2)
R = sp.zeros(2, 2)
G = sp.Matrix([1, 1])
H = a**2 / 2 + b
"""
    for target in ("a=1,b=0", "a=0,b=0"):
        _, data = check(text, target)
        assert "Actuate" not in data["verdict"]["explanation"]


def test_a_tank_is_looked_at_where_it_holds_water(check):
    text = """
import sympy as sp
h, w = x = sp.symbols("h w", real=True)
J = sp.zeros(2, 2)
R = sp.Matrix([[sp.sqrt(h) - sp.sqrt(h) / (2 + w**2), 0], [0, 1]])
G = sp.Matrix([1, 0])
H = h**2 / 2 + w**2 / 2
"""
    code, data = check(text, "h=1,w=0", "--method=interconnection")
    assert (code, data["verdict"]["reason"]) == (3, "invisible_gradient")
    assert any("h > 0" in note for note in data["notes"])
    # the user's own domain is binding
    assert error(check(text + "domain = {h: (-1, 2), w: (-1, 1)}\n", "h=1,w=0"))[0] == "singular"


@pytest.mark.parametrize(
    ("more", "target", "code"),
    [
        ('k = sp.Symbol("k"); params = {k: None}; H = k * H', "q=1,p=0", "param"),
        ('k = sp.Symbol("k"); params = {k: "x y"}; H = k * H', "q=1,p=0", "param"),
        ("H = p**2 / 2 + sp.log(q - 3)", "q=1,p=0", "singular"),
        ("H = p**2 / 2 + sp.sqrt(q)", "q=-1,p=0", "singular"),
        ("H = p**2 / 2 + sp.sqrt(q)", "q=0,p=0", "singular"),
        ("H = p**2 / 2 + 1 / q", "q=0,p=0", "singular"),
        ("H = p**2 / 2 + sp.asin(q)", "q=2,p=0", "singular"),
    ],
)
def test_a_fault_has_the_code_of_the_contract(check, more, target, code):
    assert error(check(STATES + more + "\n", target))[0] == code


def test_many_wells(check):
    text = STATES + (
        "R = sp.diag(0, q**2 / 10)\nG = sp.Matrix([0, 2 + sp.cos(q)])\n"
        "H = p**2 / (2 * (1 + q**2 / 4)) + sp.cos(3 * q) / 2\n"
        "domain = {q: (-3, 3), p: (-3, 3)}\nu_limits = [(-4, 4)]\n"
    )
    assert reason(check(text, "1/2")) == (0, "ok")
