"""What a run found, as a page of plain text."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.lagrangian import integral_obstacle
from necc_casadi.report.asked import asked_text, missed
from necc_casadi.report.compared import comparison, error_lines
from necc_casadi.report.design_rows import (
    design_rows,
    learned_text,
    responses_text,
    sampled_text,
    sizes_text,
    starts_text,
)
from necc_casadi.report.family_rows import family_rows, integral_rows, plants_rows
from necc_casadi.report.findings import Findings
from necc_casadi.report.methods import method_rows
from necc_casadi.report.region_rows import region_rows
from necc_casadi.report.values import (
    MANY,
    SUB,
    TIE,
    constant_text,
    short_text,
    tied,
)
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.verdict.verdict import Verdict

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.certificate.claims.claim import Claim
    from necc_casadi.designs.design import Design
    from necc_casadi.designs.measures import Measures
    from necc_casadi.performance.measure import Performance

__all__ = ["brief", "facts", "headline", "in_short", "mark", "summary", "target_text"]


#: Columns of a page, and of the labels.
_WIDTH, _INDENT = 98, 14


#: What is offered against errors at rest.
_INTEGRAL = (
    "with --integral neither a constant disturbance of u nor wrong inertia, potential or friction "
    "displaces it"
)


#: Claims that no exit code rests on.
_OPTIONAL_CLAIMS = ("global", "everywhere", "members", "input_limits", "clipping", "momenta")


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
        rows.append(("sizes", sizes_text(found.design)))
        rows += design_rows(found.design, found.measures, found.certificate)
    if found.design is not None and found.design.learned is not None:
        rows.append(("learned", learned_text(found.design.learned)))
    if found.choice is not None and found.choice.was_made:
        rows.append(("choice", found.choice.reason))
    rows += _asked_rows(found)
    if found.performance is not None:
        rows += _compared_rows(found, found.performance)
    if found.responses:
        rows.append(("responses", responses_text(found)))
    if found.choice is not None:
        rows.append(("starts", starts_text(found.choice.kept)))
    if found.design is not None and found.sampling is not None:
        sampled = sampled_text(found.design, found.sampling, found.certificate)
        rows.append(("sampled", sampled))
    if found.certificate is not None:
        rows += family_rows(found) + integral_rows(found) + plants_rows(found)
        rows += region_rows(found, found.certificate)
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
            rows.append(("learned", learned_text(found.design.learned)))
    rows += _asked_rows(found)
    if found.performance is not None:
        rows += _compared_rows(found, found.performance)
    if found.responses:
        rows.append(("responses", responses_text(found)))
    if found.design is not None and found.sampling is not None:
        sampled = sampled_text(found.design, found.sampling, certificate)
        rows.append(("sampled", sampled))
    if certificate is not None:
        rows += family_rows(found) + integral_rows(found) + plants_rows(found)
        rows += [] if integral_rows(found) else region_rows(found, certificate)[:2]
        proved = [claim.name for claim in certificate.claims if claim.holds]
        rows.append(("proved", ", ".join(proved) or "nothing"))
        rows += [
            (mark(claim), f"{claim.name}: {claim.statement}")
            for claim in certificate.claims
            if mark(claim) == "NOT proved"
        ]
    rows += [("note", note) for note in found.notes]
    return rows + ([("written", _folders(found.files))] if found.files else [])


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
        subsequent_indent=" " * (_INDENT if label else _INDENT + SUB),
        break_long_words=False,
        break_on_hyphens=False,
    ).replace(TIE, " ")


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
    rows = [("compared", tied(first)), *(("", tied(line)) for line in lines)]
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
    plain = [f"{s} = {short_text(found.x_star[s])}" for s in found.system.x[:MANY]]
    return ", ".join(plain) + (", …" if found.system.n > MANY else "")


def _target(found: Findings) -> str:
    parts = []
    many = found.system.n > MANY
    for symbol in found.system.x:
        value = found.x_star[symbol]
        if many and value == 0:
            continue
        unit = found.system.units.get(str(symbol), "")
        parts.append(tied(f"{symbol} {constant_text(value)} {unit}".rstrip()))
    if many:
        return f"{', '.join(parts[:MANY])}{', …' if len(parts) > MANY else ''}; zeros not listed"
    return ", ".join(parts)


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
