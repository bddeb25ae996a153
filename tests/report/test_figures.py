"""Figures: labelled with units, minima where they are, drawn without a display."""

import io
from dataclasses import replace

import numpy as np
import pytest
from helpers.problems import problem, solve
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.model_file import load_model
from necc_casadi.report.contours import contour_levels, number_contours
from necc_casadi.report.landscape_figure import landscape_figure
from necc_casadi.report.region_figure import lyapunov_figure, region_boundary, region_figure
from necc_casadi.report.responses_figure import responses_figure, shown_over_time
from necc_casadi.report.slices import Window, slice_boundary, telling_pair
from necc_casadi.report.style import write_figure
from necc_casadi.report.sweep_figure import sweep_figure
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.report.time_axis import until_rest
from necc_casadi.simulation.responses import random_states, simulate


@pytest.fixture(scope="module")
def response(default_design):
    return simulate(default_design, random_states(default_design, 1)[0], points=101)


def drawn(figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer)
    return buffer.getvalue()


@pytest.mark.parametrize("name", ["default", "paper", "joint"])
def test_the_lyapunov_figure_marks_both_minima(designs, name):
    made = designs[name]
    figure = lyapunov_figure(made)
    flat = figure.axes[1]
    i, j = telling_pair(made)
    marked = {line.get_label(): line.get_xydata()[0] for line in flat.lines}
    np.testing.assert_array_equal(
        next(v for k, v in marked.items() if "z*" in k), made.z_star[[i, j]]
    )
    np.testing.assert_array_equal(
        next(v for k, v in marked.items() if "z̄" in k), made.z_bar[[i, j]]
    )
    assert flat.get_xlabel().startswith(made.loop.states[i])
    assert flat.get_ylabel().startswith(made.loop.states[j])
    assert drawn(figure).startswith(b"\x89PNG")


def test_labels_carry_the_units_of_the_model(default_design):
    figure = lyapunov_figure(default_design)
    labels = {figure.axes[1].get_xlabel(), figure.axes[1].get_ylabel()}
    assert labels == {"q [rad]", "p [kg m²/s]"}


def test_the_plotted_surface_is_V(default_design):
    """The lowest contour's height and the grid come from V itself: compare a cut through z*."""
    surface = lyapunov_figure(default_design).axes[0]
    low, high = surface.get_zlim()
    corner = default_design.z_star.copy()
    corner[:2] += 2
    value = default_design.V(corner) - default_design.V(default_design.z_bar)
    assert low <= 0 + 1e-9
    assert value <= high + 1e-9


def test_responses_show_every_state_the_input_and_V(default_design, response):
    figure = responses_figure(default_design, [response])
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels[:4] == ["q [rad]", "p [kg m²/s]", "xi1", "u"]
    assert "V" in labels[4]
    assert any("[s]" in axis.get_xlabel() for axis in figure.axes)
    for k, axis in enumerate(figure.axes[:3]):
        np.testing.assert_array_equal(axis.lines[0].get_ydata(), response.z[:, k])
        assert axis.lines[-1].get_linestyle() == "--"
        assert set(np.atleast_1d(axis.lines[-1].get_ydata())) == {default_design.z_star[k]}
    np.testing.assert_array_equal(figure.axes[3].lines[0].get_ydata(), response.u[:, 0])
    held = figure.axes[3].lines[-1].get_ydata()[0]
    assert held == pytest.approx(np.sin(np.pi / 4), abs=1e-6)
    assert drawn(figure).startswith(b"\x89PNG")


def test_responses_that_do_not_settle_are_told_apart(default_design, response):
    """By colour, with a legend; where all settle there is none."""
    assert not responses_figure(default_design, [response]).legends
    cut = replace(response, z=response.z[:3], u=response.u[:3], V=response.V[:3], t=response.t[:3])
    figure = responses_figure(default_design, [response, cut])
    (legend,) = figure.legends
    colors = {line.get_label(): line.get_color() for line in legend.get_lines()}
    drawn_in = [line.get_color() for line in figure.axes[0].lines[:2]]
    assert drawn_in == [colors["settles within 2 %"], colors["does not settle in this time"]]


def test_two_inputs_are_two_panels(designs):
    made = designs["joint"]
    some = simulate(made, random_states(made, 1)[0], points=21)
    labels = [axis.get_ylabel() for axis in responses_figure(made, [some]).axes]
    assert {"u1", "u2"} <= set(labels)


def test_the_region_is_drawn_large_with_its_slice_and_its_shadow(default_design):
    """However small the level: the picture follows the region, which the domain would swallow."""
    bottom = default_design.V(default_design.z_bar)
    for level in (bottom + 1e-5, certify(default_design).level):
        starts = region_boundary(default_design, level)
        assert len(starts) == 12
        figure = region_figure(default_design, level, [simulate(default_design, starts[0])])
        (axis,) = figure.axes
        curve = next(xy for label, xy in lines_of(axis).items() if label.startswith("proved"))
        low, high = np.transpose([axis.get_xlim(), axis.get_ylim()])
        assert (np.ptp(curve, axis=0) > 0.3 * (high - low)).all()
        assert ((low <= curve) & (curve <= high)).all()
        assert axis.get_title().endswith(
            "from −1.21 rad to 2.79 rad, p from −1.68 kg m²/s to 1.68 kg m²/s"
        )
        assert drawn(figure).startswith(b"\x89PNG")


