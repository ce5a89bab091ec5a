"""Configuration of Sphinx, for `make docs`."""

import inspect

from fbl_gym import TwoLinkArmEnv, __version__

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
myst_enable_extensions = ["dollarmath", "amsmath", "substitution"]
myst_substitutions = {"datasheet": inspect.getdoc(TwoLinkArmEnv)}  # the docstring is in Markdown, as Gymnasium's are
myst_heading_anchors = 3
exclude_patterns = ["paper/claims.md", "_build"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
default_role = "code"  # docstrings put code between single backticks
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_ivar = True  # fields of a dataclass are documented once, under Attributes
