"""Settings of Sphinx. `docs/build.py` writes the generated pages first and then calls it."""

import trabecula

project = "trabecula"
author = "The trabecula developers"
copyright = author
release = version = trabecula.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "steps"]
html_theme = "furo"
html_title = f"trabecula {release}"
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_copy_source = False

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

default_role = "code"  # docstrings mark names as `porosity`, as Markdown does
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say types, with shapes and units
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

# A word of a shape, such as (ndim, 3), may be an attribute of several classes: it is meant as a
# word.
suppress_warnings = ["ref.python"]
