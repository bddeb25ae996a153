"""Write docs/gallery.md from the examples, and the pictures of it and of the README.

    python docs/make_gallery.py [NAME …]

Everything on the page comes from a run of the tool; nothing is typed in. With names of examples
only these are run, and what the page says of the others stays; `readme` runs the README's plants.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import sympy as sp

from necc_casadi import Certificate, certify, design
from necc_casadi.model.control_affine import ControlAffine
from necc_casadi.model.model_file import load_model
from necc_casadi.model.modulated import Modulated, System
from necc_casadi.pipeline.request import Request
from necc_casadi.pipeline.run import run_design
from necc_casadi.report.findings import Findings, attracts, global_claim, region_claim
from necc_casadi.report.gallery import from_the_boundary
from necc_casadi.report.landscape_figure import landscape_figure
from necc_casadi.report.methods import method_rows
from necc_casadi.report.region_figure import region_figure
from necc_casadi.report.responses_figure import responses_figure
from necc_casadi.report.style import write_figure
from necc_casadi.report.values import percent
from necc_casadi.synthesis.options import Options
from necc_casadi.verdict.verdict import Verdict

DOCS = Path(__file__).parent
PAGE = DOCS / "gallery.md"
IMAGES = DOCS / "images"
EXAMPLES = DOCS.parent / "examples"
#: Targets besides the model file's own.
TARGETS: dict[str, list[str | None]] = {
    "pendulum": ["pi/4", "pi"],
    "cart_pole": [None, "x=1,theta=0,p_x=0,p_theta=0"],
    "tora": [None, "q=0,theta=pi/2,p_q=0,p_theta=0"],
}
#: Claims that hold for every design of the tool: said once, not for each plant.
COMMON = ("casimir", "structure", "slope", "damping", "decrease")
INTRO = """# Gallery

Each plant is a short model file in `examples/`. This page is written by
`python docs/make_gallery.py`; nothing on it is typed in.

Every certified design below also has proofs that its Casimirs are Casimirs, that J, R, Jc, Rc, D
and Dc have the structure that the theory asks for, and that V never increases along the
continuous-time, unsaturated loop. *Proved region* is how much of the height of what ends it a
component of {V ≤ c} around z̄ is proved to have, or the whole space: every solution from it
converges (*attracts*), or at least none leaves it (*invariant*). *Sampled* is the share of random
states of the domain, momenta at rest, that lie in it; *simulated* is the share of them from which
the loop converges in simulation, – where the target can only be stable. *Global* is what
`--global` proves: that every solution converges, from anywhere. Coordinates of a target that are
not listed are 0.

