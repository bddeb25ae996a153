"""The printed page: what it says of the region, and that it fits the terminal."""

import math
import re
from dataclasses import replace

import pytest
from helpers.findings import with_claim
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.report.findings import attracts, region_claim
from necc_casadi.report.to_text import rounded_down, summary


def block(found, width=98) -> list[str]:
    """The rows under ``region``."""
    lines = summary(found, width).splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("  region "))
    end = next(k for k in range(start + 1, len(lines)) if re.match(r"  \S", lines[k]))
    return [line.strip() for line in lines[start:end]]


def test_the_proved_share_stands_beside_the_simulated_one(found):
    head, *rows = block(found)
    assert f"V ≤ {found.certificate.level:.6g}" in head
    assert "every solution converges" in head
    assert found.certificate.limited_by.split(",")[0] in head
    proved, simulated = (next(r for r in rows if r.startswith(w)) for w in ("proved", "simulated"))
    share = float(re.search(r"≥ (\S+) %", proved)[1]) / 100
    assert found.certificate.domain_share * 0.95 <= share <= found.certificate.domain_share
    assert "99.5 %" in simulated
    assert rows.index(simulated) == rows.index(proved) + 1


def test_what_the_certificate_knows_of_the_region_is_shown(found):
    data = {"domain_share": 1.234e-7, "slice_share": 0.5, "plant_share": 0.999, "volume": 2.39,
            "reach_q": 0.1299, "reach_xi1": 0.08}  # fmt: skip
    text = "\n".join(block(with_claim(found, data=data)))
    for piece in ("≥ 1.2e-05 %", "≥ 50 %", "≥ 99 %", "≥ 2.3", "q ± 0.12 rad", "xi1 ± 0.08"):
        assert piece in text
    bare = "\n".join(block(with_claim(found, data={"domain_share": 0.25})))
    assert "≥ 25 %" in bare
    assert not re.search("slice|plant|volume|reach", bare)


def test_an_invariant_region_is_not_called_one_of_attraction(found):
    weaker = dict(region_claim(found.certificate).data) | {"follows": "invariant"}
    head = block(with_claim(found, data=weaker))[0]
    assert "solutions stay in it" in head
    assert "converge" not in head
    assert attracts(region_claim(found.certificate))
    assert not attracts(replace(region_claim(found.certificate), holds=False))


def test_no_region_is_said_so(found):
    rows = block(with_claim(found, holds=False, data={}))
    assert rows[0].endswith("none is proved")
    assert "99.5 % of random states of the domain" in rows[1]


def test_a_global_proof_is_the_region(found):
    """What fits into the domain is then the smaller statement, or missing."""
    whole = replace(found.certificate, is_global=True)
    head, domain, *rest = block(replace(found, certificate=whole))
    assert "the whole space" in head
    assert "30 % of it" in domain
    assert not rest
    claims = tuple(claim for claim in whole.claims if claim.name != "region")
    bare = replace(found, certificate=replace(whole, claims=claims, level=None))
    assert block(bare) == [head]
    empty = with_claim(replace(found, certificate=whole), data={"domain_share": 0.0})
    assert block(empty) == [head]


def test_convergence_is_not_measured_where_nothing_is_to_converge(found):
    only_stable = replace(found, certificate=replace(found.certificate, stability="stable"))
    assert "simulated" not in "\n".join(block(only_stable))
    assert "not known" in "\n".join(block(replace(found, simulated_share=None)))


@pytest.mark.parametrize("width", [60, 80, 98])
def test_the_page_fits_the_terminal(found, width):
    data = {f"reach_{name}": 0.123 for name in found.loop.states} | {"domain_share": 0.1}
    page = summary(with_claim(found, data=data), width)
    assert max(map(len, page.splitlines())) <= width
    assert "\N{NO-BREAK SPACE}" not in page
    assert "p ± 0.12 kg m²/s" in page  # not torn apart


@given(st.floats(1e-300, 1e300), st.integers(1, 6))
def test_lower_bounds_are_rounded_down(value, digits):
    shown = float(rounded_down(value, digits))
    assert shown <= value * (1 + 1e-11)
    assert shown >= value * (1 - 10.0 ** (1 - digits)) or math.isclose(shown, value)


def test_bounds_read_like_numbers():
    written = {v: rounded_down(v) for v in (1e-9, 0.0129, 0.5, 1.0, 31.46, 100.0, 1299.0, 0.0)}
    assert list(written.values()) == ["1e-09", "0.012", "0.5", "1", "31", "100", "1200", "0"]
