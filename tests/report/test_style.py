"""Files of figures: the same bytes for the same figure, fonts, and room for units of any size."""

import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from necc_casadi.report.region_figure import lyapunov_figure
from necc_casadi.report.style import inline_svg, picture, styled, write_figure
from necc_casadi.report.ticks import engineering, rounded


def fresh(design):
    with styled():
        return lyapunov_figure(design)


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_the_same_figure_has_the_same_bytes(default_design, kind, monkeypatch):
    one = picture(fresh(default_design), kind)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1")
    figure = fresh(default_design)
    picture(figure, "svg")  # what was drawn before makes no difference
    assert picture(figure, kind) == one
    assert picture(fresh(default_design), kind) == one


def test_a_pdf_has_its_fonts_in_it(default_design):
    data = picture(fresh(default_design), "pdf")
    assert data.startswith(b"%PDF")
    assert b"/FontFile2" in data
    assert b"/Type0" in data
    assert b"/Type3" not in data
    assert b"CreationDate" not in data


def test_an_svg_needs_no_font_and_no_date(default_design):
    text = picture(fresh(default_design), "svg").decode()
    assert "<text" not in text
    assert "dc:date" not in text


def test_the_name_of_a_file_says_its_format(default_design, tmp_path):
    for name, begins in (("a.pdf", b"%PDF"), ("a.svg", b"<?xml"), ("a.png", b"\x89PNG")):
        path = write_figure(fresh(default_design), tmp_path / name)
        assert path.read_bytes().startswith(begins)


def test_two_pictures_of_a_page_share_no_name(default_design):
    figure = fresh(default_design)
    one, other = (set(re.findall(r'\bid="([^"]+)"', inline_svg(figure, n, n))) for n in "ab")
    assert one
    assert not one & other


def test_numbers_on_contours_are_short_and_inside(default_design):
    figure = fresh(default_design)
    axis = figure.axes[1]
    figure.draw_without_rendering()
    frame = axis.get_window_extent()
    assert axis.texts
    for text in axis.texts:
        assert re.fullmatch(r"−?\d+(\.\d+)?", text.get_text())
        box = text.get_window_extent()
        assert frame.x0 <= box.x0
        assert box.x1 <= frame.x1
        assert frame.y0 <= box.y0
        assert box.y1 <= frame.y1


def shown_ticks(axis):
    """Texts of the ticks that are in sight."""
    for side in ("x", "y"):
        low, high = getattr(axis, f"get_{side}lim")()
        places, texts = (getattr(axis, f"get_{side}{what}")() for what in ("ticks", "ticklabels"))
        yield from (text for place, text in zip(places, texts, strict=True) if low <= place <= high)


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1.0, 1e6])
def test_texts_do_not_meet_whatever_the_units(unit):
    """Panels of responses in large and small numbers: no label on another."""
    from necc_casadi.report.ticks import finished, panels

    with styled():
        figure = panels(2, 3, (2.8, 1.75))
        for axis in figure.subplots(2, 3).ravel():
            axis.plot(np.linspace(0, 3e3, 9) * unit, (1.2345 + np.linspace(0, 1e-3, 9)) * unit)
            finished(axis, [("x", "time", "s"), ("y", "q", "m")])
    figure.draw_without_rendering()
    boxes = [
        text.get_window_extent()
        for axis in figure.axes
        for text in (axis.xaxis.label, axis.yaxis.label, *shown_ticks(axis))
    ]
    whole = figure.bbox
    for k, box in enumerate(boxes):
        assert whole.x0 <= box.x0
        assert box.x1 <= whole.x1
        for other in boxes[:k]:
            assert not box.overlaps(other) or min(box.width, other.width) == 0


def test_numbers_have_no_exponent_of_their_own():
    shown = {v: rounded(v, 2) for v in (0.123, 1.0, 12.3, 123.4, 999.6, -123.4, 0.0)}
    assert list(shown.values()) == ["0.12", "1", "12", "123", "1000", "−123", "0"]
    assert engineering(1234.5, digits=2) == "1234"
    assert engineering(2.02e-10, "N m", 3) == "202 pN m"


def test_a_style_of_ones_own_is_left_alone():
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    picture(Figure(), "pdf")
    assert dict(mpl.rcParams) == before