Why a design is not global: *the invariant sets are not proved …* means that V could stop
decreasing along a motion that no input and no dissipation feels, or that J, R or G depend on the
state, which that proof does not cover; the design is then proved to attract locally and to keep Ω
invariant, no more.
"""
HEADER = (
    "| plant | target | held by | proved stability | proved region | sampled | simulated "
    "| limited by "
    "| global with `--global` |\n|---|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Run:
    """One plant at one target."""

    path: Path
    number: int
    found: Findings
    everywhere: str  # whether --global proves a global claim, or why not

    @property
    def target(self) -> str:
        """The coordinates that are not zero, TeX."""
        parts = [f"{sp.latex(s)} = {sp.latex(v)}" for s, v in self.found.x_star.items() if v != 0]
        return "$" + ",\\ ".join(parts) + "$" if parts else "the origin"

    @property
    def picture(self) -> str:
        """Stem of its pictures."""
        return f"{self.path.stem}-{self.number}"


@dataclass(frozen=True)
class Entry:
    """What the page says of one plant."""

    rows: tuple[str, ...]  # of the table
    section: str


def main(names: Sequence[str]) -> None:
    """Run the examples of these names, or all, at every target and write the page with figures."""
    entries = written_entries() if names else {}
    for path in sorted(EXAMPLES.glob("*.py")):
        if not names or path.stem in names:
            runs = runs_of(path)
            title = runs[0].found.system.name
            entries[title] = Entry(tuple(map(row, runs)), section(path, runs))
            write_page(entries)
    if not names or "readme" in names:
        readme_pictures()
    pages = (*DOCS.glob("*.md"), DOCS.parent / "README.md")
    shown = "".join(page.read_text(encoding="utf-8") for page in pages)
    for picture in IMAGES.glob("*.png"):
        if f"images/{picture.name})" not in shown:
            picture.unlink()


def write_page(entries: Mapping[str, Entry]) -> None:
    """The page, in the order of the model files, as far as it has come."""
    titles = [load_model(path).system.name for path in sorted(EXAMPLES.glob("*.py"))]
    shown = [entries[title] for title in titles if title in entries]
    rows = [line for entry in shown for line in entry.rows]
    text = "\n".join([INTRO, HEADER, *rows, "", *(entry.section for entry in shown)])
    PAGE.write_text(text, encoding="utf-8")


def written_entries() -> dict[str, Entry]:
    """What the page says now, by title."""
    text = PAGE.read_text(encoding="utf-8")
    sections = {part.split("\n", 1)[0]: "## " + part for part in text.split("\n## ")[1:]}
    rows: dict[str, list[str]] = {}
    for line in text.splitlines():
        named = re.match(r"\| \[(.*?)\]\(#", line)
        if named:
            rows.setdefault(named[1], []).append(line)
    return {title: Entry(tuple(rows.get(title, ())), part) for title, part in sections.items()}


def runs_of(path: Path) -> list[Run]:
    """One plant at all its targets."""
    result = []
    for number, target in enumerate(TARGETS.get(path.stem, [None])):
        with tempfile.TemporaryDirectory() as folder:
            request = Request(path, Path(folder) / "design", target=target, plots=False)
            found = run_design(request, lambda _: None)
        result.append(Run(path, number, found, global_outcome(path, found)))
    return result


def global_outcome(path: Path, found: Findings) -> str:
    """What the certificate says of a design with ``--global``."""
    if found.certificate is None:
        return "–"
    method, certificate = found.method, found.certificate
    if method.verdict.stability == "stable":
        return "no: this target cannot be made to attract"
    if certificate.is_global:
        return "**yes**, also without `--global`"
    if method.name == "interconnection":
        model = load_model(path)
        options = Options(convex=True, D=model.D, Dc=model.Dc)
        certificate = certify(
            design(method.loop, method.casimirs, method.verdict, found.x_star, options)
        )
        if certificate.is_global:
            return "**yes**"
    claims = {claim.name: claim.statement for claim in certificate.claims}
    if "global" not in claims:
        return "no: nothing is proved of stability"
    return "no: " + claims["global"].removeprefix("no global claim: ")


def row(run: Run) -> str:
    """One line of the table."""
    found, certificate = run.found, run.found.certificate
    name = found.system.name
    link = f"[{name}](#{name.lower().replace(' ', '-')})"
    if certificate is None:
        cells = [f"refused: `{found.found.published.verdict.reason}`", *["–"] * 6]
    else:
        share, sampled = found.simulated_share, found.domain_share
        aims = certificate.stability == "asymptotic"
        cells = [
            found.method.name,
            certificate.stability or "none",
            proved_region(certificate),
            "–" if sampled is None else f"{100 * sampled:.3g} %",
            "–" if not aims else "not known" if share is None else f"{100 * share:.3g} %",
            certificate.limited_by or "–",
            run.everywhere,
        ]
    return f"| {' | '.join([link, run.target, *cells])} |"


def proved_region(certificate: Certificate) -> str:
    """The whole space, or how much of the height of what ends the region; and what follows."""
    whole, region = global_claim(certificate), region_claim(certificate)
    claim = whole if whole is not None and whole.holds else region
    if claim is None or not claim.holds:
        return "none"
    kind = "attracts" if attracts(claim) else "invariant"
    if claim is whole:
        return f"the whole space, {kind}"
    return f"{percent(certificate.obstacle_share, 3)} of the height, {kind}"


def section(path: Path, runs: list[Run]) -> str:
    """One plant: its equations, then what happens at each target."""
    plant = load_model(path).system
    rows = [f"## {plant.name}\n", f"`examples/{path.name}`. {summary_of(path)}\n"]
    if not isinstance(plant, ControlAffine):
        rows.append(f"$$H = {sp.latex(plant.H)}$$\n")
    if plant.n <= 6:
        structure = structure_of(plant)
        shown = ",\\quad ".join(f"{k} = {sp.latex(sp.Matrix(v))}" for k, v in structure.items())
        rows.append(f"$$x = ({', '.join(map(sp.latex, plant.x))}),\\quad {shown}$$\n")
    return "\n".join(rows + [outcome(run) for run in runs])


def structure_of(plant: System) -> dict[str, sp.MatrixBase]:
    """What the model file gives beside H."""
    if isinstance(plant, ControlAffine):
        return {"f": plant.f, "G": plant.g}
    structure = {"J": plant.J, "R": plant.R, "G": plant.G}
    return structure | ({"E": plant.E} if isinstance(plant, Modulated) else {})


def summary_of(path: Path) -> str:
    """First line of the model file's docstring."""
    return path.read_text(encoding="utf-8").split('"""')[1].strip().split("\n")[0]


