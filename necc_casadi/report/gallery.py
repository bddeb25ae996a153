"""Every figure that a run has something to show in, by name."""

from __future__ import annotations

from matplotlib.figure import Figure

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design
from necc_casadi.report.findings import Findings
from necc_casadi.report.landscape_figure import landscape_figure
from necc_casadi.report.proof_figure import proof_figure
from necc_casadi.report.region_figure import lyapunov_figure, region_boundary, region_figure
from necc_casadi.report.responses_figure import responses_figure
from necc_casadi.report.style import styled
from necc_casadi.report.sweep_figure import sweep_figure
from necc_casadi.simulation.responses import Trajectory, response_from

__all__ = ["figures_of", "from_the_boundary"]


def figures_of(found: Findings) -> dict[str, Figure]:
    """The figures of a design, by the names of their files."""
    made, certificate = found.finished
    with styled():
        figures: dict[str, Figure | None] = {
            "lyapunov": lyapunov_figure(made),
            "responses": responses_figure(made, found.responses),
        }
        if certificate.level is not None:
            inside = from_the_boundary(made, certificate)
            figures["region"] = region_figure(
                made, certificate.level, inside, certificate.reach, certificate.obstacle
            )
        figures["landscape"] = landscape_figure(made, certificate)
        if found.beside is not None:
            plant = made.loop.plant
            figures["proof"] = proof_figure(found.beside, plant.name, plant.states, plant.units)
        if found.performance is not None:
            from necc_casadi.report.comparison_figures import frequency_figure, step_figure

            figures["step"] = step_figure(made, found.performance)
            figures["loop"] = frequency_figure(made, found.performance)
        if found.sweep:
            figures["sweep"] = sweep_figure(made, found.sweep)
    return {name: figure for name, figure in figures.items() if figure is not None}


def from_the_boundary(design: Design, certificate: Certificate) -> list[Trajectory]:
    """Responses from the boundary of the proved region, in the plane that is shown."""
    if certificate.level is None:
        return []
    starts = region_boundary(design, certificate.level, certificate.reach)
    return [response_from(design, start, design.xi_star) for start in starts]
