"""What a run found, as a page of plain text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.lagrangian import integral_obstacle
from necc_casadi.report.asked import asked_text, missed
from necc_casadi.report.compared import comparison, error_lines
from necc_casadi.report.findings import Findings, attracts, global_claim, held_claim, region_claim
from necc_casadi.report.methods import method_rows
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.floats import to_float
from necc_casadi.verdict.verdict import Verdict

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.certificate.claims.claim import Claim
    from necc_casadi.choice.judged import Judged
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.measures import Measures
    from necc_casadi.designs.outcome import Residual
    from necc_casadi.export.sampled_loop import SampledLoop
    from necc_casadi.performance.measure import Performance

__all__ = [
    "brief",
    "facts",
    "headline",
    "in_short",
    "mark",
    "percent",
    "rounded_down",
    "summary",
    "target_text",
]


#: Constants with more letters than this are said in decimals alone.
_LONG_CONSTANT = 24


#: Columns of a page, of the labels, and of the labels inside a block.
_WIDTH, _INDENT, _SUB = 98, 14, 11


#: Numbers below this power of ten are written without one.
_PLAIN = 6


#: A space at which no line is broken.
_TIE = "\N{NO-BREAK SPACE}"


#: Where ξ starts, in words.
_BEGINS = {
    "target": "ξ*",
    "linear": "ξ* + T(x(0) − x*)",
    "minimum": "the minimum of V(x(0), ·)",
}


#: What is offered against errors at rest.
_INTEGRAL = (
    "with --integral neither a constant disturbance of u nor wrong inertia, potential or friction "
    "displaces it"
)


#: Claims that no exit code rests on.
_OPTIONAL_CLAIMS = ("global", "everywhere", "members", "input_limits", "clipping", "momenta")


#: Lists of more states than this are shortened in the text, never in the JSON.
_MANY = 12


#: Coordinates of z̄ smaller than this share of their size are shown as 0.
_NOTHING = 1e-20


def summary(found: Findings, width: int = _WIDTH, *, verbose: bool = False) -> str:
    """What was found, proved and written, in lines of so many columns.

    About ten lines; verbose, a page with every claim.
    """
    rows = [*facts(found), *_of_the_run(found)] if verbose else brief(found)
    wrapped = [_wrapped(label, text, width) for label, text in rows]
    return "\n".join([_headline(headline(found), width), "", *wrapped])


def headline(found: Findings) -> str:
    """The plant and the outcome; what is wrong comes first."""
    return f"{found.system.name}: {_outcome(found)}"


def in_short(found: Findings) -> str:
    """The same without the words of warnings: how many there are."""
    count = len(found.warnings)
    if found.status != "certified" or not count:
        return headline(found)
    return f"{found.system.name}: certified, with {count} warning{'s' if count > 1 else ''}"


def facts(found: Findings) -> list[tuple[str, str]]:
    """What was found and proved, as labels and texts; a function of the input alone."""
    published = found.found.published
    rows = [("target", _target(found))]
    if published is not None:
        rows.append(("Casimirs", _casimirs(published.casimirs)))
        rows.append(("verdict", _verdict_text(published.verdict)))
    rows += method_rows(found)
    if found.design is not None and found.measures is not None:
        rows.append(("sizes", _sizes(found.design)))
        rows += _design_rows(found.design, found.measures, found.certificate)
    if found.design is not None and found.design.learned is not None:
        rows.append(("learned", _learned(found.design.learned)))
    if found.choice is not None and found.choice.was_made:
        rows.append(("choice", found.choice.reason))
    rows += _asked_rows(found)
    if found.performance is not None:
        rows += _compared_rows(found, found.performance)
    if found.responses:
        rows.append(("responses", _responses(found)))
    if found.choice is not None:
        rows.append(("starts", _starts(found.choice.kept)))
    if found.sampling is not None:
        rows.append(("sampled", _sampled(found.sampling, found.certificate)))
    if found.certificate is not None:
        rows += family_rows(found) + integral_rows(found) + plants_rows(found)
        rows += _region_rows(found, found.certificate)
        rows += [
            (mark(claim), f"{claim.name}: {claim.statement}") for claim in found.certificate.claims
        ]
    return rows + [("note", note) for note in found.notes]


def mark(claim: Claim) -> str:
    """What became of a claim, in a word or two."""
    if claim.holds:
        return "proved"
    return "open" if claim.name in _OPTIONAL_CLAIMS else "NOT proved"


def _of_the_run(found: Findings) -> list[tuple[str, str]]:
    """What was written, and how long it took."""
    rows = [("written", ", ".join(found.files))] if found.files else []
    if found.timings:
        rows.append(("seconds", ", ".join(f"{k} {v:.2g}" for k, v in found.timings.items())))
    return rows


def brief(found: Findings) -> list[tuple[str, str]]:
    """A few rows: what a user looks at first, and everything that is wrong or missing."""
    certificate = found.certificate
    rows = [("target", _target(found))]
    published = found.found.published
    if published is not None:
        rows.append(("Casimirs", _casimirs(published.casimirs)))
        rows.append(("verdict", _verdict_text(published.verdict)))
    rows += method_rows(found)
    if found.design is not None and found.measures is not None:
        rows.append(("design", _brief_design(found, found.measures)))
        if found.design.learned is not None:
            rows.append(("learned", _learned(found.design.learned)))
    rows += _asked_rows(found)
    if found.performance is not None:
        rows += _compared_rows(found, found.performance)
    if found.responses:
        rows.append(("responses", _responses(found)))
    if found.sampling is not None:
        rows.append(("sampled", _sampled(found.sampling, certificate)))
    if certificate is not None:
        rows += family_rows(found) + integral_rows(found) + plants_rows(found)
        rows += [] if integral_rows(found) else _region_rows(found, certificate)[:2]
        proved = [claim.name for claim in certificate.claims if claim.holds]
        rows.append(("proved", ", ".join(proved) or "nothing"))
        rows += [
            (mark(claim), f"{claim.name}: {claim.statement}")
            for claim in certificate.claims
            if mark(claim) == "NOT proved"
        ]
    rows += [("note", note) for note in found.notes]
    return rows + ([("written", _folders(found.files))] if found.files else [])


def family_rows(found: Findings) -> list[tuple[str, str]]:
    """How far from the set-point every member of the family rests; none without a proof."""
    if found.family is None:
        return []
    from necc_casadi.certificate.claims.family import proved_share

    names = ", ".join(p.name for p in found.family.parameters)
    everywhere, near = (held_claim(found.certificate, name) for name in ("everywhere", "family"))
    rows = []
    if near is not None:
        share = proved_share(near.data)
        part = "" if share == 1 else f", proved on {100 * share:.3g} % of the ranges"
        rows.append(f"{names}: {_at_rest(found, near.data['error'])}{part}")
    elif everywhere is not None:
        sides = {name: (-most, most) for name, most in everywhere.data["error"].items()}
        rows.append(f"{names}: {_at_rest(found, sides)}")
    if everywhere is not None and attracts(everywhere):
        rows.append(f"{names}: from everywhere every solution converges to its place at rest")
    return [("family", row) for row in rows]


def _at_rest(found: Findings, error: Mapping[str, Sequence[float]]) -> str:
    """The errors of the plant's states, outward."""
    from necc_casadi.certificate.claims.family import off_target, outward

    sides = {name: (lo, hi) for name, (lo, hi) in error.items()}
    natural = {} if found.family is None else found.family.state_units
    moving, units = off_target(sides, natural), found.system.units
    if not moving:
        return "no error at rest but rounding"
    shown = {name: " … ".join(outward(sides[name])) for name in moving}
    parts = [f"{name} {side} {units.get(name, '')}".rstrip() for name, side in shown.items()]
    return f"error at rest {', '.join(parts)}"


