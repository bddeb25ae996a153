"""Formulas as MathML, made while the site is built: no script and no font is loaded to read it."""

from __future__ import annotations

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx


def visit_math(self: nodes.NodeVisitor, node: nodes.math) -> None:
    """A formula within a line; a list of formulas may be broken after a comma."""
    parts = node.astext().split(r",\ ")
    self.body.append(", ".join(str(convert(part, display="inline")) for part in parts))
    raise nodes.SkipNode


def visit_math_block(self: nodes.NodeVisitor, node: nodes.math_block) -> None:
    """A formula on lines of its own."""
    self.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Take the place of Sphinx's own renderer."""
    app.add_html_math_renderer(
        "mathml", inline_renderers=(visit_math, None), block_renderers=(visit_math_block, None)
    )
    app.connect("config-inited", lambda _, config: setattr(config, "html_math_renderer", "mathml"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
