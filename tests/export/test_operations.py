"""The counts of operations in the exported README, by the text of the code and by an emulator."""

import re
import shutil
from collections import Counter

import pytest
from helpers.export_cases import paper_design

from necc_casadi.export.controller import c_networks
from necc_casadi.export.cortex import cross_compiled, deepest_stack
from necc_casadi.export.operations import (
    ACTIVATION_COUNTS,
    count_networks,
    count_text,
    least_cycles,
    least_cycles_dual_issue,
)
from necc_casadi.export.readme import readme
from necc_casadi.export.source import Source
from necc_casadi.export.templating import fill


@pytest.mark.parametrize(("name", "real"), ACTIVATION_COUNTS)
def test_activations_have_the_operations_that_are_counted(name, real):
    """Operators of the last loop; quotients of literals and the bits of the exponent are none."""
    file = "squareplus.c" if name == "squareplus" else f"{name}_{real}.c"
    code = fill(file, sqrt="sqrtf").rsplit("for (k = 0;", 1)[1].split("{", 1)[1]
    code = re.sub(r"R\((.*?)\)", r"\1", code)
    code = re.sub(r"\d+\.\d+f? / \d+\.\d+f?", "c", code)
    code = re.sub(r"\(scale\.bits \+ \w+\)", "bits", code)
    found = count_text(re.sub(r"\s+", " ", code))
    names = ("multiplications", "additions", "divisions", "square roots")
    assert tuple(found[each] for each in names) == ACTIVATION_COUNTS[name, real]


def test_a_network_of_two_layers_by_hand():
    d = paper_design((32, 32), (64,))
    hc, k = c_networks(Source(d))
    counts = count_networks([hc], "float")
    tanh = 11 * 64
    assert counts["multiplications"] == 32 + 32 + 2 * 32 * 32 + 32 + 2 * 32 + tanh
    assert counts["additions"] == 32 + 2 * 32 * 32 + 32 + 2 * 32 + tanh
    assert counts["divisions"] == 64
    assert counts["weights"] == 64 + 33 * 32 + 33
    assert count_networks([k], "float")["divisions"] == 64
    both = counts + count_networks([k], "float")
    assert both == count_networks([hc, k], "float")


def test_the_readme_says_what_is_counted_and_that_it_is_not_measured():
    d = paper_design((32,), (64,))
    text = readme(Source(d, "float"), measured=False)
    counts = count_networks(c_networks(Source(d, "float")), "float")
    cycles = int(re.search(r"at least (\d+) cycles", text)[1])
    assert least_cycles(counts) < cycles < least_cycles(counts) + 20  # the pendulum's own terms
    assert f"{counts['divisions']} divisions" in text
    assert "not measured" in text
    assert least_cycles(Counter(divisions=2, weights=3)) == 31
    double = readme(Source(d), measured=False)
    assert "in software" in double
    assert (text.count("bound from below"), double.count("bound from below")) == (2, 1)
    arithmetic = sum(n for name, n in counts.items() if name != "weights")
    on_m7 = int(re.search(r"cycle, so that it needs at least (\d+) cycles", text)[1])
    assert arithmetic / 2 < on_m7 < arithmetic / 2 + 10
    assert "with an FPU for `double` (`fpv5-d16`) begins" in double
    assert least_cycles_dual_issue(Counter(divisions=2, additions=3, weights=9)) == 3


GRAPH = """graph: { title: "necc.c"
node: { title: "necc.c:deep" label: "deep\\nnecc.c:1:2\\n80 bytes (static)" }
node: { title: "necc.c:wide" label: "wide\\nnecc.c:3:4\\n96 bytes (static)" }
node: { title: "necc_step" label: "necc_step\\nnecc.c:5:6\\n16 bytes (static)" }
node: { title: "sinf" label: "sinf\\nmath.h:1:1" shape : ellipse }
edge: { sourcename: "necc_step" targetname: "necc.c:deep" label: "necc.c:7:8" }
edge: { sourcename: "necc_step" targetname: "necc.c:wide" }
edge: { sourcename: "necc.c:deep" targetname: "necc.c:leaf" }
node: { title: "necc.c:leaf" label: "leaf\\nnecc.c:9:9\\n24 bytes (static)" }
edge: { sourcename: "necc.c:leaf" targetname: "sinf" }
}
"""


def test_the_deepest_way_through_the_calls():
    assert deepest_stack(GRAPH, "necc_step") == 16 + 80 + 24
    assert deepest_stack(GRAPH, "necc.c:wide") == 96
    assert deepest_stack(GRAPH, "necc_output") is None


if shutil.which("arm-none-eabi-gcc"):

    def test_flash_and_stack_of_a_cross_compiler():
        small, large = (
            [int(n) for n in re.findall(r"(\d+) (?:bytes|of RAM)", cross_compiled(source))]
            for source in (
                Source(paper_design((32,), (64,)), "float"),
                Source(paper_design(), "float"),
            )
        )
        assert small[1] == large[1] == 0  # no RAM but the stack
        weights = 4 * (64 + 33 * 32 + 33 + 128 + 65 * 64 + 65)
        assert weights < large[0] < weights + 8 * 1024
        assert 256 < small[2] < large[2] < 2048
        assert small[4] == large[4] == 0
        assert weights < large[3] < weights + 8 * 1024  # an M7

    def test_numbers_in_double_take_more_room_on_an_m7():
        texts = [cross_compiled(Source(paper_design((32,), (64,)), r)) for r in ("float", "double")]
        sizes = [[int(n) for n in re.findall(r"(\d+) (?:bytes|of RAM)", t)] for t in texts]
        assert "for a Cortex-M7" in texts[1]
        assert all(
            one > 1.2 * other for one, other in zip(sizes[1][3::2], sizes[0][3::2], strict=True)
        )
