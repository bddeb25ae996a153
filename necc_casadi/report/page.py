"""A run as one page of HTML that needs nothing else: no script, no network, no other file."""

from __future__ import annotations

import hashlib
import html
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING

import sympy as sp

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.plant import Plant
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.report import mathml
from necc_casadi.report.compared import cells, error_lines
from necc_casadi.report.findings import Findings
from necc_casadi.report.to_text import brief, facts, headline, mark

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["fragment", "report"]


#: What each figure shows.
_CAPTIONS = {
    "lyapunov": "V − V(z̄) over two states, the others at the target.",
    "responses": "Simulated responses from ten random states, inputs within their limits.",
    "region": "The proved region, its slice through the target and its shadow over all states.",
    "landscape": "The least V − V(z̄) over all states that are not shown, and what ends the region.",
    "proof": "Plants of the ranges that are proved, the corners of these first, each from a random "
    "state; the band in which every one of them is proved to rest. Simulated beside proved.",
    "step": "From one size below the target, beside LQR and the optimum. Simulated.",
    "loop": "The loop broken at the plant's input, Bode and Nyquist. Computed at z̄.",
    "sweep": "Designs for several curvatures a asked of V at the target.",
}


#: Rows of the summary that say what can be assigned, and how it is held.
_VERDICT = ("target", "Casimirs", "verdict", "method", "not held", "choice", "learned")


#: What every claim is about, unless it says otherwise.
_ABOUT = (
    "Proved means by exact algebra or by interval arithmetic with outward rounding, about the "
    "numbers stored in design.json, for the continuous-time loop of the model, where a claim does "
    "not say that it is about the sampled one; inputs are "
    "not limited unless a claim says that limits change nothing. necc-certify proves each claim "
    "again with other arithmetic."
)


#: What no claim is about.
_BEYOND = (
    "Nothing is claimed about the real plant where it differs from the model, about noise, delay "
    "or wrong measurements, nor about the sampled loop of the C code unless a claim says so. "
    "Responses, margins, costs and shares are simulated or computed, not proved."
)


