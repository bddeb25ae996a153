"""Figures: labelled with units, minima where they are, drawn without a display."""

import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from necc_casadi import figures
from necc_casadi.simulation import random_states, simulate


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
    figure = figures.lyapunov_figure(made)
    flat = figure.axes[1]
    i, j = figures._telling_pair(made)
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
    figure = figures.lyapunov_figure(default_design)
    labels = {figure.axes[1].get_xlabel(), figure.axes[1].get_ylabel()}
    assert labels == {"q [rad]", "p [kg m²/s]"}


def test_the_plotted_surface_is_V(default_design):
    """The lowest contour's height and the grid come from V itself: compare a cut through z*."""
    surface = figures.lyapunov_figure(default_design).axes[0]
    low, high = surface.get_zlim()
    corner = default_design.z_star.copy()
    corner[:2] += 2
    value = default_design.V(corner) - default_design.V(default_design.z_bar)
    assert low <= 0 + 1e-9
    assert value <= high + 1e-9


def test_responses_show_every_state_the_input_and_V(default_design, response):
    figure = figures.responses_figure(default_design, [response])
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


def test_two_inputs_are_two_panels(designs):
    made = designs["joint"]
    some = simulate(made, random_states(made, 1)[0], points=21)
    labels = [axis.get_ylabel() for axis in figures.responses_figure(made, [some]).axes]
    assert {"u1", "u2"} <= set(labels)


def test_the_sweep_shows_distance_and_both_bounds(default_design):
    points = [
        figures.SweepPoint(a, 1e-3, 1e-4, 1e-3 / (a - 1e-3), bound)
        for a, bound in ((0.1, 2e-4), (0.5, 3e-4), (1.0, None or float("inf")))
    ]
    figure = figures.sweep_figure(default_design, points)
    (axis,) = figure.axes
    assert len(axis.lines) == 3
    assert all(list(line.get_xdata()) == [0.1, 0.5, 1.0] for line in axis.lines)
    assert axis.get_yscale() == "log"
    assert drawn(figure).startswith(b"\x89PNG")


def test_written_whole(default_design, response, tmp_path):
    path = tmp_path / "figures" / "responses.png"
    figures.write_figure(figures.responses_figure(default_design, [response]), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in path.parent.iterdir()] == ["responses.png"]
