"""Sphinx: `make docs`."""

import re

from fbl_gym import __version__

project, author, release = "fbl-gym", "The fbl-gym authors", __version__
copyright = author
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_title = f"fbl-gym {release}"
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
exclude_patterns = ["paper/claims.md", "_build"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring, napoleon_numpy_docstring = True, False


def _as_rst(app, what, name, obj, options, lines):
    """Docstrings are plain text with Markdown's tables and headings: lay out both, and escape what means
    something to docutils."""
    found, in_table = [], False
    for line in lines:
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("## "):
            line = f".. rubric:: {line[3:]}"
        if not line.startswith("|"):
            found += ["", line.replace("|", "\\|")] if in_table else [line.replace("|", "\\|")]
            in_table = False
        elif not set(cells[0]) <= set("-: "):
            found += [] if in_table else ["", ".. list-table::", "   :header-rows: 1", ""]
            found += [f"   {'* -' if i == 0 else '  -'} {cell}" for i, cell in enumerate(cells)]
            in_table = True
    lines[:] = [re.sub(r"(?<!`)\*\*(\w+:)", r"\\*\\*\1", line) for line in found]


def setup(app):
    # Before Napoleon, which would take the arguments for its own.
    app.connect("autodoc-process-docstring", _as_rst, priority=400)
