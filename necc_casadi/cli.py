"""The commands ``necc-design`` and ``necc-simulate``: arguments in, text and exit codes out."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from necc_casadi import __version__
from necc_casadi.errors import OptionError, OutputError
from necc_casadi.terminal import GroupedCommand, Progress, grouped, run

if TYPE_CHECKING:  # heavy packages are imported where they are used: --help stays instant
    import numpy as np

    from necc_casadi.artifact import Design
    from necc_casadi.model_file import Model
    from necc_casadi.report import Findings
    from necc_casadi.synthesis import Options

__all__ = ["design_command", "simulate_command"]

_WIDEST, _DEEPEST = 1024, 8
_RESPONSES = 10


class Widths(click.ParamType):
    """Widths of hidden layers, e.g. ``64,64``."""

    name = "W,W,…"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[int, ...]:
        """Text to a tuple of positive integers."""
        if isinstance(value, tuple):
            return value
        try:
            widths = tuple(int(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is not a list of widths such as 64,64", param, ctx)
        if not 1 <= len(widths) <= _DEEPEST or not all(1 <= w <= _WIDEST for w in widths):
            self.fail(f"{value!r}: 1 to {_DEEPEST} layers of 1 to {_WIDEST}", param, ctx)
        return widths


class Numbers(click.ParamType):
    """Comma-separated constants, e.g. ``2,0.5``."""

    name = "NUMBERS"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, ...]:
        """Text to floats, by the same exact parser as --target."""
        if isinstance(value, tuple):
            return value
        from necc_casadi.expressions import parse_number

        option = param.opts[-1] if param is not None else "value"
        return tuple(
            float(parse_number(part, option, "usage", OptionError)) for part in value.split(",")
        )


class Sweep(click.ParamType):
    """A range LO:HI:N."""

    name = "LO:HI:N"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, float, int]:
        """Text to (lo, hi, n) with 0 < lo < hi and n ≥ 2."""
        try:
            lo, hi, n = value.split(":")
            result = (float(lo), float(hi), int(n))
        except (ValueError, AttributeError):
            self.fail(f"{value!r} is not LO:HI:N, e.g. 0.1:1.0:10", param, ctx)
        if not (0 < result[0] < result[1] < float("inf") and 2 <= result[2] <= 1000):
            self.fail(f"{value!r} needs 0 < LO < HI and 2 ≤ N ≤ 1000", param, ctx)
        return result


_task = grouped("Task")
_form = grouped("Form of the design")
_solver = grouped("Solver and damping")
_output = grouped("Output")


@click.command("necc-design", cls=GroupedCommand)
@click.argument("model", type=click.Path(path_type=Path))
@_task("--target", metavar="TARGET", help="Set-point: pi/4, q=pi/4, q1=pi/4,q2=-pi/3 or all states "
       "in order; states not given are solved from the equilibrium condition. Default: `target` in "
       "the model file.")
@_task("--param", multiple=True, metavar="NAME=VALUE", help="Override a parameter of the model.")
@_task("--check", is_flag=True, help="Stop after the symbolic verdict: no training.")
@_form("--paper", is_flag=True, help="The published form: plain tanh MLPs 64 and 32, Φ = H + Hc + C, "
       "a = 0.5, D = 5, Dc = 6.")
@_form("--hidden-k", type=Widths(), help="Widths of K's hidden layers.  [default: 64]")
@_form("--hidden-h", type=Widths(), help="Widths of Hc's hidden layers.  [default: 32]")
@_form("--activation", type=click.Choice(["tanh", "sin", "squareplus"]), help="[default: tanh]")
@_form("--casimir-form", type=click.Choice(["sum", "joint"]), help="C = K(Σ βᵢ(cᵢ)) or "
       "K(c₁, …, c_r).  [default: joint; sum with --paper]")
@_form("--phi", type=click.Choice(["sum", "neural"]), help="Φ = H + Hc + C, or a network with "
       "Φ₁ > 0 by construction.  [default: sum]")
@_solver("--a", type=click.FloatRange(min=0, min_open=True), help="Curvature asked of ∇²V(z*).  "
         "[default: half of the plant's own; 0.5 with --paper]")
@_solver("--seed", type=click.IntRange(min=0), default=0, show_default=True,
         help="Seed of the first start.")
@_solver("--starts", type=click.IntRange(1, 1000), default=1, show_default=True,
         help="Random starts; the best is kept.")
@_solver("--damping", type=Numbers(), help="D: one number, or one per input.  [default: chosen]")
@_solver("--controller-damping", type=Numbers(), help="Dc, likewise.  [default: chosen]")
@_output("--out", type=click.Path(path_type=Path), help="Folder to write.  [default: <model>-design]")
@_output("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else there.")
@_output("--no-plots", is_flag=True, help="Draw no figures.")
@_output("--sweep-a", type=Sweep(), help="Also design for N values of a and draw distance and "
         "bounds against a.")
@_output("--real", type=click.Choice(["double", "float"]), default="double", show_default=True,
         help="Number type of the C controller.")
@_output("--sample-time", type=click.FloatRange(min=0, min_open=True),
         help="Sample time of the C controller, s.")
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
      2  bad usage, model file or target
      3  refused with a proof: not assignable with this controller structure
      4  undecided, or the solver or a certificate fell short; results are kept
    """
    progress = Progress()
    with progress.shown():
        found = _Run(model, options, progress).everything()
    from necc_casadi.report import summary, to_json

    click.echo(json.dumps(to_json(found), ensure_ascii=False) if options["as_json"] else summary(found))
    return found.exit_code


