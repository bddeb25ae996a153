"""Axes in powers of a thousand: labels, ticks, numbers."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from necc_casadi.report.ticks import engineering, finished, power_of_ten, scaled_label


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (3e-6, "m", "3 µm"),
        (-3e-6, "m", "−3 µm"),
        (1.19e8, "kg m/s", "119·10⁶ kg m/s"),
        (2.5e7, "N", "25 MN"),
        (0.25, "rad", "0.25 rad"),
        (0.0, "V", "0 V"),
    ],
)
def test_numbers_carry_a_power_of_a_thousand(value, unit, text):
    assert engineering(value, unit) == text


def test_a_unit_without_prefix_gets_a_factor():
    assert scaled_label("p", "kg m/s", -12) == "p [10⁻¹² kg m/s]"
    assert scaled_label("q", "m", -6) == "q [µm]"
    assert scaled_label("xi1", "", 0) == "xi1"
    assert scaled_label("V", "", 9) == "V [10⁹]"


@pytest.mark.parametrize("scale", [1e-12, 3e-6, 1.0, 2e7, 5e14])
@pytest.mark.parametrize("middle", [0.0, 1.0, 1e6])
def test_ticks_times_the_factor_are_the_values(scale, middle):
    """Read back from the texts: label, ticks and offset give the place of each tick."""
    figure = Figure()
    axis = figure.add_subplot()
    axis.plot([0, 1], [middle * scale, (middle + 1) * scale])
    finished(axis, [("y", "y", "")])
    FigureCanvasAgg(figure).draw()
    label, formatter = axis.get_ylabel(), axis.yaxis.get_major_formatter()
    plain = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    exponent = label.partition("[10")[2].rstrip("]").translate(plain)
    factor = 10.0 ** int(exponent or 0)
    inner, _, added = formatter.get_offset().replace("−", "-").rpartition(" ")
    inner_factor = 10.0 ** int(inner.removeprefix("·10").translate(plain) or 0)
    offset = float(added or 0)
    for place, text in zip(axis.get_yticks(), axis.get_yticklabels(), strict=True):
        shown = float(text.get_text().replace("−", "-"))
        read = (shown * inner_factor + offset) * factor
        assert read == pytest.approx(place, abs=1e-9 * scale * max(middle, 1))
        assert len(text.get_text()) <= 7


def test_ticks_of_a_logarithmic_axis():
    assert [power_of_ten(v) for v in (1e-12, 1.0, np.float64(1e3))] == ["10⁻¹²", "10⁰", "10³"]
