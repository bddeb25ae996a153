"""What a call of :func:`necc_casadi.run` gives back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.errors import OptionError
from necc_casadi.methods.method import Method
from necc_casadi.pipeline.request import Request
from necc_casadi.pipeline.run import write_run
from necc_casadi.report.findings import Findings
from necc_casadi.verdict.verdict import Verdict

if TYPE_CHECKING:
    from control import StateSpace
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from necc_casadi.certificate.claims.certificate import Certificate
    from necc_casadi.certificate.claims.claim import Claim
    from necc_casadi.designs.design import Design
    from necc_casadi.performance.measure import Performance
    from necc_casadi.simulation.responses import Trajectory

__all__ = ["Result"]


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """Everything that one run found; what was not reached is None.

    In a notebook it shows itself. Plots go on axes of your own, or make a figure.

    Examples
    --------
    >>> from necc_casadi import run
    >>> result = run("pendulum.py", target="pi/4")
    >>> result
    <Result pendulum: certified, asymptotically stable; q = pi/4, p = 0>
    >>> result.exit_code, result.certificate.is_global, result.design.xi_star.shape
    (0, True, (1,))
    >>> [claim.name for claim in result.claims if not claim.holds]
    []
    >>> A, B, C, D = result.loop_transfer()
    >>> figure = result.plot_responses()
    >>> result.save("pendulum-design").name
    'pendulum-design'
    """

    findings: Findings
    request: Request

    @property
    def status(self) -> str:
        """``certified, assignable, refused, undecided, fell_short``; docs/contract.md#json."""
        return self.findings.status

    @property
    def exit_code(self) -> int:
        """What the command would end with; docs/contract.md#exit-codes."""
        return self.findings.exit_code

    @property
    def verdict(self) -> Verdict | None:
        """What is known of the published loop before training."""
        published = self.findings.found.published
        return None if published is None else published.verdict

    @property
    def method(self) -> Method | None:
        """The loop that holds the target; None where none does."""
        return self.findings.method

    @property
    def casimirs(self) -> Casimirs | None:
        """The conserved quantities of the loop that holds the target, or else of the published."""
        held = self.findings.method or self.findings.found.published
        return None if held is None else held.casimirs

    @property
    def design(self) -> Design | None:
        """The design that is kept."""
        return self.findings.design

    @property
    def certificate(self) -> Certificate | None:
        """What is proved of it."""
        return self.findings.certificate

    @property
    def claims(self) -> tuple[Claim, ...]:
        """The claims of the certificate, proved or not."""
        return () if self.certificate is None else tuple(self.certificate.claims)

    @property
    def responses(self) -> Sequence[Trajectory]:
        """Simulated from random states."""
        return self.findings.responses

    @property
    def performance(self) -> Performance | None:
        """Measures beside LQR and the optimum; with ``compare=True``."""
        return self.findings.performance

    @property
    def notes(self) -> tuple[str, ...]:
        """What was not proved, what to try."""
        return self.findings.notes

    def summary(self, width: int = 98, *, verbose: bool = False) -> str:
        """The text that the command prints; verbose, with every claim."""
        from necc_casadi.report.to_text import summary

        return summary(self.findings, width, verbose=verbose)

    def to_dict(self) -> dict[str, Any]:
        """The object that the command prints with ``--json``; docs/contract.md#json."""
        from necc_casadi.report.to_json import to_json

        return to_json(self.findings)

    def save(self, out: str | Path) -> Path:
        """Write the folder that the command writes, whole, and return its path.

        Raises
        ------
        OutputError
            When it cannot be written.
        OptionError
            Where the run ended before a design.
        """
        write_run(self.request, self.findings, Path(out), lambda text: None)
        return Path(out)

    def loop_transfer(self) -> tuple[Vector, Vector, Vector, Vector]:
        """(A, B, C, D) of L(s) at z̄, the loop opened at the plant's input.

        Raises
        ------
        OptionError
            Where the run ended before a design.
        """
        return self.findings.finished[0].loop_transfer()

    def to_control(self) -> StateSpace:
        """L(s) as a system of python-control: margins, Bode, Nyquist.

        Raises
        ------
        OptionError
            Where python-control is not installed, or the run ended before a design.
        """
        made = self.findings.finished[0]
        try:
            import control
        except ImportError:
            raise OptionError(
                "usage",
                "to_control needs python-control, which is not installed",
                "Install it: python -m pip install control.",
            ) from None
        names = list(made.loop.plant.input_names)
        return control.ss(
            *made.loop_transfer(),
            states=list(made.loop.states),
            inputs=names,
            outputs=[f"-{name}" for name in names],
            name=self.request.word,
        )

    def plot_responses(self, ax: Any = None, show: str | Sequence[str] | None = None) -> Any:
        """States, inputs and V over time.

        Parameters
        ----------
        ax
            Axes for one quantity, or a sequence of them; by default a figure is made.
        show
            Names of states and inputs, and ``"V"``, one per axes; by default the first ones.

        Returns
        -------
        Figure or None
            The figure that was made; None with axes of your own.
        """
        from necc_casadi.report.responses_figure import (
            draw_over_time,
            responses_figure,
            shown_over_time,
        )
        from necc_casadi.report.ticks import finished

        made, found = self.findings.finished[0], self.findings.responses

        def draw(axis: Axes, name: str) -> None:
            draw_over_time(axis, made, found, name)
            finished(axis, [("x", "time", "s")])

        known = shown_over_time(made, found)
        return _on(ax, show, known, draw, lambda: responses_figure(made, found))

    def plot_comparison(self, ax: Any = None, show: str | Sequence[str] | None = None) -> Any:
        """The step and the loop beside LQR, with ``compare=True``.

        Parameters
        ----------
        ax
            Axes for one quantity, or a sequence of them; by default a figure of the step is made.
        show
            Names of states and inputs, ``"gain"``, ``"phase"`` and ``"nyquist"``, one per axes.

        Returns
        -------
        Figure or None
            The figure that was made; None with axes of your own.
        """
        from necc_casadi.report import comparison_figures as figures

        made, found = self.findings.finished[0], self.findings.performance
        if found is None or not found.step:
            raise OptionError("usage", "nothing was compared", "Ask for it: run(…, compare=True).")
        loops: dict[str, Callable[[Axes], None]] = {
            "gain": lambda axis: figures.draw_gain(axis, found, 0),
            "phase": lambda axis: figures.draw_phase(axis, found, 0),
            "nyquist": lambda axis: figures.draw_nyquist(axis, found, 0),
        }
        known = [*figures.step_names(made, found), *(loops if found.loops else ())]

        def draw(axis: Axes, name: str) -> None:
            if name in loops:
                loops[name](axis)
            else:
                figures.draw_step(axis, made, found, name)

        return _on(ax, show, known, draw, lambda: figures.step_figure(made, found))

    def plot_lyapunov(self, ax: Axes | None = None) -> Figure | None:
        """Contours of V − V(z̄) over two states; a figure has the surface too."""
        from necc_casadi.report.region_figure import draw_contours, lyapunov_figure

        made = self.findings.finished[0]
        return _single(
            ax,
            lambda axis: draw_contours(axis, made),
            lambda: lyapunov_figure(made),
        )

    def plot_region(self, ax: Axes | None = None) -> Figure | None:
        """The proved region, with responses from its boundary.

        Raises
        ------
        OptionError
            Where no region is proved; the whole space is none.
        """
        from necc_casadi.report.gallery import from_the_boundary
        from necc_casadi.report.region_figure import draw_region, region_figure

        made, certificate = self.findings.finished
        level = certificate.level
        if level is None:
            raise _nothing("region")
        shown = (made, level, from_the_boundary(made, certificate))
        ends = (certificate.reach, certificate.obstacle)
        return _single(
            ax,
            lambda axis: draw_region(axis, *shown, *ends),
            lambda: region_figure(*shown, *ends),
        )

    def plot_landscape(self, ax: Axes | None = None) -> Figure | None:
        """The least V over the states that are not shown, and what ends the region.

        Raises
        ------
        OptionError
            Where no region is proved that keeps one or two states.
        """
        from necc_casadi.report.landscape_figure import draw_landscape, landscape_figure

        made, certificate = self.findings.finished
        if ax is None:
            figure = _styled(lambda: landscape_figure(made, certificate))
            if figure is None:
                raise _nothing("landscape")
            return figure
        if not draw_landscape(ax, made, certificate):
            raise _nothing("landscape")
        return None

    def __repr__(self) -> str:
        """One line: the plant, the outcome, the target."""
        from necc_casadi.report.to_text import in_short, target_text

        return f"<Result {in_short(self.findings)}; {target_text(self.findings)}>"

    def _repr_html_(self) -> str:
        from necc_casadi.report.page import fragment

        return fragment(self.findings)


