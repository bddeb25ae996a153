"""Model files in text: a sound one, and one of each fault."""

from pathlib import Path

BASE = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / 2 + 1 - sp.cos(q)
"""


#: A pendulum whose mass and gravity are parameters.
WEIGHTED = """
import sympy as sp
q, p, m, g = sp.symbols("q p m g")
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / (2 * m) + m * g * (1 - sp.cos(q))
params = {m: 1, g: 1}
"""


#: code, what is appended to a good model, a piece of the message. Also run as a process.
FAULTS = [
    ("j_not_skew", "J = sp.Matrix([[0, 2], [0, 0]])", "J[0,1] + J[1,0] = 2"),
    ("j_not_skew", "J = sp.Matrix([[q, 1], [-1, 0]])", "J[0,0]"),
    ("j_not_skew", "J = sp.Matrix([[0, q], [-sp.sin(q), 0]])", "skew-symmetric"),
    ("r_not_symmetric", "R = sp.Matrix([[0, 1], [0, 0]])", "R[0,1] = 1"),
    ("r_not_psd", "R = sp.Matrix([[0, 0], [0, -1]])", "R[1,1] = -1"),
    ("r_not_psd", "R = sp.Matrix([[1, 2], [2, 1]])", "-1"),
    ("g_rank", "G = sp.Matrix([0, 0])", "rank 0"),
    ("g_rank", "G = sp.Matrix([[0, 0], [1, 2]])", "rank 1"),
    ("jc_not_skew", 'xi = sp.symbols("a b"); Jc = [[0, 1], [0, 0]]; Gc = [1, 0]', "Jc[0,1]"),
    ("rc_not_psd", "Rc = [[-1]]", "Rc[0,0] = -1"),
    ("rc_not_psd", 'xi = sp.symbols("a b"); Rc = [[0, 1], [0, 0]]; Gc = [1, 0]', "symmetric"),
    ("gc_rank", "Gc = [[0]]", "rank 0"),
    ("shape", "J = sp.zeros(3, 3)", "3×3"),
    ("shape", "J = [[0, 1], [-1]]", "J"),
    ("shape", "J = None", "J = None"),
    ("shape", "G = sp.Matrix([0, 1, 0])", "3×1"),
    ("shape", "G = sp.zeros(2, 0)", "2×0"),
    ("shape", "Gc = [[1, 2, 3]]", "1×3"),
    ("shape", "x = ()", "empty"),
    ("shape", "x = 3", "x = 3"),
    ("shape", 'x = ("q", "p")', "not a symbol"),
    ("undefined_symbol", 'H = p**2 / 2 + sp.Symbol("k") * q', "k"),
    ("undefined_symbol", 'G = sp.Matrix([0, sp.Symbol("b")])', "b"),
    ("undefined_symbol", 'casimirs = [q - sp.Symbol("zeta")]', "zeta"),
    ("h_not_scalar", "H = sp.Matrix([p, q])", "2×1"),
    ("h_not_scalar", "H = [p, q]", "[p, q]"),
    ("h_not_scalar", "H = None", "None"),
    ("h_not_scalar", "H = True", "True"),
    ("h_not_scalar", "H = sp.Eq(p, q)", "Eq"),
    ("h_not_scalar", "H = lambda q, p: p**2", "H ="),
    ("h_constant", "H = 3", "H = 3"),
    ("not_real", "H = p**2 / 2 + sp.I * q", "I*q"),
    ("singular", "H = p**2 / 2 + q * sp.oo", "not finite"),
    ("singular", 'H = p**2 / 2 + q * float("nan")', "not finite"),
    ("non_smooth", "H = p**2 / 2 + abs(q)", "Abs(q)"),
    ("non_smooth", "H = p**2 / 2 + sp.Piecewise((q, q > 0), (0, True))", "Piecewise"),
    ("non_smooth", 'H = p**2 / 2 + sp.Function("f")(q)', "f(q)"),
    ("non_smooth", 'casimirs = [sp.Max(q - sp.Symbol("xi1"), 0)]', "Max"),
    ("casimir_disproved", "casimirs = [q]", "casimirs[0] = q"),
    ("casimir_disproved", "casimirs = [3]", "constant"),
    ("duplicate_state", "x = (q, q)", "q"),
    ("name_clash", "xi = (q,)", "q"),
    ("name_clash", "params = {q: 1}", "q"),
    ("name_clash", 'q = sp.Symbol("xi1"); x = (q, p); H = p**2 / 2 + q**2', "xi1"),
    ("param", 'k = sp.Symbol("k"); params = {k: "abc"}', "abc"),
    ("param", 'k = sp.Symbol("k"); params = {k: 1j}', "params[k]"),
    ("param", 'k = sp.Symbol("k"); params = {k: float("inf")}', "params[k]"),
    ("domain", "domain = {q: (1, 0)}", "(1, 0)"),
    ("domain", "domain = {q: (-sp.oo, sp.oo)}", "oo"),
    ("domain", 'domain = {"elsewhere": (0, 1)}', "elsewhere"),
    ("domain", "domain = {q: 3}", "3"),
    ("limits", "u_limits = [(1, -1)]", "(1, -1)"),
    ("limits", "u_limits = [(-1, 1), (-1, 1)]", "2 entries"),
    ("limits", "u_limits = (-1, 1)", "u_limits[0]"),
    ("limits", "u_limits = 3", "3"),
    ("limits", 'u_limits = [(float("nan"), 1)]', "nan"),
    ("model_file", "inputs = 3", "inputs = 3"),
    ("model_file", 'inputs = ("a", "b")', "each of 1 input(s)"),
    ("model_file", 'inputs = "u 1"', "u 1"),
    ("name_clash", 'inputs = ("q",)', "inputs names q"),
    ("model_file", "D = -1", "positive definite"),
    ("model_file", "D = [1, 2]", "1×1"),
    ("model_file", 'D = "much"', "much"),
    ("model_file", "Dc = float('inf')", "Dc"),
    ("model_file", "units = 3", "wrong kind"),
    ("model_file", "params = [1]", "wrong kind"),
    ("model_file", "1 / 0", "line 9: ZeroDivisionError"),
    ("model_file", "raise SystemExit(0)", "line 9: SystemExit"),
    ("model_file", "def f(): raise ValueError('two\\nlines')\nf()", "line 9: ValueError: two li"),
    ("model_file", "def", "line 9: invalid syntax"),
    ("model_file", "del H", "does not define H"),
    ("model_file", "del x, J", "does not define x, J"),
]  # fmt: skip


#: Faults that show only once the target is known, with the target.
FAULTS_AT_TARGET = [
    ("singular", "H = p**2 / 2 - 1 / q", "0", "q = 0"),
    ("singular", "R = sp.diag(0, 1 / q**2)", "0", "R"),
    ("singular", "H = p**2 / 2 + sp.log(q)", "-1", "q = -1"),
    ("singular", "H = p**2 / 2 + q**sp.Rational(5, 2)", "-1", "q = -1"),
    ("r_not_psd", "R = sp.diag(0, p)", "pi/4,0", "at p ="),
    ("r_not_psd", "R = sp.diag(0, sp.cos(3 * p) + sp.exp(-q**2))", "pi/4,0", "at p ="),
    ("g_rank", "G = sp.Matrix([0, q])", "0,0", "q = 0"),
]


def model(folder, text="") -> Path:
    """A model file in a folder: the base, and what overrides it."""
    path = folder / "plant.py"
    path.write_text(BASE + text + "\n", encoding="utf-8")
    return path
