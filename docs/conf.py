"""Sphinx's configuration: the site is built without network, and its pages fetch nothing from outside.

``sphinx-build --fail-on-warning docs build/site`` builds it; `_site/` has its two extensions.
"""

import importlib.metadata
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_site")]

project = "scso_nlp"
author = "the scso_nlp developers"
release = importlib.metadata.version("scso_nlp")
copyright = "the scso_nlp developers, Apache-2.0"  # Sphinx calls it so

extensions = [
    "myst_nb",  # Markdown pages, and notebooks with the outputs that they are committed with
    "sphinx.ext.autodoc",
    "numpydoc",  # docstrings' own format; napoleon takes units and shapes for names to link
    "mathml",
    "generated_pages",
]
exclude_patterns = ["_site", "generated/result_files.md"]  # the second is part of reference/files.md
html_theme = "furo"
html_title = "scso_nlp"
html_static_path = ["_site/static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False

nb_execution_mode = "off"
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings give types with shapes and units
numpydoc_show_class_members = False  # autodoc lists them
numpydoc_class_members_toctree = False
