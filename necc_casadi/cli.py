"""The commands necc-design, necc-certify, necc-simulate: arguments in, text and exit codes out."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from necc_casadi import __version__
from necc_casadi.errors import OptionError
from necc_casadi.terminal import GroupedCommand, NamedPath, Progress, columns, grouped, run

if TYPE_CHECKING:  # heavy packages are imported where they are used: --help stays instant
    from necc_casadi.artifact import Design
    from necc_casadi.simulation import Trajectory

__all__ = ["certify_command", "design_command", "simulate_command"]

_WIDEST, _DEEPEST, _MOST_SWEPT = 1024, 8, 1000


def _widths(_ctx: click.Context, _option: click.Parameter, text: str | None) -> Any:
    """Widths of hidden layers, ``64,64`` -> (64, 64)."""
    if text is None:
        return None
    try:
        widths = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of widths such as 64,64") from None
    if len(widths) > _DEEPEST or not all(1 <= width <= _WIDEST for width in widths):
        raise click.BadParameter(f"{text!r}: at most {_DEEPEST} layers of 1 to {_WIDEST} neurons")
    return widths


def _numbers(_ctx: click.Context, option: click.Parameter, text: str | None) -> Any:
    """Comma-separated constants, read like --target."""
    if text is None:
        return None
    from necc_casadi.expressions import parse_number

    label = option.opts[-1]
    return tuple(float(parse_number(part, label, "usage", OptionError)) for part in text.split(","))


def _range(_ctx: click.Context, _option: click.Parameter, text: str | None) -> Any:
    """LO:HI:N -> (lo, hi, n)."""
    if text is None:
        return None
    try:
        lo, hi, n = text.split(":")
        result = (float(lo), float(hi), int(n))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not LO:HI:N, e.g. 0.1:1.0:10") from None
    if not (0 < result[0] < result[1] < math.inf and 2 <= result[2] <= _MOST_SWEPT):
        raise click.BadParameter(f"{text!r} needs 0 < LO < HI and 2 ≤ N ≤ {_MOST_SWEPT}")
    return result


class _Positive(click.FloatRange):
    """A finite number above zero."""

    def __init__(self) -> None:
        super().__init__(min=0, min_open=True)

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Text to a float; nan and inf are no numbers here."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


_task = grouped("Task")
_form = grouped("Form of the design")
_region = grouped("Region of attraction")
_solver = grouped("Solver and damping")
_output = grouped("Output")


@click.command("necc-design", cls=GroupedCommand)
@click.argument("model", type=NamedPath())
@_task(
    "--target",
    metavar="TARGET",
    help="Set-point: pi/4, q=pi/4, q1=pi/4,q2=-pi/3 or all states "
    "in order; states not given are solved from the equilibrium condition. Default: `target` in "
    "the model file.",
)
@_task("--param", multiple=True, metavar="NAME=VALUE", help="Override a parameter of the model.")
@_task("--check", is_flag=True, help="Stop after the symbolic verdict: no training.")
@_form(
    "--paper",
    is_flag=True,
    help="The published form: plain tanh MLPs 64 and 32, Φ = H + Hc + C, a = 0.5, D = 5, Dc = 6.",
)
@_form(
    "--hidden-k",
    metavar="W,W,…",
    callback=_widths,
    help="Widths of K's hidden layers.  [default: 64]",
)
@_form(
    "--hidden-h",
    metavar="W,W,…",
    callback=_widths,
    help="Widths of Hc's hidden layers.  [default: 32]",
)
@_form("--activation", type=click.Choice(["tanh", "sin", "squareplus"]), help="[default: tanh]")
@_form(
    "--casimir-form",
    type=click.Choice(["sum", "joint"]),
    help="C = K(Σ βᵢ(cᵢ)) or K(c₁, …, c_r).  [default: joint; sum with --paper]",
)
@_form(
    "--global",
    "convex",
    is_flag=True,
    help="Quadratic parts stiff enough to make V convex everywhere, where the plant allows it.",
)
@_form(
    "--learn-casimir",
    is_flag=True,
    help="Where closed forms are missing: a network C(z) that is a Casimir approximately. "
    "Nothing is certified from it.",
)
@_form(
    "--phi",
    type=click.Choice(["sum", "neural"]),
    help="Φ = H + Hc + C, or a network with Φ₁ > 0 by construction.  [default: sum]",
)
@_form(
    "--structure",
    metavar="NAME",
    help="A controller structure that the tool offered in a note, e.g. resonator.",
)
@_region(
    "--shape",
    type=click.Choice(["none", "regulariser", "level"]),
    default="none",
    show_default=True,
    help="What to ask of V over samples of the domain, beside the conditions at z*. level: the "
    "largest share of the domain below a level that its boundary is not below. regulariser: "
    "‖z − z*‖² ≤ γ (V(z) − V(z*)) on average. For Φ = H + Hc + C in the joint form.",
)
@_region(
    "--gamma",
    type=_Positive(),
    help="γ of the regulariser, in natural units: the smaller, the steeper V.  [default: 1]",
)
@_solver(
    "--a",
    type=_Positive(),
    help="Curvature asked of ∇²V(z*).  [default: half of the plant's own; 0.5 with --paper]",
)
@_solver(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the first start.",
)
@_solver(
    "--starts",
    type=click.IntRange(1, 1000),
    default=1,
    show_default=True,
    help="Random starts; the best is kept.",
)
@_solver(
    "--damping",
    metavar="NUMBERS",
    callback=_numbers,
    help="D: one number, or one per input.  [default: chosen]",
)
@_solver(
    "--controller-damping",
    metavar="NUMBERS",
    callback=_numbers,
    help="Dc, likewise.  [default: chosen]",
)
@_output("--out", type=NamedPath(), help="Folder to write.  [default: <model>-design]")
@_output("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else there.")
@_output("--no-plots", is_flag=True, help="Draw no figures.")
@_output(
    "--sweep-a",
    metavar="LO:HI:N",
    callback=_range,
    help="Also design and certify for N values of a; draw distance, bounds and region against a.",
)
@_output(
    "--real",
    type=click.Choice(["double", "float"]),
    default="double",
    show_default=True,
    help="Number type of the C controller.",
)
@_output(
    "--integrator",
    type=click.Choice(["heun", "euler", "rk4"]),
    default="heun",
    show_default=True,
    help="How the C controller advances its state over a sample.",
)
@_output("--fmu", is_flag=True, help="Also an FMI 2.0 co-simulation unit.")
@_output("--mex", is_flag=True, help="Also a MEX source for MATLAB.")
@_output(
    "--sample-time",
    type=_Positive(),
    help="Sample time of the C controller, s.",
)
@_output("--debug", is_flag=True, help="Show IPOPT's iterations and tracebacks.")
@click.version_option(__version__, prog_name="necc-design")
def _design(model: Path, **options: Any) -> int:
    """Design a certified energy-Casimir controller for the plant in MODEL.

    MODEL is a Python file that defines x, J, R, G and H with sympy. It is run as your own code.

    \b
    Examples:
      necc-design pendulum.py --target pi/4
      necc-design pendulum.py --target q=pi/4 --check
      necc-design pendulum.py --target pi/4 --paper --sweep-a 0.1:1.0:10

    \b
    Exit codes:
      0  every claim is proved (with --check: the target is assignable)
      1  a fault of this program
      2  bad usage, model file or target
      3  refused with a proof: not assignable with this controller structure
      4  undecided, or the solver or a certificate fell short; results are kept
      130  interrupted

    With --json, 1, 2 and 130 print {"status": "error", "error": {"code": …, "message": …}}; the
    code word of 1 is internal, that of 130 interrupted.
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.pipeline import Request, run_design
        from necc_casadi.report import to_json
        from necc_casadi.summary import summary

        form = (
            "hidden_k",
            "hidden_h",
            "activation",
            "casimir_form",
            "phi",
            "a",
            "convex",
            "learn_casimir",
            "shape",
            "gamma",
        )
        chosen = {key: options[key] for key in form if options[key] is not None}
        chosen |= {key: options[key] for key in ("seed", "starts")} | {"verbose": options["debug"]}
        passed = (
            "target",
            "param",
            "check",
            "paper",
            "damping",
            "controller_damping",
            "sweep_a",
            "real",
            "sample_time",
            "structure",
            "integrator",
            "fmu",
            "mex",
        )
        request = Request(
            model=model,
            out=options["out"] or Path(f"{model.stem}-design"),
            chosen=chosen,
            plots=not options["no_plots"],
            **{key: options[key] for key in passed},
        )
        found = run_design(request, progress.say)
    if options["as_json"]:
        click.echo(json.dumps(to_json(found), ensure_ascii=False, allow_nan=False))
    else:
        click.echo(summary(found, columns()))
    return found.exit_code