POLE = """
import sympy as sp
q, p = sp.symbols("q p", real=True)
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / 2 + q**2 / 2 + 1 / (4 - q)
domain = {q: (-3, 5)}
"""


def test_a_pole_in_the_domain_is_left_out_of_every_figure(tmp_path):
    """V is infinite at q = 4: Ω ends before, and its shadow does not jump across."""
    (tmp_path / "pole.py").write_text(POLE, encoding="utf-8")
    made = solve(problem(load_model(tmp_path / "pole.py"), "q=1"))
    certificate = certify(made)
    flat = lyapunov_figure(made).axes[1]
    assert np.isfinite(np.concatenate([c.levels for c in flat.collections])).all()
    starts = region_boundary(made, certificate.level, certificate.reach)
    inside = [simulate(made, x, made.xi_star, points=51) for x in starts]
    figure = region_figure(made, certificate.level, inside, certificate.reach)
    (axis,) = figure.axes
    edge = next(patch for patch in axis.patches if "seen over" in patch.get_label())
    assert edge.get_xy()[:, 0].max() < 4
    pictures = [figure, lyapunov_figure(made), responses_figure(made, inside)]
    pictures.append(landscape_figure(made, certificate))
    for picture in pictures:
        assert drawn(picture).startswith(b"\x89PNG")


def sweep(proved=(0.3, 0.2, 0.1), simulated=(1.0, 1.0, 0.9)):
    return [
        SweepPoint(a, 1e-3, 1e-4, 1e-3 / (a - 1e-3), 3e-4, share, converges)
        for a, share, converges in zip((0.1, 0.5, 1.0), proved, simulated, strict=True)
    ]


def lines_of(axis) -> dict[str, np.ndarray]:
    return {line.get_label(): line.get_xydata() for line in axis.lines}


def test_the_sweep_shows_distance_and_both_bounds(default_design):
    upper, _ = sweep_figure(default_design, sweep()).axes
    assert len(upper.lines) == 3
    assert all(list(xy[:, 0]) == [0.1, 0.5, 1.0] for xy in lines_of(upper).values())
    assert upper.get_yscale() == "log"


def test_a_distance_of_zero_has_a_place_on_the_logarithmic_axis(default_design):
    """In the band below one rounding of z*, not at a number that was never measured."""
    points = [replace(point, distance=0.0, loss=0.0, bound_paper=0.0) for point in sweep()]
    upper, _ = sweep_figure(default_design, points).axes
    (band,) = upper.patches
    rounding = np.spacing(np.linalg.norm(default_design.z_star))
    low, high = band.get_y(), band.get_y() + band.get_height()
    assert high == pytest.approx(rounding)
    for label, xy in lines_of(upper).items():
        assert ("proved" in label) == (not ((low <= xy[:, 1]) & (xy[:, 1] <= high)).all())


def test_the_sweep_shows_the_proved_share_beside_the_simulated_one(default_design):
    figure = sweep_figure(default_design, sweep())
    lower = figure.axes[1]
    lines = lines_of(lower)
    (proved,) = (xy for label, xy in lines.items() if "proved" in label)
    (simulated,) = (xy for label, xy in lines.items() if "simulation" in label)
    np.testing.assert_allclose(proved, [[0.1, 30], [0.5, 20], [1.0, 10]])
    np.testing.assert_allclose(simulated[:, 1], [100, 100, 90])
    assert lower.get_yscale() == "linear"
    assert lower.get_xlabel().startswith("a,")
    assert drawn(figure).startswith(b"\x89PNG")


def test_where_no_region_is_proved_a_cross_says_so(default_design):
    """No value is invented: the line has a gap and the cross lies on the axis."""
    figure = sweep_figure(default_design, sweep((0.3, None, 0.1), (None, 1.0, 1.0)))
    lines = lines_of(figure.axes[1])
    np.testing.assert_array_equal(lines["no region proved"], [[0.5, 0.0]])
    (proved,) = (xy for label, xy in lines.items() if "in the proved" in label)
    assert list(np.isnan(proved[:, 1])) == [False, True, False]
    assert drawn(figure).startswith(b"\x89PNG")
    nothing = sweep_figure(default_design, sweep((None,) * 3, (None,) * 3))
    assert list(lines_of(nothing.axes[1])) == ["no region proved"]


def test_small_shares_are_told_apart(default_design):
    figure = sweep_figure(default_design, sweep((3e-5, 1e-5, 1e-9)))
    assert figure.axes[1].get_yscale() == "log"