def outcome(run: Run) -> str:
    """Casimirs, verdict, what is proved, how far Ω reaches, and what the closed loop does."""
    found = run.found
    rows = [f"### {found.system.name}, target {run.target}\n"]
    published = found.found.published
    if published is not None:
        casimirs = "; ".join(f"${sp.latex(c)}$" for c in published.casimirs.functions) or "none"
        count = f"{len(published.casimirs.functions)} of {published.casimirs.generic_count}"
        rows.append(f"- Casimirs of the published loop: {casimirs} ({count})")
        rows.append(f"- Verdict on it: {verdict_text(published.verdict)}")
    methods = [(label, text.replace("*", r"\*")) for label, text in method_rows(found)]
    rows += [f"- {label or '…'}: {text}" for label, text in methods]
    if found.design is None or found.certificate is None:
        return "\n".join(rows) + "\n"
    for claim in found.certificate.claims:
        if claim.name not in (*COMMON, "global"):
            rows.append(f"- {'Proved' if claim.holds else '**Not proved**'}: {claim.statement}")
    rows.append(f"- Global with `--global`: {run.everywhere}\n")
    pictures = {"closed-loop responses": responses_figure(found.design, found.responses)}
    level = found.certificate.level
    if level is not None:
        rows.append(reach(found) + "\n")
        pictures["proved region"] = region_figure(
            found.design,
            level,
            from_the_boundary(found.design, found.certificate),
            found.certificate.reach,
            found.certificate.obstacle,
        )
    landscape = landscape_figure(found.design, found.certificate)
    if landscape is not None:
        pictures["least V over the other states: landscape"] = landscape
    for name, figure in pictures.items():
        picture = f"{run.picture}-{name.split()[-1]}.png"
        write_figure(figure, IMAGES / picture, dpi=70)
        rows.append(f"![{found.system.name}: {name}](images/{picture})\n")
    return "\n".join(rows)


def reach(found: Findings) -> str:
    """A table of how far Ω reaches in each state."""
    made, units = found.design, found.system.units
    lines = ["| state | target | on Ω, proved |", "|---|---|---|"]
    for name, star in zip(made.loop.states, made.z_star, strict=True):
        side = found.certificate.reach[name]
        unit = f" [{units[name]}]" if name in units else ""
        star = 0.0 if np.isclose(star, 0, atol=1e-12) else star
        shown = "any" if side is None else f"{side[0]:.3g} … {side[1]:.3g}"
        lines.append(f"| {name}{unit} | {star:.4g} | {shown} |")
    return "\n".join(lines)


def verdict_text(verdict: Verdict) -> str:
    """The verdict in one sentence."""
    if not verdict.assignable:
        return f"**{verdict.reason}**. {verdict.explanation}"
    ceiling = "no ceiling on a" if verdict.a_max is None else f"a below {verdict.a_max:.3g}"
    witness = f" ({verdict.witness})" if verdict.witness else ""
    return f"**assignable**, {ceiling}, best class: {verdict.stability}{witness}"


def readme_pictures() -> None:
    """The README's pictures: the pendulum as it is designed there, and a region that ends."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        requests = {
            "pendulum": Request(EXAMPLES / "pendulum.py", out / "a", target="pi/4", compare=True),
            "joint": Request(EXAMPLES / "robot_joint.py", out / "b"),
            "paper": Request(
                EXAMPLES / "pendulum.py",
                out / "c",
                target="pi/4",
                paper=True,
                sweep_a=(0.1, 1.0, 10),
            ),
        }
        shown = {
            "pendulum": ("lyapunov", "responses", "step", "loop"),
            "joint": ("region", "landscape"),
            "paper": ("sweep",),
        }
        for name, request in requests.items():
            run_design(request, lambda _: None)
            for figure in shown[name]:
                drawn = request.out / "figures" / f"{figure}.png"
                shutil.copyfile(drawn, IMAGES / f"readme-{name}-{figure}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
