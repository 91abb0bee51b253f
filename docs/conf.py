"""Sphinx configuration: `make docs`. Everything on the pages works without a network."""

from importlib.metadata import version as installed_version

project = "pliant"
author = "The pliant developers"
project_copyright = "The pliant developers, Apache-2.0"
version = release = installed_version("pliant")

extensions = ["myst_parser"]
myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
nitpicky = True

html_theme = "furo"
html_title = f"pliant {version}"
html_copy_source = False
html_show_sourcelink = False
# Formulas are Unicode in plain blocks: no MathJax, no syntax colours.
highlight_language = "text"
