"""How figures look, and their bytes: the same for the same figure, on any day."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from necc_casadi.cases import Format
from necc_casadi.files import write_text

__all__ = [
    "INK",
    "MINIMUM",
    "TARGET",
    "UNSETTLED",
    "Drawing",
    "inline_svg",
    "picture",
    "styled",
    "write_figure",
]


#: Colours: what moves, the target, what is proved with its minimum, what does not settle.
INK, TARGET, MINIMUM, UNSETTLED = "#1f4e79", "#d9730d", "#2e7d32", "#a8324a"


#: What a file says of itself: nothing that changes from day to day.
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"Creator": "necc-casadi", "Producer": None, "CreationDate": None},
    "svg": {"Creator": "necc-casadi", "Date": None},
}


#: Inches from which on a figure has panels side by side.
_WIDE = 7.5


@lru_cache(maxsize=1)
def _style() -> Any:
    """The one style file."""
    place = resources.files(f"{__package__}.templates").joinpath("necc.mplstyle")
    with resources.as_file(place) as path:
        return mpl.rc_params_from_file(path, use_default_template=False)


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Figures that are made or written in the block have the style of the package."""
    with mpl.rc_context(_style()):
        yield


class Drawing(Figure):
    """A figure that a notebook shows without a window system."""

    def _repr_png_(self) -> bytes:
        return picture(self, "png")


def write_figure(figure: Figure, path: Path, dpi: int = 120) -> Path:
    """Write a figure whole or not at all; PDF or SVG by the name, else PNG."""
    kinds: dict[str, Format] = {".pdf": "pdf", ".svg": "svg"}
    return write_text(path, picture(figure, kinds.get(path.suffix.lower(), "png"), dpi))


def picture(figure: Figure, kind: Format, dpi: int = 120) -> bytes:
    """The bytes of a figure in a format; dots per inch of a PNG, and of a surface in the others."""
    buffer = io.BytesIO()
    options: dict[str, Any] = {"pil_kwargs": {"compress_level": 4}} if kind == "png" else {}
    with styled():
        if figure.get_layout_engine() is not None:  # a second drawing would move it a little
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
        _canvas(figure, kind)
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=_METADATA[kind], **options)
    return buffer.getvalue()


def _canvas(figure: Figure, kind: Format) -> None:
    """Give a figure the canvas of a format; only that one is loaded."""
    if kind == "png":
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        FigureCanvasAgg(figure)
    elif kind == "pdf":
        from matplotlib.backends.backend_pdf import FigureCanvasPdf

        FigureCanvasPdf(figure)
    else:
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        FigureCanvasSVG(figure)


def inline_svg(figure: Figure, name: str, title: str) -> str:
    """A figure as an element of a page: its names begin with `name`, no two pictures share one."""
    text = picture(figure, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'(href="|url\()#', rf"\g<1>#{name}-", text)
    head, rest = text.split(">", 1)
    box = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', head)
    inches = float(box[1]) / 72 if box else 0.0
    wide = ' class="wide"' if inches > _WIDE else ""
    size = f'{box[0]} style="max-width: {inches:.4g}in"{wide}' if box else ""
    namespaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    return f'<svg {namespaces} role="img" aria-label="{title}" {size}>{rest.rstrip()}'