def test_the_sweep_says_where_a_is_out_of_reach(default_design):
    labels = [patch.get_label() for patch in sweep_figure(default_design, sweep()).axes[0].patches]
    assert "a above a_max" not in labels  # a_max = 1 for the pendulum
    points = [replace(point, a=2 * point.a) for point in sweep()]
    for axis in sweep_figure(default_design, points).axes:
        (band,) = (patch for patch in axis.patches if patch.get_label() == "a above a_max")
        assert band.get_x() == pytest.approx(default_design.verdict.a_max)


def test_written_whole(default_design, response, tmp_path):
    path = tmp_path / "figures" / "responses.png"
    write_figure(responses_figure(default_design, [response]), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in path.parent.iterdir()] == ["responses.png"]


def test_a_state_that_does_not_move_is_drawn_at_rest(default_design, response):
    """What the integrator errs by is no response: the axis shows a part of the state's size."""
    still = np.full(len(response.t), default_design.z_star[1])
    still[1:] += 1e-13 * np.arange(1, len(still))
    z = np.column_stack([response.z[:, 0], still, response.z[:, 2]])
    size = default_design.sizes.state[1]
    axis = responses_figure(default_design, [replace(response, z=z)]).axes[1]
    assert np.ptp(axis.get_ylim()) == pytest.approx(0.2 * size)
    assert np.mean(axis.get_ylim()) == pytest.approx(default_design.z_star[1])
    travel = default_design.z_star[1] + 1e7 * (still - still[0])
    z = np.column_stack([response.z[:, 0], travel, response.z[:, 2]])
    moved = responses_figure(default_design, [replace(response, z=z)]).axes[1]
    assert np.ptp(moved.get_ylim()) < 1e-3 * size


def test_a_state_of_the_controller_that_does_not_move_has_no_panel(default_design, response):
    z = np.column_stack([response.z[:, :2], np.full(len(response.t), default_design.z_star[2])])
    shown = shown_over_time(default_design, [replace(response, z=z)])
    assert shown == ["q", "p", "u", "V"]


def test_a_quantity_that_rests_sooner_has_a_time_of_its_own():
    t = np.linspace(0, 100, 1001)
    slow, quick, still = np.exp(-t / 20), np.exp(-t), np.full_like(t, 3.0)
    assert until_rest([(t, slow)], 100.0) == 100.0
    own = until_rest([(t, quick), (t, -2 * quick)], 100.0)
    assert np.abs(quick[t > own]).max() < 0.02
    assert 4 < own < 6  # e⁻ᵗ is 2 % at 3.9
    assert until_rest([(t, quick), (t, slow)], 100.0) == 100.0
    assert until_rest([(t, still)], 100.0) == until_rest([(t, quick)], 100.0, least=2.0) == 100.0
    assert until_rest([(t, np.where(t < 50, quick, np.nan))], 100.0) == 100.0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("narrow", [1.0, 40.0])
def test_numbers_on_contours_stand_inside_and_apart(scale, narrow):
    """Whatever the scale of axes and values, and where lines end at the border, too."""
    axis = Figure().add_subplot()
    a, b = np.meshgrid(scale * np.linspace(-1, 1, 61), np.linspace(-1, 1, 61) / scale)
    values = scale * ((a / scale) ** 2 / narrow + (b * scale) ** 2)
    lines = axis.contour(a, b, values, levels=contour_levels(values))
    lo, hi = np.transpose([axis.get_xlim(), axis.get_ylim()])
    power = number_contours(axis, lines, np.zeros((1, 2)))
    texts = [text for text in axis.texts if text.get_text()]
    assert len(texts) >= 3
    places = np.array([(text.get_position() - lo) / (hi - lo) for text in texts])
    assert ((places > 0.05) & (places < 0.95)).all()
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(len(places))
    assert gaps.min() > 0.1
    for text in texts:
        x, y = text.get_position()
        here = scale * ((x / scale) ** 2 / narrow + (y * scale) ** 2)
        assert float(text.get_text()) * 10.0**power == pytest.approx(here, rel=0.2)


def test_what_ends_the_region_is_marked(default_design):
    """At the critical point, outside of Ω's shadow; a place over the shadow is another state's."""
    certificate = certify(default_design)
    obstacle, proved = certificate.obstacle, (certificate.level, [], certificate.reach)
    for at, marked in ((obstacle.at, True), ({**obstacle.at, "q": 1.0, "p": 0.1}, False)):
        shown = replace(obstacle, at=at)
        (axis,) = region_figure(default_design, *proved, shown).axes
        places = [xy for label, xy in lines_of(axis).items() if label.startswith("ends Ω")]
        assert len(places) == marked
        for place in places:
            np.testing.assert_array_equal(place[0], [at["q"], at["p"]])


def test_a_region_that_goes_on_is_cut_at_the_border(default_design):
    """The slice follows the window's border, and says where it does."""
    level = default_design.V(default_design.z_bar) + 1.0
    narrow = Window((0, 1), np.array([0.5, -0.2]), np.array([1.0, 0.2]))
    curve = slice_boundary(default_design, level, narrow)
    assert narrow.on_border(curve).all()
    assert curve.min(0) == pytest.approx(narrow.lo)
    assert curve.max(0) == pytest.approx(narrow.hi)
