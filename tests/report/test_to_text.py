"""The printed page: what it says of the region, and that it fits the terminal."""

import math
import re
from dataclasses import replace

import pytest
from helpers.findings import with_claim
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.report.findings import attracts, region_claim
from necc_casadi.report.to_text import summary
from necc_casadi.report.values import rounded_down


def block(found, width=98) -> list[str]:
    """The rows under ``region``."""
    lines = summary(found, width, verbose=True).splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("  region "))
    end = next(k for k in range(start + 1, len(lines)) if re.match(r"  \S", lines[k]))
    return [line.strip() for line in lines[start:end]]


def test_what_ends_the_region_stands_beside_its_height(found):
    head, *rows = block(found)
    certificate = found.certificate
    assert f"V − V(z̄) ≤ {rounded_down(certificate.level_above_minimum, 4)}" in head
    assert "every solution converges" in head
    text = " ".join(rows)
    assert "limited by another critical point of V at q = " in re.sub(" +", " ", text)
    share = float(re.search(r"up to (\S+) % of that height", text)[1]) / 100
    assert certificate.obstacle_share * 0.99 <= share <= certificate.obstacle_share


def test_how_far_the_region_reaches_is_shown_with_units(found):
    text = " ".join(block(found)).replace("\n", " ")
    for name, (lo, hi) in found.certificate.reach.items():
        assert f"{name} {lo:.3g} … {hi:.3g}" in text
    assert re.search(r"q \S+ … \S+ rad", text)


def test_sampled_and_simulated_shares_are_called_what_they_are(found):
    rows = block(found)
    sampled, simulated = (
        next(r for r in rows if r.startswith(word)) for word in ("sampled", "simulated")
    )
    assert "41.5 % of the domain" in sampled
    assert "99.5 %" in simulated
    assert "sampled" not in "\n".join(block(replace(found, domain_share=None)))


def test_an_invariant_region_is_not_called_one_of_attraction(found):
    head = block(with_claim(found, data={"follows": "invariant"}))[0]
    assert "solutions stay in it" in head
    assert "converge" not in head
    assert attracts(region_claim(found.certificate))
    assert not attracts(replace(region_claim(found.certificate), holds=False))


def test_no_region_is_said_so(found):
    rows = block(with_claim(found, holds=False, data={}))
    assert rows[0].endswith("none is proved")
    assert "99.5 % of random states of the domain" in rows[1]


def with_global(found, follows):
    claims = tuple(
        replace(claim, holds=True, data={"follows": follows}) if claim.name == "global" else claim
        for claim in found.certificate.claims
    )
    return replace(found, certificate=replace(found.certificate, claims=claims))


def test_the_whole_space_is_the_region(found):
    """What is claimed inside bounds stands below it, or is missing."""
    whole = with_global(found, "converges")
    head, *rows = block(whole)
    assert "the whole space is proved: every solution converges" in head
    assert rows[0].startswith("limited by")
    claims = tuple(claim for claim in whole.certificate.claims if claim.name != "region")
    bare = replace(whole, certificate=replace(whole.certificate, claims=claims, level=None))
    assert block(bare) == [head]
    weaker = block(with_global(found, "invariant"))[0]
    assert "bounded" in weaker
    assert "converges" not in weaker


def test_convergence_is_not_measured_where_nothing_is_to_converge(found):
    only_stable = replace(found, certificate=replace(found.certificate, stability="stable"))
    assert "simulated" not in "\n".join(block(only_stable))
    assert "not known" in "\n".join(block(replace(found, simulated_share=None)))


@pytest.mark.parametrize("width", [60, 80, 98])
def test_the_page_fits_the_terminal(found, width):
    page = summary(found, width, verbose=True)
    assert max(map(len, page.splitlines())) <= width
    assert "\N{NO-BREAK SPACE}" not in page
    assert re.search(r"p \S+ … \S+ kg m²/s", page)  # not torn apart


@given(st.floats(1e-300, 1e300), st.integers(1, 6))
def test_lower_bounds_are_rounded_down(value, digits):
    shown = float(rounded_down(value, digits))
    assert shown <= value * (1 + 1e-11)
    assert shown >= value * (1 - 10.0 ** (1 - digits)) or math.isclose(shown, value)


def test_bounds_read_like_numbers():
    written = {v: rounded_down(v) for v in (1e-9, 0.0129, 0.5, 1.0, 31.46, 100.0, 1299.0, 0.0)}
    assert list(written.values()) == ["1e-09", "0.012", "0.5", "1", "31", "100", "1200", "0"]
