"""Neural energy-Casimir control for port-Hamiltonian systems.

From a sympy model to a certified C controller, in the order of the theory::

    model = load_model("pendulum.py")
    x_star = parse_target(model.loop.plant, "pi/4")
    casimirs = find_casimirs(model.loop)
    verdict = judge(model.loop, casimirs, x_star)
    made = design(model.loop, casimirs, verdict, x_star)
    certificate = certify(made)
    response = simulate(made, x0=[0.0, 0.0])

    made = Design.load("pendulum-design/design.json")     # later, without the model file
    u, xi_dot = made.control(x=[0.1, 0.0], xi=[0.2])      # (n,), (nc,) -> (m,), (nc,)
    A, B, C, D = made.linearise()                         # (n + nc)², (n + nc) × 2m, …

Names are loaded when they are first used, so that importing the package is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from necc_casadi.artifact import Design
    from necc_casadi.assignability import Verdict, judge
    from necc_casadi.casimirs import Casimirs, find_casimirs
    from necc_casadi.certificate import Certificate, certify
    from necc_casadi.export import export_c
    from necc_casadi.loop import ClosedLoop, Controller, interconnect, make_controller
    from necc_casadi.model_file import Model, load_model
    from necc_casadi.plant import Plant, make_plant
    from necc_casadi.simulation import Trajectory, simulate
    from necc_casadi.synthesis import Options, design, paper_options
    from necc_casadi.target import parse_target

_HOME = {
    "Casimirs": "casimirs",
    "Certificate": "certificate",
    "ClosedLoop": "loop",
    "Controller": "loop",
    "Design": "artifact",
    "Model": "model_file",
    "Options": "synthesis",
    "Plant": "plant",
    "Trajectory": "simulation",
    "Verdict": "assignability",
    "certify": "certificate",
    "design": "synthesis",
    "export_c": "export",
    "find_casimirs": "casimirs",
    "interconnect": "loop",
    "judge": "assignability",
    "load_model": "model_file",
    "make_controller": "loop",
    "make_plant": "plant",
    "paper_options": "synthesis",
    "parse_target": "target",
    "simulate": "simulation",
}

__all__ = [
    "Casimirs",
    "Certificate",
    "ClosedLoop",
    "Controller",
    "Design",
    "Model",
    "Options",
    "Plant",
    "Trajectory",
    "Verdict",
    "__version__",
    "certify",
    "design",
    "export_c",
    "find_casimirs",
    "interconnect",
    "judge",
    "load_model",
    "make_controller",
    "make_plant",
    "paper_options",
    "parse_target",
    "simulate",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'necc_casadi' has no attribute {name!r}")
    value = getattr(import_module(f"necc_casadi.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