#: A page may load nothing at all.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def report(found: Findings, figures: Mapping[str, Figure], command: str = "") -> str:
    """The page of a finished run: a function of the run's input alone.

    Parameters
    ----------
    found
        What the run found.
    figures
        By name, as they are to be shown.
    command
        What makes the same run again.

    Raises
    ------
    OptionError
        Where the run ended before a design.
    """
    made, certificate = found.finished
    plant = made.loop.plant
    sections = (
        ("Model", _model(found)),
        ("Verdict and method", _facts(found, _VERDICT)),
        (
            "Design",
            _lyapunov(made) + _facts(found, ("sizes", "design", "minimum", "loop", "sampled")),
        ),
        ("What is proved", _claims(certificate) + _facts(found, ("family", "plants", "region"))),
        ("How it responds", _facts(found, ("asked", "NOT met", "responses", "starts"))),
        ("Beside LQR and the optimum", _compared(found, plant)),
        ("Figures", _figures(figures)),
        ("Limits", f"<p>{html.escape(_BEYOND)}</p>" + _list(found.notes)),
        ("Made with", _made_with(made, certificate, command)),
    )
    body = "\n".join(f"<section>\n<h2>{t}</h2>\n{c}\n</section>" for t, c in sections if c)
    title = html.escape(headline(found))
    outcome = html.escape(headline(found).removeprefix(f"{plant.name}: "))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>
{_css()}</style>
</head>
<body>
<h1>{html.escape(plant.name)}</h1>
<p class="lead {_tone(found)}">{outcome}</p>
{body}
</body>
</html>
"""


def _tone(found: Findings) -> str:
    """How the outcome is coloured; its words say the same."""
    if found.status != "certified":
        return "missing"
    return "open" if found.warnings else "proved"


def fragment(found: Findings) -> str:
    """A short table for a notebook: what the summary says, and the claims."""
    lines = "".join(_fact(label, text) for label, text in brief(found) if label != "proved")
    claims = "" if found.certificate is None else _claims(found.certificate)
    return (
        f"<div><p><b>{html.escape(headline(found))}</b></p><table><tbody>{lines}</tbody></table>"
        f"{claims}</div>"
    )


def _css() -> str:
    place = resources.files(f"{__package__}.templates").joinpath("report.css")
    return place.read_text("utf-8")


# --- mathematics ---------------------------------------------------------------------------------


def _model(found: Findings) -> str:
    """The plant and the controller, with the parameters of the model file where it has any."""
    m, o = mathml, mathml.operator
    system = found.system
    parts = [
        *_plant(found),
        m.formula(m.identifier("x"), o("="), m.column([m.row(s) for s in system.x])),
    ]
    if found.parametric is not None:
        values = (
            m.row(s) + o("=") + m.row(found.parametric.values[str(s)])
            for s in found.parametric.symbols
        )
        parts.append(m.formula('<mo>,</mo><mspace width="0.6em"/>'.join(values)))
    method = found.method
    return "\n".join(parts if method is None else parts + _controller(method.loop))


def _dotted(symbols: Sequence[sp.Symbol]) -> str:
    return mathml.column(
        [f'<mover accent="true">{mathml.row(s)}<mo>˙</mo></mover>' for s in symbols]
    )


def _plant(found: Findings) -> list[str]:
    """ẋ as the model file gives it, and H where it has one."""
    m, o, system = mathml, mathml.operator, found.system
    rate, u = _dotted(system.x), m.column([m.identifier(name) for name in system.input_names])
    if not isinstance(system, Plant):
        f, g = m.matrix(sp.Matrix(system.drift)), m.matrix(sp.Matrix(system.directions))
        return [m.formula(rate, o("="), f, o("+"), g, u)]
    shown = found.parametric or system
    flow, G = m.matrix(sp.Matrix(shown.J - shown.R)), m.matrix(sp.Matrix(shown.G))
    gradient = f"<mo>∇</mo>{m.identifier('H')}"
    return [
        m.formula(rate, o("="), flow, gradient, o("+"), G, u),
        m.formula(m.identifier("H"), o("="), m.row(shown.H)),
    ]


#: ∇Hc, v and v_c.
_SLOPE = "<mo>∇</mo><msub><mi>H</mi><mi>c</mi></msub>"
_INNER = "<msub><mi>v</mi><mi>c</mi></msub>"


def _controller(loop: ClosedLoop) -> list[str]:
    """The control law, with what is fed back ahead of it."""
    m, o, ahead = mathml, mathml.operator, loop.plant.preliminary
    inputs = m.column([m.identifier(name) for name in loop.plant.input_names])
    given = inputs if ahead is None else m.identifier("w")
    law = m.formula(
        given, o("="), o("−"), m.matrix(sp.Matrix(loop.feedback)), _SLOPE, o("+"),
        m.identifier("v"),
    )  # fmt: skip
    parts = ["<p>Controller, with damping injected at both ports (v, v<sub>c</sub>):</p>"]
    if ahead is not None:
        u0, gain = m.matrix(sp.Matrix(ahead.u0)), m.matrix(sp.Matrix(ahead.gain))
        parts.append(m.formula(inputs, o("="), u0, o("+"), gain, given))
        parts.append("<p>For w the plant has another structure and the energy</p>")
        parts.append(m.formula(m.identifier("H"), o("="), m.row(loop.plant.H)))
    return [*parts, *_inner_states(loop), law]


def _inner_states(loop: ClosedLoop) -> list[str]:
    """ξ̇."""
    m, o, controller = mathml, mathml.operator, loop.controller
    rates = _dotted(controller.xi)
    if isinstance(loop, ShapedLoop):
        gamma = m.column([m.row(g) for g in loop.shaping])
        along = f"<mo>∇</mo><msup>{m.identifier('gamma')}<mi>T</mi></msup>"
        return [
            m.formula(m.identifier("gamma"), o("="), gamma),
            m.formula(rates, o("="), along, _dotted([sp.Symbol("x")]), o("+"), _INNER),
        ]
    taken = f"<msup><mi>G</mi><mi>T</mi></msup><mo>∇</mo>{m.identifier('H')}"
    return [
        m.formula(
            rates, o("="), m.matrix(sp.Matrix(controller.Jc - controller.Rc)), _SLOPE, o("+"),
            m.matrix(sp.Matrix(controller.Gc)),
            f"<mrow><mo>(</mo>{taken}<mo>+</mo>{_INNER}<mo>)</mo></mrow>",
        )
    ]  # fmt: skip


def _lyapunov(design: Design) -> str:
    """V in its form, with the Casimirs that it is made of."""
    m, o = mathml, mathml.operator
    names = [
        f"<msub><mi>c</mi><mn>{k + 1}</mn></msub>" for k in range(len(design.casimirs.functions))
    ]
    listed = "<mo>,</mo>".join(names)
    energy = "<msub><mi>H</mi><mi>c</mi></msub><mo>(</mo><mi>ξ</mi><mo>)</mo>"
    network = f"<mi>K</mi><mo>(</mo>{listed}<mo>)</mo>"
    if design.form.betas:
        network = "<mi>K</mi><mo>(</mo><mo>∑</mo>" + (
            "<msub><mi>β</mi><mi>i</mi></msub><mo>(</mo><msub><mi>c</mi><mi>i</mi></msub><mo>)</mo>"
            "<mo>)</mo>"
        )
    inside = (m.identifier("H"), o("+"), energy)
    value = [*inside, o("+"), network]
    if design.form.phi is not None:
        value = [m.identifier("Φ"), o("("), *inside, o(","), network, o(")")]
    casimirs = [
        m.formula(name, o("="), m.row(c))
        for name, c in zip(names, design.casimirs.functions, strict=False)
    ]
    return "\n".join([m.formula(m.identifier("V"), o("="), *value), *casimirs])


# --- tables --------------------------------------------------------------------------------------


def _facts(found: Findings, labels: Sequence[str]) -> str:
    """Rows of the summary by label; a row without one goes on with the row above."""
    chosen, wanted = [], False
    for label, text in facts(found):
        wanted = label in labels if label else wanted
        if wanted:
            chosen.append(_fact(label, text))
    return f'<table class="facts"><tbody>{"".join(chosen)}</tbody></table>' if chosen else ""


def _fact(label: str, text: str) -> str:
    return f'<tr><th scope="row">{html.escape(label)}</th><td>{html.escape(text)}</td></tr>\n'


def _claims(certificate: Certificate) -> str:
    lines = []
    for claim in certificate.claims:
        word = mark(claim)
        kind = {"proved": "proved", "open": "open"}.get(word, "missing")
        lines.append(
            f'<tr><th scope="row">{html.escape(claim.name)}</th><td class="{kind}">{word}</td>'
            f"<td>{html.escape(claim.statement)}</td></tr>\n"
        )
    return (
        f'<p class="faint">{html.escape(_ABOUT)}</p><table class="facts claims">'
        '<thead><tr><th scope="col">claim</th><th scope="col"></th><th scope="col">statement</th>'
        f"</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    )


def _compared(found: Findings, plant: Plant) -> str:
    if found.performance is None:
        return ""
    (corner, *heads), *lines = cells(found.performance, plant)
    top = "".join(f'<th scope="col">{html.escape(text)}</th>' for text in (corner, *heads))
    body = "".join(
        f'<tr><th scope="row">{html.escape(label)}</th>'
        + "".join(f"<td>{html.escape(text)}</td>" for text in _filled(values, len(heads)))
        + "</tr>\n"
        for label, *values in lines
    )
    table = f'<table class="numbers"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'
    return f'<div class="scroll">{table}</div>' + _list(error_lines(found.performance, plant))


def _filled(values: Sequence[str], count: int) -> list[str]:
    return [*values, *["–"] * (count - len(values))]


def _list(texts: Iterable[str]) -> str:
    items = "".join(f"<li>{html.escape(text)}</li>\n" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def _figures(figures: Mapping[str, Figure]) -> str:
    return "\n".join(_figure(name, figure) for name, figure in figures.items())


def _figure(name: str, figure: Figure) -> str:
    from necc_casadi.report.style import inline_svg  # slow to import, and not every page has some

    caption = html.escape(_CAPTIONS[name])
    drawn = inline_svg(figure, name, caption)
    shown = f'<div class="scroll">{drawn}</div>\n<figcaption>{caption}</figcaption>'
    return f"<figure>\n{shown}\n</figure>"


def _made_with(made: Design, certificate: Certificate, command: str) -> str:
    rows = [
        ("design.json", f"SHA-256 {made.hash}"),
        (
            "certificate.json",
            f"SHA-256 {hashlib.sha256(certificate.to_json().encode()).hexdigest()}",
        ),
        ("seed", str(made.seed)),
        ("versions", ", ".join(f"{name} {v}" for name, v in made.versions.items())),
    ]
    again = f"<pre>{html.escape(command)}</pre>" if command else ""
    lines = "".join(_fact(label, text) for label, text in rows)
    return f'{again}<table class="facts"><tbody>{lines}</tbody></table>'
