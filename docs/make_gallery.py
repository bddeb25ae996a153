"""Write docs/gallery.md from the examples: equations, Casimirs, verdict and closed loop of each.

    python docs/make_gallery.py

Everything on the page comes from a run of the tool; nothing is typed in.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import sympy as sp

from necc_casadi.figures import responses_figure, write_figure
from necc_casadi.model_file import load_model
from necc_casadi.pipeline import Request, run_design
from necc_casadi.report import Findings

DOCS = Path(__file__).parent
EXAMPLES = DOCS.parent / "examples"
#: Targets besides the model file's own.
TARGETS: dict[str, list[str | None]] = {
    "pendulum": ["pi/4", "pi"],
    "cart_pole": [None, "x=1,theta=0,p_x=0,p_theta=0"],
    "tora": [None, "q=0,theta=pi/2,p_q=0,p_theta=0"],
}


def main() -> None:
    """Run every example at every target and write the page with its figures."""
    sections = [section(path) for path in sorted(EXAMPLES.glob("*.py"))]
    intro = (
        "# Gallery\n\nEach plant is a short model file in `examples/`. This page is written by "
        "`python docs/make_gallery.py`.\n"
    )
    (DOCS / "gallery.md").write_text("\n".join([intro, *sections]), encoding="utf-8")


def section(path: Path) -> str:
    """One plant: its equations, then a paragraph per target."""
    plant = load_model(path).loop.plant
    rows = [
        f"## {plant.name}\n",
        f"`examples/{path.name}`. {summary_of(path)}\n",
        f"$$H = {sp.latex(plant.H)}$$\n",
    ]
    if plant.n <= 6:
        structure = {"J": plant.J, "R": plant.R, "G": plant.G}
        shown = ",\\quad ".join(f"{k} = {sp.latex(sp.Matrix(v))}" for k, v in structure.items())
        rows.append(f"$$x = ({', '.join(map(sp.latex, plant.x))}),\\quad {shown}$$\n")
    for index, target in enumerate(TARGETS.get(path.stem, [None])):
        rows.append(outcome(path, target, index))
    return "\n".join(rows)


def summary_of(path: Path) -> str:
    """First line of the model file's docstring."""
    return path.read_text(encoding="utf-8").split('"""')[1].strip().split("\n")[0]


def outcome(path: Path, target: str | None, index: int) -> str:
    """Casimirs, verdict, and what the closed loop does."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "design"
        found = run_design(Request(path, out, target=target, plots=False), lambda _: None)
    at = ", ".join(f"{s} = {sp.sstr(v)}" for s, v in found.x_star.items() if v != 0) or "the origin"
    casimirs = "; ".join(f"${sp.latex(c)}$" for c in found.casimirs.functions) or "none"
    rows = [
        f"**Target {at}.** Casimirs: {casimirs} ({len(found.casimirs.functions)} of "
        f"{found.casimirs.generic_count}). {verdict_text(found)}\n"
    ]
    if found.design is not None:
        name = f"{path.stem}-{index}.png"
        figure = responses_figure(found.design, found.responses)
        write_figure(figure, DOCS / "images" / name, dpi=70)
        held = [c.statement for c in found.certificate.claims if c.holds and c.name != "casimir"]
        rows += [f"Proved: {'; '.join(held)}.\n", f"![closed-loop responses](images/{name})\n"]
    return "\n".join(rows)


def verdict_text(found: Findings) -> str:
    """The verdict in one sentence."""
    verdict = found.verdict
    if not verdict.assignable:
        return f"Verdict: **{verdict.reason}**. {verdict.explanation}"
    ceiling = "no ceiling on a" if verdict.a_max is None else f"a below {verdict.a_max:.3g}"
    witness = f" ({verdict.witness})" if verdict.witness else ""
    return f"Verdict: **assignable**, {ceiling}, best class: {verdict.stability}{witness}."


if __name__ == "__main__":
    main()