def _on(
    ax: Any,
    show: str | Sequence[str] | None,
    known: Sequence[str],
    draw: Callable[[Axes, str], None],
    figure: Callable[[], Figure | None],
) -> Figure | None:
    """Quantities on axes, one each; without axes, a figure of all of them."""
    names = [show] if isinstance(show, str) else list(known if show is None else show)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise OptionError(
            "usage", f"show: there is no {unknown[0]}", f"Choose from {', '.join(known)}."
        )
    if ax is None and show is None:
        return _styled(figure)
    if ax is None:
        return _styled(lambda: _columns(names, draw))
    axes = list(ax.flat) if hasattr(ax, "flat") else list(ax) if isinstance(ax, Sequence) else [ax]
    if show is not None and len(axes) != len(names):
        raise OptionError(
            "usage",
            f"show names {len(names)} quantities, ax holds {len(axes)}",
            "Give one pair of axes for each.",
        )
    for axis, name in zip(axes, names, strict=False):
        draw(axis, name)
    return None


def _columns(names: Sequence[str], draw: Callable[[Axes, str], None]) -> Figure:
    from necc_casadi.report.ticks import panels

    figure = panels(1, len(names), (2.8, 1.9))
    for axis, name in zip(figure.subplots(1, len(names), squeeze=False).flat, names, strict=True):
        draw(axis, name)
    return figure


def _single(
    ax: Axes | None, draw: Callable[[Axes], None], figure: Callable[[], Figure]
) -> Figure | None:
    if ax is None:
        return _styled(figure)
    draw(ax)
    return None


def _styled(figure: Callable[[], Figure | None]) -> Figure | None:
    from necc_casadi.report.style import styled

    with styled():
        return figure()


def _nothing(what: str) -> OptionError:
    return OptionError(
        "usage",
        f"there is no {what} to draw",
        "result.summary(verbose=True) says what is proved; plot_lyapunov works always.",
    )
