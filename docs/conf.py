"""Sphinx configuration: `make docs`. Everything on the pages works without a network."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "ext"))

project = "pliant"
author = "The pliant developers"
project_copyright = "The pliant developers, Apache-2.0"
version = release = installed_version("pliant")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "gallery", "reference"]
myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
nitpicky = True
# Types in signatures have their pages elsewhere; links between pages are checked.
nitpick_ignore_regex = [("py:.*", ".*")]
suppress_warnings = ["ref.python"]  # `n` is a name of several classes
# Docstrings: Google's sections, names in single back-quotes, no types where the text has units.
default_role = "literal"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_numpy_docstring = False
napoleon_attr_annotations = False

html_theme = "furo"
html_title = f"pliant {version}"
html_copy_source = False
html_show_sourcelink = False
# Formulas are Unicode in plain blocks: no MathJax, no syntax colours.
highlight_language = "text"