@dataclass
class _Run:
    """One run of ``necc-design``, stage by stage."""

    path: Path
    options: dict[str, Any]
    progress: Progress

    def everything(self) -> Findings:
        """Verdict, design, certificate, responses, files; stops where the verdict says so."""
        self.out = self.options["out"] or Path(f"{self.path.stem}-design")
        found = self.judge()
        if self.options["check"] or found.verdict is None or not found.verdict.assignable:
            return found
        self.design(found)
        self.certify(found)
        self.simulate(found)
        self.export(found)
        self.draw(found)
        return found

    @contextlib.contextmanager
    def stage(self, found: Findings, name: str, text: str) -> Iterator[None]:
        """Time a stage and name it in the progress display."""
        self.progress.say(text)
        began = time.perf_counter()
        yield
        found.timings[name] = time.perf_counter() - began

    def judge(self) -> Findings:
        """Read the model, find the Casimirs, judge the target."""
        self.progress.say("reading the model")
        began = time.perf_counter()
        from necc_casadi.assignability import judge
        from necc_casadi.casimirs import find_casimirs
        from necc_casadi.model_file import load_model
        from necc_casadi.report import Findings

        if not self.options["check"]:
            check_writable(self.out)
        model = load_model(self.path, _parameters(self.options["param"]))
        x_star = _target(model, self.options["target"])
        self.model = model
        found = Findings(model.loop, x_star)
        self.progress.say("finding Casimirs")
        found.casimirs = find_casimirs(model.loop, model.casimirs, x_star)
        self.progress.say("judging the target")
        found.verdict = judge(model.loop, found.casimirs, x_star)
        found.notes += _model_notes(found)
        found.timings["symbolic"] = time.perf_counter() - began
        return found

    def design(self, found: Findings) -> None:
        """Train and damp."""
        from necc_casadi.synthesis import design

        began = time.perf_counter()
        self.progress.say("training")
        options = _options(self.options, self.model)
        count = [0]

        def report(start: Any) -> None:
            count[0] += 1
            self.progress.say(f"training: start {count[0]}, loss {start.loss:.1e}")

        made = design(
            self.model.loop, found.casimirs, found.verdict, found.x_star, options, report
        )  # type: ignore[arg-type]
        found.design = made
        found.timings["design"] = time.perf_counter() - began
        found.timings["solve"] = sum(s.seconds for s in made.starts)
        if made.a < made.a_requested:
            found.notes.append(
                f"a = {made.a_requested:.4g} was asked for, but no network can exceed "
                f"a_max = {found.verdict.a_max:.4g}: a = {made.a:.4g} is used"  # type: ignore[union-attr]
            )
        best = min(made.starts, key=lambda s: s.loss)
        if best.loss > 1e-9:
            found.notes.append(f"IPOPT: {best.explained.meaning}. {best.explained.remedy}")

    def certify(self, found: Findings) -> None:
        """Prove what can be proved; write design and certificate."""
        from necc_casadi.artifact import write_text
        from necc_casadi.certificate import certify

        assert_design = _made(found)
        with self.stage(found, "certify", "proving"):
            found.certificate = certify(
                assert_design, report=lambda stage, share: self.progress.say(f"proving: {stage}")
            )
        self.wrote(found, assert_design.save(self.out / "design.json"))
        self.wrote(found, write_text(self.out / "certificate.json", found.certificate.to_json()))

    def simulate(self, found: Findings) -> None:
        """Responses from random states of the domain."""
        from necc_casadi.simulation import random_states, simulate

        made = _made(found)
        with self.stage(found, "simulate", "simulating"):
            states = random_states(made, _RESPONSES, made.seed)
            found.responses = [simulate(made, x0) for x0 in states]

    def export(self, found: Findings) -> None:
        """The C controller."""
        import hashlib

        from necc_casadi.export import export_c

        certificate = found.certificate
        with self.stage(found, "export", "writing the C controller"):
            paths = export_c(
                _made(found),
                self.out / "c",
                real=self.options["real"],
                sample_time=self.options["sample_time"],
                certificate_hash=None
                if certificate is None
                else hashlib.sha256(certificate.to_json().encode()).hexdigest(),
                claims=[]
                if certificate is None
                else [c.statement for c in certificate.claims if c.holds],
            )
        for path in paths:
            self.wrote(found, path)

    def draw(self, found: Findings) -> None:
        """Figures, and the sweep over a."""
        made = _made(found)
        if self.options["sweep_a"] is not None:
            with self.stage(found, "sweep", "sweeping a"):
                found.sweep = self.sweep(found)
        if self.options["no_plots"]:
            return
        with self.stage(found, "figures", "drawing"):
            from necc_casadi import figures

            folder = self.out / "figures"
            drawn = {"lyapunov": figures.lyapunov_figure(made),
                     "responses": figures.responses_figure(made, found.responses)}
            if found.sweep:
                drawn["sweep"] = figures.sweep_figure(made, found.sweep)
            for name, figure in drawn.items():
                self.wrote(found, figures.write_figure(figure, folder / f"{name}.png"))

    def sweep(self, found: Findings) -> list[Any]:
        """One design for each value of a, in the same form."""
        from dataclasses import replace

        import numpy as np

        from necc_casadi.certificate import certify
        from necc_casadi.report import design_block
        from necc_casadi.figures import SweepPoint
        from necc_casadi.synthesis import design

        points = []
        options = _options(self.options, self.model)
        values = np.linspace(*self.options["sweep_a"])
        for index, a in enumerate(values):
            self.progress.say(f"sweeping a: {index + 1} of {len(values)}")
            made = design(
                self.model.loop, found.casimirs, found.verdict, found.x_star,
                replace(options, a=float(a), keep_a=True),
            )  # type: ignore[arg-type]
            block = design_block(made, certify(made, region=False))
            points.append(SweepPoint(
                a=float(a), loss=block["loss"], distance=block["distance"],
                bound_paper=block["bound_paper"], bound_rigorous=block["bound_rigorous"],
            ))
        return points

    def wrote(self, found: Findings, path: Path) -> None:
        """Remember a file, relative to OUT."""
        found.files.append(path.relative_to(self.out).as_posix())


