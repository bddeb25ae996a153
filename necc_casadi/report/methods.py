"""How a target is held where the published loop cannot, in words and formulas."""

from __future__ import annotations

import sympy as sp

from necc_casadi.methods.method import Method
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.report.compared import parameter_lines
from necc_casadi.report.findings import Findings
from necc_casadi.report.formulas import readable

__all__ = ["method_rows"]


#: Formulas longer than this are left to the JSON.
_LONGEST = 240


def method_rows(findings: Findings) -> list[tuple[str, str]]:
    """Label and text of each line about methods other than the published loop."""
    found = findings.found
    method = found.chosen
    rows: list[tuple[str, str]] = []
    if method is not None and method.name != "interconnection":
        rows.append(("method", f"{method.name}: {_verdict(method)}"))
        rows += [("", line) for line in _formulas(method)]
        rows += [("", f"instead of {other.name}: {other.because}") for other in found.passed]
        rows += [("", line) for line in _model_errors(findings)]
    rows += [
        ("not held", f"{refusal.name}: {refusal.reason}{'' if refusal.proved else ' (no proof)'}")
        for refusal in found.refusals
    ]
    return rows


def _model_errors(findings: Findings) -> list[str]:
    """That the controller contains the model, and what wrong parameters do."""
    errors = findings.parameter_errors
    head = "the controller contains the model: errors of its parameters displace it"
    lines = parameter_lines(errors, findings.system)
    if errors and findings.performance is None:  # which shows them too
        return [f"{head}; where it rests with one of them wrong, every mode decays:", *lines]
    named = errors or findings.design is None
    return [head if named else f"{head}; where the model file has them in `params`, by how much"]


def _verdict(method: Method) -> str:
    verdict = method.verdict
    ceiling = "no ceiling on a" if verdict.a_max is None else f"a_max = {verdict.a_max:.4g}"
    best = f"; best stability class: {verdict.stability}" if verdict.stability else ""
    return f"holds the target; {ceiling}{best}"


def _formulas(method: Method) -> list[str]:
    loop = method.loop
    ahead = loop.plant.preliminary
    lines = []
    if ahead is not None:
        alone = (ahead.gain - sp.eye(ahead.gain.rows)).is_zero_matrix
        by = "w" if alone else f"{_matrix(ahead.gain)} w"
        lines.append(
            f"u {_sign(ahead.u0, ahead.gain)} {_matrix(ahead.u0)} + {by}; for w the plant has "
            f"H {_sign(loop.plant.H)} {_shown(loop.plant.H)}"
        )
    if isinstance(loop, ShapedLoop) and not any(loop.shaping):
        lines.append("damping alone: w = −D y, y = Gᵀ∇H, and what a coupled damping adds")
    elif isinstance(loop, ShapedLoop):
        gammas = ", ".join(_shown(g) for g in loop.shaping)
        alpha = f"α {_sign(loop.alpha)} {_matrix(loop.alpha)}"
        lines.append(
            f"shaping functions γ {_sign(*loop.shaping)} {gammas}; {alpha}; ξ̇ = ∇γᵀẋ + v_c"
        )
    return lines


def _matrix(matrix: sp.MatrixBase) -> str:
    rows = [", ".join(_shown(e) for e in row) for row in matrix.tolist()]
    if matrix.shape == (1, 1):
        return rows[0] if matrix[0, 0].is_Atom else f"({rows[0]})"
    return f"[{'; '.join(rows)}]"


def _sign(*values: sp.Expr | sp.MatrixBase) -> str:
    """Whether what follows is said exactly or with rounded numbers."""
    entries = (e for v in values for e in (v if isinstance(v, sp.MatrixBase) else [v]))
    return "≈" if any(readable(e)[1] for e in entries) else "="


def _shown(expr: sp.Expr) -> str:
    text = readable(expr)[0]
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
