"""necc-design: from a model and a target to a certified controller."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from necc_casadi.cases import (
    Activation,
    CasimirForm,
    Format,
    Integrator,
    MethodWord,
    PhiForm,
    Precision,
    Shape,
)
from necc_casadi.cli.console import Progress, echo, echo_json
from necc_casadi.cli.options import (
    Positive,
    choice,
    form_option,
    json_option,
    last_options,
    numbers,
    output_option,
    read_integral,
    read_prefix,
    read_range,
    region_option,
    response_option,
    solver_option,
    task_option,
    widths,
)
from necc_casadi.cli.terminal import GroupedCommand, NamedPath, columns, run, said_again

if TYPE_CHECKING:
    from necc_casadi.pipeline.request import Request

__all__ = ["design_command"]


@click.command("necc-design", cls=GroupedCommand)
@click.argument("model", type=NamedPath())
@task_option(
    "--target",
    metavar="TARGET",
    help="Set-point: pi/4, q=pi/4, q1=pi/4,q2=-pi/3 or all states "
    "in order; states not given are solved from the equilibrium condition. A range "
    "q=-1:1 makes a set-point that moves. Default: `target` in the model file.",
)
@task_option(
    "--param", multiple=True, metavar="NAME=VALUE", help="Override a parameter of the model."
)
@task_option(
    "--uncertain",
    metavar="NAME=RANGE,…",
    help="Parameters that are constant and unknown: m=10%,g=0.95:1.05. How far from the target it "
    "rests is proved for all of them.",
)
@task_option(
    "--disturbance",
    metavar="SIZE[,…]",
    help="Constant unknown disturbances of the inputs, within ± SIZE; one, or one per input.",
)
@task_option("--check", is_flag=True, help="Stop after the symbolic verdict: no training.")
@response_option(
    "--settle",
    type=Positive(),
    metavar="SECONDS",
    help="Time in which a response is to come within 2 %: a rate of 4/SECONDS.",
)
@response_option(
    "--rate",
    type=Positive(),
    metavar="1/S",
    help="Rate that every mode at the target is to exceed.",
)
@numbers(
    response_option,
    "--peak-u",
    "Largest |u| from random starts, one number or one per input.  [default with --rate and "
    "--settle: u_limits of the model]",
)
@response_option(
    "--compare",
    is_flag=True,
    help="Measure the design beside LQR and the optimum, from the same starts.",
)
@response_option(
    "--integral",
    metavar="[TAU]",
    is_flag=False,
    flag_value="auto",
    callback=read_integral,
    help="Integral action on the position, with which constant forces and wrong parameters leave "
    "no offset; for mechanical plants that measure velocities, near the target alone where they "
    "have fewer inputs than coordinates. TAU in s.  "
    "[default: chosen]",
)
@response_option(
    "--polish",
    is_flag=True,
    help="Lower the cost of responses from 32 starts of the domain, the worst first, inputs "
    "clipped; kept where nothing is given up that is proved without it.",
)
@form_option(
    "--paper",
    is_flag=True,
    help="The published form: plain tanh MLPs 64 and 32, Φ = H + Hc + C, a = 0.5, D = 5, Dc = 6.",
)
@widths("--hidden-k", "Widths of K's hidden layers.  [default: 64]")
@widths("--hidden-h", "Widths of Hc's hidden layers.  [default: 32]")
@form_option("--activation", type=choice(Activation), help="[default: tanh]")
@form_option(
    "--casimir-form",
    type=choice(CasimirForm),
    help="C = K(Σ βᵢ(cᵢ)) or K(c₁, …, c_r).  [default: joint; sum with --paper]",
)
@form_option(
    "--global",
    "convex",
    is_flag=True,
    help="Quadratic parts stiff enough to make V convex everywhere, where the plant allows it.",
)
@form_option(
    "--learn-casimir",
    is_flag=True,
    help="Where closed forms of the published loop are missing: a network C(z) that is a Casimir "
    "approximately. Nothing is certified from it.",
)
@form_option(
    "--phi",
    type=choice(PhiForm),
    help="Φ = H + Hc + C, or a network with Φ₁ > 0 by construction.  [default: sum]",
)
@form_option(
    "--method",
    type=choice(MethodWord),
    default="auto",
    show_default=True,
    help="How the loop gets its Casimirs. auto: interconnection, the published loop, where it can "
    "hold the target, else the first of the others that can.",
)
@form_option(
    "--structure",
    metavar="NAME",
    help="A controller structure that the tool offered in a note, e.g. resonator.",
)
@region_option(
    "--shape",
    type=choice(Shape),
    default="none",
    show_default=True,
    help="What to ask of V over the domain, beside the conditions at z*. level: what ends the "
    "region is raised, where that gains anything. regulariser: ‖z − z*‖² ≤ γ (V(z) − V(z*)) on "
    "average. For Φ = H + Hc + C in the joint form.",
)
@region_option(
    "--gamma",
    type=Positive(),
    help="γ of the regulariser, in natural units: the smaller, the steeper V.  [default: 1]",
)
@solver_option(
    "--a",
    type=Positive(),
    help="Curvature asked of ∇²V(z*).  [default: half of the plant's own; 0.5 with --paper]",
)
@solver_option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the first start.",
)
@solver_option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=1,
    show_default=True,
    help="Random starts; the best is kept.",
)
@numbers(solver_option, "--damping", "D: one number, or one per input.  [default: chosen]")
@numbers(solver_option, "--controller-damping", "Dc, likewise.  [default: chosen]")
@output_option("--out", type=NamedPath(), help="Folder to write.  [default: <model>-design]")
@json_option("One JSON object on stdout, nothing else there.")
@output_option(
    "-v", "--verbose", "every_claim", is_flag=True, help="Say every claim, file and time."
)
@output_option("--no-plots", is_flag=True, help="Draw no figures.")
@output_option(
    "--format",
    type=choice(Format),
    default="png",
    show_default=True,
    help="Of the figures; in PDF, letters stay letters in fonts that are in the file.",
)
@output_option(
    "--sweep-a",
    metavar="LO:HI:N",
    callback=read_range,
    help="Also design and certify for N values of a; draw distance, bounds and region against a.",
)
@output_option(
    "--real",
    type=choice(Precision),
    default="double",
    show_default=True,
    help="Number type of the C controller.",
)
@output_option(
    "--integrator",
    type=choice(Integrator),
    default="heun",
    show_default=True,
    help="How the C controller advances its state over a sample.",
)
@output_option(
    "--prefix",
    default="necc",
    show_default=True,
    metavar="NAME",
    callback=read_prefix,
    help="How every external name of the C controller begins.",
)
@output_option("--fmu", is_flag=True, help="Also an FMI 2.0 co-simulation unit.")
@output_option("--mex", is_flag=True, help="Also a MEX source for MATLAB.")
@output_option("--sample-time", type=Positive(), help="Sample time of the C controller, s.")
@output_option(
    "--min-sample-time",
    type=Positive(),
    metavar="SECONDS",
    help="Shortest time between two samples, for how near the sampled loop stays under rounding, "
    "noise and delay.  [default: a hundredth of --sample-time]",
)
@output_option(
    "--noise",
    metavar="NAME=SIZE,…",
    help="Largest error of what is measured, in its units, for the same: q=1e-3,p=0.01; of "
    "velocities q_dot=0.01.",
)
@output_option(
    "--input-error",
    metavar="NAME=SIZE,…",
    help="Largest error of inputs as they are applied, likewise.",
)
@output_option("--delay", is_flag=True, help="Each u is applied one sample late, likewise.")
@last_options("necc-design", "Show IPOPT's iterations and tracebacks.")
def _design(model: Path, **options: Any) -> int:
    """Design a certified energy-Casimir controller for the plant in MODEL.

    MODEL is a Python file that defines x, J, R, G and H with sympy; it is run as your own code.
    Or an arm in URDF.

    --settle, --rate and --peak-u design for the least quadratic cost. Its weights are state_cost
    and input_cost of MODEL, by default 1/size² of every state and input; a model that has them is
    designed so, too. --compare measures the design that is made, whatever was asked.

    \b
    Examples:
      necc-design pendulum.py --target pi/4
      necc-design pendulum.py --target q=pi/4 --check
      necc-design pendulum.py --target pi/4 --settle 3 --peak-u 3 --compare
      necc-design pendulum.py --target pi/4 --polish --compare
      necc-design pendulum.py --target pi/4 --paper --sweep-a 0.1:1.0:10

    \b
    Exit codes:
      0  every claim is proved (with --check: the target is assignable)
      1  a fault of this program
      2  bad usage, model file or target
      3  refused with a proof: not assignable by the methods asked for
      4  undecided, or the solver or a certificate fell short; results are kept
      130  interrupted

    With --json, 1, 2 and 130 print {"status": "error", "error": {"code": …, "message": …}}; the
    code word of 1 is internal, that of 130 interrupted.
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.pipeline.run import run_design
        from necc_casadi.report.to_json import to_json
        from necc_casadi.report.to_text import summary

        request = replace(_request(model, options), command=said_again(model))
        found = run_design(request, progress.say)
    if options["as_json"]:
        echo_json(to_json(found))
    else:
        echo(summary(found, columns(), verbose=options["every_claim"]))
    return found.exit_code


def _request(model: Path, options: Mapping[str, Any]) -> Request:
    """What the options say: each has the name of the field that it sets."""
    from necc_casadi.pipeline.request import Choices, Request

    said = {
        **options,
        "out": options["out"] or Path(f"{model.stem}-design"),
        "plots": not options["no_plots"],
        "verbose": options["debug"],
    }

    def chosen(kind: type[Choices] | type[Request]) -> dict[str, Any]:
        return {field.name: said[field.name] for field in fields(kind) if field.name in said}

    return Request(model=model, chosen=Choices(**chosen(Choices)), **chosen(Request))


def design_command() -> None:
    """Entry point of ``necc-design``."""
    sys.exit(run(_design))