def plants_rows(found: Findings) -> list[tuple[str, str]]:
    """Plants of the ranges that are proved, simulated; none without a proof."""
    if found.beside is None:
        return []
    from necc_casadi.report.beside import proved_and_sampled

    plant = found.finished[0].loop.plant
    text = proved_and_sampled(found.beside, plant.states, plant.units)
    return [("plants", f"{text} (simulated)")]


def integral_rows(found: Findings) -> list[tuple[str, str]]:
    """Integral action, and what is proved of it; none without."""
    design, certificate = found.design, found.certificate
    if design is None or design.integral is None or certificate is None:
        return []
    integral = design.integral
    gains, limits = (", ".join(f"{v:.4g}" for v in a) for a in (integral.gain, integral.limit))
    head = f"τ = {integral.tau:.4g} s, Kᵢ = {gains}, |ζ| ≤ {limits}"
    claim = next((c for c in certificate.claims if c.name == "integral" and c.holds), None)
    if any(c.name == "local_integral" and c.holds for c in certificate.claims):
        return [("integral", f"{head}; no offset from near enough (local: no region is proved)")]
    if claim is None:
        return [("integral", f"{head}; nothing is proved of it")]
    level = rounded_down(claim.data["level"] * design.units.energy, 4)
    return [("integral", f"{head}; no offset from W ≤ {level} in the box that is proved")]