@click.command("necc-simulate", cls=GroupedCommand)
@click.argument("out", type=NamedPath())
@_task(
    "--x0",
    metavar="NUMBERS",
    callback=_numbers,
    help="Plant state to start from, all states in order.  [default: "
    "the middle between target and domain edge]",
)
@_task(
    "--xi0",
    metavar="NUMBERS",
    callback=_numbers,
    help="Controller state to start from.  [default: ξ*]",
)
@_task("--time", "horizon", type=_Positive(), help="Horizon, s.")
@_output(
    "--points",
    type=click.IntRange(2, 1_000_000),
    default=501,
    show_default=True,
    help="Number of output times.",
)
@_output(
    "--csv",
    type=NamedPath(dir_okay=False),
    help="Write the response to a CSV file (- for stdout).",
)
@_output("--plot", type=NamedPath(dir_okay=False), help="Draw it to a PNG file.")
@_output("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@_output("--debug", is_flag=True, help="Show tracebacks.")
@click.version_option(__version__, prog_name="necc-simulate")
def _simulate(out: Path, **options: Any) -> int:
    """Simulate the design in the folder OUT that necc-design wrote.

    \b
    Examples:
      necc-simulate pendulum-design --x0 0,0
      necc-simulate pendulum-design --x0 -1,0.5 --time 20 --csv response.csv
    """
    if options["as_json"] and str(options["csv"]) == "-":
        raise OptionError(
            "usage", "--csv - and --json both want stdout", "Name a file: --csv response.csv."
        )
    from necc_casadi.artifact import Design, write_text
    from necc_casadi.simulation import domain_box, simulate

    made = Design.load(out)
    n = made.loop.plant.n
    names = {"x0": made.loop.plant.states, "xi0": made.loop.controller.states}
    for key, states in names.items():
        if options[key] is not None and len(options[key]) != len(states):
            raise OptionError(
                "usage",
                f"--{key}: {len(states)} number(s) are needed, not {len(options[key])}",
                f"Give one for each of {', '.join(states)}.",
            )
    x0 = options["x0"] or tuple((made.z_star + domain_box(made)[1])[:n] / 2)
    xi0 = options["xi0"] or tuple(made.xi_star)
    response = simulate(made, x0, xi0, time=options["horizon"], points=options["points"])
    text = response.csv(made.loop.states)
    if options["csv"] is not None and str(options["csv"]) != "-":
        write_text(options["csv"], text)
    if options["plot"] is not None:
        from necc_casadi.figures import responses_figure, write_figure

        write_figure(responses_figure(made, [response]), options["plot"])
    if str(options["csv"]) == "-":
        click.echo(text, nl=False)
    elif options["as_json"]:
        click.echo(json.dumps(_response_json(made, response)))
    else:
        click.echo(_response_text(made, response))
    return 0 if response.complete else 4


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _response_json(made: Design, response: Trajectory) -> dict[str, Any]:
    return {
        "states": list(made.loop.states),
        "t_end": float(response.t[-1]),
        "z_end": [_finite(float(v)) for v in response.z[-1]],
        "settling_time": _finite(response.settling_time),
        "peak_input": _finite(response.peak_input),
        "complete": response.complete,
    }


def _response_text(made: Design, response: Trajectory) -> str:
    end = ", ".join(f"{s} = {v:.6g}" for s, v in zip(made.loop.states, response.z[-1], strict=True))
    settled = (
        f"settles within 2 % in {response.settling_time:.4g} s"
        if response.converged
        else "has not settled"
    )
    stopped = "" if response.complete else "\nThe integrator gave up: the response may diverge."
    return (
        f"{made.loop.plant.name}: {settled}; peak |u| {response.peak_input:.4g}\n"
        f"at t = {response.t[-1]:.4g} s: {end}{stopped}"
    )


@click.command("necc-certify", cls=GroupedCommand)
@click.argument("out", type=NamedPath())
@_output("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@_output("--debug", is_flag=True, help="Show tracebacks.")
@click.version_option(__version__, prog_name="necc-certify")
def _certify(out: Path, **options: Any) -> int:
    """Prove again, with other arithmetic, what OUT/certificate.json claims about OUT/design.json.

    \b
    Exit codes:
      0  every claim holds
      2  OUT cannot be read
      4  a claim does not hold
    """
    progress = Progress()
    with progress.shown():
        from necc_casadi.certificate.checker import check

        progress.say("checking the certificate")
        began = time.perf_counter()
        results = check(out)
        seconds = time.perf_counter() - began
    holds = all(result.holds for result in results)
    if options["as_json"]:
        status = "certified" if holds else "fell_short"
        claims = [vars(result) for result in results]
        click.echo(json.dumps({"status": status, "claims": claims, "seconds": seconds}))
    else:
        for result in results:
            mark = "holds" if result.holds else "DOES NOT HOLD"
            click.echo(f"{result.name:12} {mark:14} {result.statement}")
    return 0 if holds else 4


def design_command() -> None:
    """Entry point of ``necc-design``."""
    sys.exit(run(_design))


def certify_command() -> None:
    """Entry point of ``necc-certify``."""
    sys.exit(run(_certify))


def simulate_command() -> None:
    """Entry point of ``necc-simulate``."""
    sys.exit(run(_simulate))