def _made(found: Findings) -> Design:
    if found.design is None:
        raise RuntimeError("a stage ran before the design was made")
    return found.design


def _parameters(texts: Sequence[str]) -> dict[str, str]:
    result = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name.strip():
            raise OptionError("param", f"--param {text} is not NAME=VALUE", "Write --param k=4.")
        result[name.strip()] = value
    return result


def _target(model: Model, text: str | None) -> dict[Any, Any]:
    from necc_casadi.target import free_coordinates, parse_target, target_from_model

    if text is not None:
        return parse_target(model.loop.plant, text)
    if model.target is not None:
        return target_from_model(model.loop.plant, model.target)
    free, dimension = free_coordinates(model.loop.plant)
    names = ", ".join(map(str, free[:dimension])) or "none"
    raise OptionError(
        "usage",
        "no target: neither --target nor `target` in the model file",
        f"Say where to hold the plant, e.g. --target {names.split(',')[0]}=… (free: {names}).",
    )


def _options(given: dict[str, Any], model: Model) -> Options:
    from dataclasses import replace

    import numpy as np

    from necc_casadi.model_file import damping_matrix
    from necc_casadi.synthesis import Options, paper_options

    m = model.loop.plant.m
    options = paper_options(m) if given["paper"] else Options()
    if not given["paper"]:
        options = replace(options, D=model.D, Dc=model.Dc)
    chosen = {
        key: given[key]
        for key in ("hidden_k", "hidden_h", "activation", "casimir_form", "phi", "a")
        if given[key] is not None
    }
    for key, option in (("D", "damping"), ("Dc", "controller_damping")):
        if given[option] is not None:
            label = f"--{option.replace('_', '-')}"
            chosen[key] = damping_matrix(np.array(given[option]), m, label)
    return replace(
        options, seed=given["seed"], starts=given["starts"], verbose=given["debug"], **chosen
    )


