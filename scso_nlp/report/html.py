"""HTML pages without network or scripts: templates in which everything is escaped, figures as data.

``base.html`` is the frame and the style of every page, ``parts.html`` has what their tables share.
"""

from __future__ import annotations

import base64
import io
import os
import re
from typing import Any

import jinja2
from matplotlib.figure import Figure

from scso_nlp.files import write_whole

#: A figure larger than this as a vector is embedded as pixels instead [bytes].
LARGEST_VECTOR = 400_000


def _printable(value: Any) -> Any:
    """Drop the characters that HTML does not allow; what is HTML already stays."""
    return value if hasattr(value, "__html__") else re.sub(r"[\x00-\x08\x0b-\x1f\x7f]", "", str(value))


_TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("scso_nlp.report", "."),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    finalize=_printable,
    keep_trailing_newline=True,
)


def render(template: str, **values: object) -> str:
    """Fill a template.

    Parameters
    ----------
    template : str
        File beside this one.
    **values : object
        All that it names.

    Returns
    -------
    str
        HTML.
    """
    return _TEMPLATES.get_template(template).render(**values)


def write_page(path: str | os.PathLike[str], text: str) -> None:
    """Write a page, whole or not at all."""
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def figure_address(figure: Figure) -> str:
    """Turn a figure into the address of an image: a vector, or pixels where that would be large."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    if buffer.tell() <= LARGEST_VECTOR:
        return address("image/svg+xml", buffer.getvalue())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return address("image/png", buffer.getvalue())


def address(kind: str, content: bytes) -> str:
    """Turn a file of a MIME type into its own address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