def _brief_design(found: Findings, measures: Measures) -> str:
    kept = found.choice.kept.name if found.choice is not None and found.choice.was_made else None
    return (
        f"loss ε = {measures.loss:.2g}; ‖z̄ − z*‖ = {measures.distance:.2g}; spectral abscissa "
        f"{measures.spectrum[0].real:.4g} 1/s" + (f"; kept: {kept}" if kept else "")
    )


def _folders(files: Sequence[str]) -> str:
    """Files at the top by name, those below by their folder."""
    tops = dict.fromkeys(f"{PurePosixPath(f).parts[0]}/" if "/" in f else f for f in files)
    return ", ".join(tops) + "   (-v: every claim, file and time)"


def _asked_rows(found: Findings) -> list[tuple[str, str]]:
    if found.asked is None:
        return []
    return [("asked" if found.asked.met else "NOT met", asked_text(found.asked))]


def _headline(text: str, width: int) -> str:
    return textwrap.fill(
        text, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def _wrapped(label: str, text: str, width: int) -> str:
    return textwrap.fill(
        text,
        width=width,
        initial_indent=f"  {label:<{_INDENT - 2}}",
        subsequent_indent=" " * (_INDENT if label else _INDENT + _SUB),
        break_long_words=False,
        break_on_hyphens=False,
    ).replace(_TIE, " ")


def _tied(text: str) -> str:
    """A text that is not broken across lines."""
    return text.replace(" ", _TIE)


def _outcome(found: Findings) -> str:
    """The outcome; what is wrong comes first."""
    certificate = found.certificate
    if found.status == "certified" and certificate is not None:
        kind = _kind(certificate)
        if found.design is not None and found.design.integral is not None:
            near = any(c.name == "local_integral" and c.holds for c in certificate.claims)
            place = "near the target (local)" if near else "in a proved box"
            kind = f"without offset under constant disturbances, {place}"
        if not found.warnings:
            return f"certified, {kind}"
        whole = found.choice is not None and found.choice.kept.whole
        where = "as long as no input is clipped" if whole else "in the proved region alone"
        return f"{'; '.join(found.warnings)}; certified, {kind} {where}"
    if found.status == "fell_short" and found.asked is not None and not found.asked.met:
        return f"fell short: {missed(found.asked)}"
    proved = certificate is not None and certificate.certified
    short = [*found.faults, *(() if proved and found.faults else ("not every claim is proved",))]
    return {
        "assignable": "the target is assignable",
        "refused": _refusal(found),
        "undecided": "undecided",
        "fell_short": "; ".join([f"fell short: {short[0]}", *short[1:], *found.warnings]),
    }[found.status]


def _refusal(found: Findings) -> str:
    """What of a refusal is proved."""
    if found.no_family is not None:
        return "refused, with proof, for a part of the family"
    published, refusals = found.found.published, found.found.refusals
    nowhere = published is not None and published.verdict.reason == "not_an_equilibrium"
    if nowhere or all(refusal.proved for refusal in refusals):
        return "refused, with proof"
    return "the published loop is refused, with proof; no other that holds the target was found"


def _compared_rows(found: Findings, performance: Performance) -> list[tuple[str, str]]:
    """The table, unbroken, and what rests elsewhere."""
    first, *lines = comparison(performance, found.system)
    rows = [("compared", _tied(first)), *(("", _tied(line)) for line in lines)]
    rows += [("", line) for line in error_lines(performance, found.system)]
    return rows + ([("", _INTEGRAL)] if _takes_integral(found.design) else [])


def _takes_integral(design: Design | None) -> bool:
    """Whether integral action is offered for a design that has none."""
    if design is None or design.integral is not None:
        return False
    functions, is_sum = design.casimirs.functions, design.form.phi is None
    return integral_obstacle(design.loop, functions, is_sum) is None


def target_text(found: Findings) -> str:
    """The target on one line, without units."""
    plain = [f"{s} = {_short(found.x_star[s])}" for s in found.system.x[:_MANY]]
    return ", ".join(plain) + (", …" if found.system.n > _MANY else "")


def _short(value: sp.Expr) -> str:
    """A number exactly, unless that is as long as a float's ratio."""
    exactly = str(sp.sstr(value))
    return exactly if len(exactly) <= _LONG_CONSTANT else f"{to_float(value):.6g}"


def _target(found: Findings) -> str:
    parts = []
    many = found.system.n > _MANY
    for symbol in found.system.x:
        value = found.x_star[symbol]
        if many and value == 0:
            continue
        unit = found.system.units.get(str(symbol), "")
        parts.append(_tied(f"{symbol} {_constant(value)} {unit}".rstrip()))
    if many:
        return f"{', '.join(parts[:_MANY])}{', …' if len(parts) > _MANY else ''}; zeros not listed"
    return ", ".join(parts)


def _constant(value: sp.Expr) -> str:
    """A constant, exact where that is short, and its decimals."""
    exact, decimal = sp.sstr(value), f"{to_float(value):.6g}"
    if value.is_Integer:
        return f"= {exact}"
    return f"= {exact} = {decimal}" if len(exact) <= _LONG_CONSTANT else f"≈ {decimal}"


def _sizes(design: Design) -> str:
    """What a large value of each state and input is taken to be."""
    units = design.loop.plant.units
    parts = [
        _tied(f"{name} {size:.2g} {units.get(name, '')}".rstrip())
        for name, size in design.named_sizes.items()
    ]
    shown = parts if len(parts) <= _MANY else [*parts[: _MANY // 2], "…", parts[-1]]
    return ", ".join(shown)


def _casimirs(casimirs: Casimirs) -> str:
    listed = "; ".join(to_text(c) for c in casimirs.functions) or "none"
    if casimirs.undecided is not None:
        return f"{listed}   (not sought)"
    return (
        f"{listed}   ({len(casimirs.functions)} found of {casimirs.generic_count} that exist; "
        f"kernel rank {casimirs.kernel_rank})"
    )


def _kind(certificate: Certificate) -> str:
    """The stability that is proved."""
    if certificate.stability != "asymptotic":
        return "only stable"
    rate = " (at no proved rate)" if certificate.attracts_at_no_rate else ""
    return f"asymptotically stable{rate}"


def _verdict_text(verdict: Verdict) -> str:
    ceiling = "no ceiling on a" if verdict.a_max is None else f"a_max = {verdict.a_max:.4g}"
    if verdict.assignable:
        parts = [f"assignable; {ceiling}"]
        if verdict.stability:
            parts.append(f"best stability class: {verdict.stability}")
        if verdict.witness:
            parts.append(verdict.witness)
        return "; ".join(parts)
    return f"{verdict.reason}: {verdict.explanation}"


def _design_rows(
    design: Design, measures: Measures, certificate: Certificate | None
) -> list[tuple[str, str]]:
    names = design.loop.controller.states
    xi = ", ".join(f"{n}* = {v:.6g}" for n, v in zip(names, design.xi_star, strict=True))
    best = min(design.starts, key=lambda s: s.loss)
    starts = f" in the best of {len(design.starts)} starts" if len(design.starts) > 1 else ""
    paper = measures.bound_paper
    rigorous = None if certificate is None else certificate.bound_rigorous
    bounds = (
        f"ε/(a − ε) = {paper:.2g}" if paper is not None else "ε/(a − ε) is no bound (ε ≥ a)"
    ) + (f", proved ≤ {rigorous:.2g}" if rigorous is not None else ", no proved bound")
    shown = zip(design.z_bar[:_MANY], _NOTHING * design.sizes.state, strict=False)
    z_bar = ", ".join(f"{v:.6g}" if abs(v) > nothing else "0" for v, nothing in shown)
    z_bar += ", …" if len(design.z_bar) > _MANY else ""
    begins = _BEGINS[design.initial_xi]
    return [
        (
            "design",
            f"{xi}; ξ(0) = {begins}; loss ε = {measures.loss:.2g} at a = {design.a:.4g}; IPOPT: "
            f"{best.explained.meaning}, {best.iterations} iterations{starts}",
        ),
        ("minimum", f"z̄ = ({z_bar}); ‖z̄ − z*‖ = {measures.distance:.2g}; {bounds}"),
        (
            "loop",
            f"{_damping(design)}; spectral abscissa {design.abscissa:.4g} 1/s; least eigenvalue of "
            f"∇²V(z̄) {measures.curvatures[0]:.4g}",
        ),
    ]


def _sampled(sampling: SampledLoop, certificate: Certificate | None) -> str:
    limit = (
        "no largest stable sample time was found"
        if sampling.largest_stable is None
        else f"stable up to {sampling.largest_stable:.3g} s"
    )
    local = (
        f"at {sampling.sample_time:g} s the sampled loop has spectral radius "
        f"{sampling.spectral_radius:.4f} at z̄; {limit} (linearised, near z̄ only)"
    )
    region = None if certificate is None else certificate.sampled
    if certificate is None or region is None:
        return f"{local}; from no region it is proved to converge"
    units = certificate.units
    return (
        f"proved to converge from a region for all periods up to {region.period * units.time:.4g} "
        f"s; {local}"
    )


def _learned(residual: Residual) -> str:
    return (
        "the Casimir is a network and holds only approximately: on "
        f"{residual.points} points that it was not trained on, ‖∇Cᵀ(Jcl − Rcl)‖ relative to "
        f"‖∇C‖‖Jcl − Rcl‖ is {residual.mean:.2g} on average, {residual.worst:.2g} at worst; "
        "no decrease of V follows, so nothing is certified"
    )


def _damping(design: Design) -> str:
    m = len(design.D)
    if design.damping[:m, m:].any() or design.damping[m:, :m].any():
        return f"damping {_matrix(design.damping)}"
    return f"D = {_matrix(design.D)}, Dc = {_matrix(design.Dc)}"


def _matrix(D: np.ndarray) -> str:
    diagonal = np.diag(np.diag(D))
    if np.array_equal(D, diagonal):
        values = [f"{v:.4g}" for v in np.diag(D)]
        return values[0] if len(values) == 1 else f"diag({', '.join(values)})"
    rows = (", ".join(f"{v:.4g}" for v in row) for row in D)
    return f"[{'; '.join(rows)}]"


def _responses(found: Findings) -> str:
    settled = [r for r in found.responses if r.converged]
    text = f"{len(settled)} of {len(found.responses)} random starts settle within 2 %"
    certificate = found.certificate
    if certificate is not None and certificate.attracts_at_no_rate:
        text += f" in {found.responses[0].t[-1]:.3g} s"
    if settled:
        slowest = max(r.settling_time for r in settled)
        text += f", the slowest in {slowest:.3g} s"
    peak = max(r.peak_input for r in found.responses)
    limited = sum(r.saturated for r in found.responses)
    text += f"; peak |u| {peak:.3g}" + (f", at a limit in {limited}" if limited else "")
    return f"{text} (simulated)"


def _starts(kept: Judged) -> str:
    """What becomes of starts that fill the domain, with inputs that are clipped to their limits."""
    response = kept.response
    text = f"{kept.arrivals} of {len(response.arrived)} that fill the domain arrive"
    if kept.certificate.stability != "asymptotic":
        return f"{len(response.arrived)} that fill the domain: none need arrive"
    limited = kept.design.loop.plant.u_limits is not None
    clipped = ", inputs clipped to their limits" if limited else ""
    dear = "" if kept.cost_to_lqr is None else f"; cost {kept.cost_to_lqr:.3g} × LQR"
    unknown = len(response.arrived) - kept.arrivals - len(response.strayed)
    way = (
        f", {unknown} {'was' if unknown == 1 else 'were'} not followed to an end" if unknown else ""
    )
    return f"{text}{clipped}{way}{dear} (simulated)"


def _region_rows(found: Findings, certificate: Certificate) -> list[tuple[str, str]]:
    """The proved region beside what was sampled and simulated."""
    rows = _regions(found, certificate)
    if found.design is None or found.design.integral is None:
        return rows
    return [(label, f"with ζ = 0: {text}") for label, text in rows[:1]]


def _regions(found: Findings, certificate: Certificate) -> list[tuple[str, str]]:
    claim, whole = region_claim(certificate), global_claim(certificate)
    proved = claim is not None and claim.holds
    if whole is not None and whole.holds:
        what = "converges to z̄" if attracts(whole) else "is bounded, z̄ V's only critical point"
        head = f"the whole space is proved: every solution {what}"
        return _block(head, _ends(found, certificate) if proved else [])
    if claim is None or not proved:
        where = "of the domain, momenta at rest,"
        return [] if claim is None else _block("none is proved", _simulated(found, where))
    what = "every solution converges" if attracts(claim) else "solutions stay in it"
    height = rounded_down(certificate.level_above_minimum or 0.0, 4)
    head = f"Ω = {{V − V(z̄) ≤ {height}}} around z̄: {what}"
    rows = _ends(found, certificate)
    if found.domain_share is not None:
        sampled = f"{100 * found.domain_share:.3g} % of the domain, momenta at rest, is in it"
        rows.append(("sampled", sampled))
    return _block(head, rows + _simulated(found, "of the domain, momenta at rest,"))


def _ends(found: Findings, certificate: Certificate) -> list[tuple[str, str]]:
    """What the region stays below, and how far it reaches."""
    rows, share = [("limited by", certificate.limited_by or "")], certificate.obstacle_share
    if share is not None:
        rows.append(("proved", f"up to {percent(share, 3)} of that height"))
    reach = _reach(found, certificate)
    return rows + ([("reach", reach)] if reach else [])


def _simulated(found: Findings, where: str) -> list[tuple[str, str]]:
    """The simulated share; where nothing is to converge there is none."""
    if found.certificate is None or found.certificate.stability != "asymptotic":
        return []
    if found.simulated_share is None:
        return [("simulated", "not known: some random states take too long")]
    return [("simulated", f"{100 * found.simulated_share:.3g} % of random states {where} converge")]


def _block(head: str, rows: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Rows of a label and a text under one heading."""
    return [("region", head), *(("", f"{label:<{_SUB}}{text}") for label, text in rows)]


def _reach(found: Findings, certificate: Certificate) -> str:
    """Between which values every state stays on Ω."""
    units, reach = found.system.units, certificate.reach or {}
    parts = [
        _tied(f"{name} any" if side is None else _side(name, side, units.get(name, "")))
        for name, side in reach.items()
    ]
    more = ["…"] if len(parts) > _MANY else []
    return ", ".join(parts[:_MANY] + more)


def _side(name: str, side: tuple[float, float], unit: str) -> str:
    return f"{name} {side[0]:.3g} … {side[1]:.3g} {unit}".rstrip()


def percent(share: float, digits: int = 2) -> str:
    """A lower bound of a share, in percent."""
    return f"{rounded_down(100 * share, digits)} %"


def rounded_down(value: float, digits: int = 2) -> str:
    """A lower bound in few digits, rounded down so that it stays one."""
    if not value > 0:
        return "0"
    exponent = math.floor(math.log10(value))
    unit = 10.0 ** (exponent - digits + 1)
    plain = max(digits, exponent + 1) if exponent < _PLAIN else digits  # 100, not 1e+02
    return f"{math.floor(value / unit * (1 + 1e-12)) * unit:.{plain}g}"