def _model_notes(found: Findings) -> list[str]:
    notes = [
        f"{p.name} held at sampled points only: what rests on it is not proved"
        for p in found.loop.properties
        if not p.proved
    ]
    if found.casimirs is not None and found.casimirs.note:
        notes.append(found.casimirs.note)
    return notes


def check_writable(folder: Path) -> None:
    """Refuse early, before any work, where `folder` cannot be made or written.

    Raises
    ------
    OutputError
        Naming the folder.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(
            "output",
            f"{folder} cannot be written: {existing} is "
            + ("read-only" if existing.is_dir() else "not a folder"),
            "Choose a folder that can be written with --out.",
        )


@click.command("necc-simulate", cls=GroupedCommand)
@click.argument("out", type=click.Path(path_type=Path))
@_task("--x0", type=Numbers(), help="Plant state to start from, all states in order.  [default: "
       "the middle between target and domain edge]")
@_task("--xi0", type=Numbers(), help="Controller state to start from.  [default: ξ*]")
@_task("--time", "horizon", type=click.FloatRange(min=0, min_open=True), help="Horizon, s.")
@_output("--points", type=click.IntRange(2, 1_000_000), default=501, show_default=True,
         help="Number of output times.")
@_output("--csv", type=click.Path(path_type=Path, dir_okay=False),
         help="Write the response to a CSV file (- for stdout).")
@_output("--plot", type=click.Path(path_type=Path, dir_okay=False), help="Draw it to a PNG file.")
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
    from necc_casadi.artifact import Design, write_text
    from necc_casadi.simulation import domain_box, simulate

    made = Design.load(out)
    n, nc = made.loop.plant.n, made.loop.controller.nc
    x0 = options["x0"] or tuple((made.z_star + domain_box(made)[1])[:n] / 2)
    xi0 = options["xi0"] or tuple(made.xi_star)
    for label, given, size in (("--x0", x0, n), ("--xi0", xi0, nc)):
        if len(given) != size:
            raise OptionError(
                "usage",
                f"{label} has {len(given)} values, but there are {size} states",
                f"Give {size} numbers: {', '.join(made.loop.states[:n] if size == n else made.loop.controller.states)}.",
            )
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


def _response_json(made: Design, response: Any) -> dict[str, Any]:
    import math

    settling = response.settling_time
    return {
        "states": list(made.loop.states),
        "t_end": float(response.t[-1]),
        "z_end": response.z[-1].tolist(),
        "settling_time": settling if math.isfinite(settling) else None,
        "peak_input": response.peak_input,
        "complete": response.complete,
    }


def _response_text(made: Design, response: Any) -> str:
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


def design_command() -> None:
    """Entry point of ``necc-design``."""
    sys.exit(run(_design))


def simulate_command() -> None:
    """Entry point of ``necc-simulate``."""
    sys.exit(run(_simulate))
