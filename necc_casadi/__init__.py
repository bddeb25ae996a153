"""Neural energy-Casimir control for port-Hamiltonian systems.

From a sympy model to a certified C controller, in one call::

    result = run("pendulum.py", target="pi/4")            # nothing is written; out="folder" does
    print(result.summary()); result.plot_responses(); result.save("pendulum-design")

    run(make_model(q=q, M=1, V=1 - cos(q), B=1), "pi/4")  # a notebook's own, without a file

or step by step, in the order of the theory::

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

``pendulum.py`` is the model file of the README; examples in the docstrings load it too. What is
proved and why: docs/theory.md. What scripts may rely on: docs/contract.md.

Names are loaded when they are first used, so that importing the package is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what _HOME says, for tools that do not run the code
    from necc_casadi.casimirs.casimirs import Casimirs as Casimirs
    from necc_casadi.casimirs.find import find_casimirs as find_casimirs
    from necc_casadi.certificate.claims.certificate import Certificate as Certificate
    from necc_casadi.certificate.prover.certify import certify as certify
    from necc_casadi.choice.choose import choose as choose
    from necc_casadi.designs.design import Design as Design
    from necc_casadi.export.c_project import export_c as export_c
    from necc_casadi.model.closed_loop import ClosedLoop as ClosedLoop
    from necc_casadi.model.closed_loop import interconnect as interconnect
    from necc_casadi.model.controller import Controller as Controller
    from necc_casadi.model.controller import make_controller as make_controller
    from necc_casadi.model.model_file import Model as Model
    from necc_casadi.model.model_file import load_model as load_model
    from necc_casadi.model.model_file import make_model as make_model
    from necc_casadi.model.plant import Plant as Plant
    from necc_casadi.model.plant import make_plant as make_plant
    from necc_casadi.model.target import parse_target as parse_target
    from necc_casadi.model.urdf import read_urdf as read_urdf
    from necc_casadi.pipeline.call import run as run
    from necc_casadi.pipeline.given import RunOptions as RunOptions
    from necc_casadi.pipeline.result import Result as Result
    from necc_casadi.simulation.responses import Trajectory as Trajectory
    from necc_casadi.simulation.responses import simulate as simulate
    from necc_casadi.synthesis.options import Options as Options
    from necc_casadi.synthesis.options import paper_options as paper_options
    from necc_casadi.synthesis.synthesis import design as design
    from necc_casadi.verdict.judge import judge as judge
    from necc_casadi.verdict.verdict import Verdict as Verdict

    __version__: str

#: Public names and the modules they live in.
_HOME = {
    "Casimirs": "casimirs.casimirs",
    "Certificate": "certificate.claims.certificate",
    "ClosedLoop": "model.closed_loop",
    "Controller": "model.controller",
    "Design": "designs.design",
    "Model": "model.model_file",
    "Options": "synthesis.options",
    "Plant": "model.plant",
    "Result": "pipeline.result",
    "RunOptions": "pipeline.given",
    "Trajectory": "simulation.responses",
    "Verdict": "verdict.verdict",
    "certify": "certificate.prover.certify",
    "choose": "choice.choose",
    "design": "synthesis.synthesis",
    "export_c": "export.c_project",
    "find_casimirs": "casimirs.find",
    "interconnect": "model.closed_loop",
    "judge": "verdict.judge",
    "load_model": "model.model_file",
    "make_controller": "model.controller",
    "make_model": "model.model_file",
    "make_plant": "model.plant",
    "paper_options": "synthesis.options",
    "parse_target": "model.target",
    "read_urdf": "model.urdf",
    "run": "pipeline.call",
    "simulate": "simulation.responses",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> object:
    value: object
    if name == "__version__":
        from importlib.metadata import version

        value = version("necc-casadi")
    elif name in _HOME:
        value = getattr(import_module(f"necc_casadi.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'necc_casadi' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
