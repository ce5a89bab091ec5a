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
autodoc_default_options = {"members": True}
default_role = "code"  # what docstrings put between single backticks
napoleon_google_docstring, napoleon_numpy_docstring = True, False


def _as_rst(app, what, name, obj, options, given):
    """Docstrings are plain text with Markdown's tables and headings: lay out both and indented formulas, and escape what
    means something to docutils."""
    # What stands before a colon of a constant's text, Napoleon would take for its type.
    lines = [line.replace(":", "∶") for line in given] if what in ("data", "attribute") else given
    found, in_table, before = [], False, ""
    for line in lines:
        if line.startswith("    ") and found and not found[-1].strip() and before[:1].strip() and before[0] not in "*-":
            found += ["::", ""]
        before = line if line.strip() else before
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
    given[:] = [re.sub(r"(?<!`)\*\*(\w+:)", r"\\*\\*\1", line) for line in found]


def setup(app):
    # Before Napoleon, which would take the arguments for its own.
    app.connect("autodoc-process-docstring", _as_rst, priority=400)
