"""How the documentation is built: `make docs`, without a network, every warning an error."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs" / "_ext")]

project = "gapfinder"
author = "The gapfinder authors"
project_copyright = author
release = version = "0.1.0"

extensions = ["sphinx.ext.autodoc", "numpydoc", "myst_parser", "docstrings", "mathml", "printed"]
exclude_patterns = ["_ext"]
nitpicky = False

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "gapfinder"
html_copy_source = False
html_show_sphinx = False

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["config.cache"]

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
