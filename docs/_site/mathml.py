"""Formulas as MathML, made at build time by docutils' own converter: no JavaScript, no fonts to fetch."""

import html
import re

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_LOG = logging.getLogger(__name__)

#: What docutils does not read as LaTeX does, and how to say it to docutils.
_REWRITTEN = (
    (
        re.compile(r"\\([bB]igg?)(?=\s*(?:[(\[]|\\\{))"),
        r"\\\1l",
    ),  # sizes of delimiters, known with a side only
    (re.compile(r"\\([bB]igg?)(?=\s*(?:[)\]]|\\\}))"), r"\\\1r"),
    (re.compile(r"(\\[dt]?frac)(\d)"), r"\1{\2}"),  # \frac12: digits are taken together
    (re.compile(r"(\\[dt]?frac\{\d\})(\w)"), r"\1{\2}"),
    (re.compile(r"(\\(?:tilde|bar|ddot|dot|hat)\s*(?:\\[a-zA-Z]+|\w))_"), r"\1{}_"),  # no limits of accents
)


def mathml(source: str, is_block: bool) -> str:
    r"""Convert LaTeX to MathML.

    >>> mathml(r"\tfrac12\big(a\big)", is_block=False).startswith("<math")
    True
    """
    for pattern, replacement in _REWRITTEN:
        source = pattern.sub(replacement, source)
    return str(tex2mathml(source, as_block=is_block))


def _visit(translator, node: nodes.Element, is_block: bool) -> None:
    source = node.astext()
    try:
        formula = mathml(source, is_block)
    except MathError as error:
        _LOG.warning("formula %r: %s", source, error, location=node)
        formula = f"<code>{html.escape(source)}</code>"
    tag = "div" if is_block else "span"
    anchors = "".join(f' id="{name}"' for name in node["ids"][:1])
    translator.body.append(f'<{tag} class="math"{anchors}>{formula}</{tag}>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda self, node: _visit(self, node, is_block=False), None),
        block_renderers=(lambda self, node: _visit(self, node, is_block=True), None),
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
