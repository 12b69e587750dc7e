"""Settings of Sphinx. `docs/build.py` writes the generated pages first and then calls it."""

import json
from pathlib import Path

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


_FAILED = Path(__file__).parent / "_build" / "failed.json"


def show_failure(app, docname, source):
    """Say on top of a page which of its examples failed."""
    failed = json.loads(_FAILED.read_text(encoding="utf-8")) if _FAILED.exists() else {}
    why = failed.get(f"docs/{docname}.md")
    if why is not None:
        shown = "\n".join(line.rstrip() for line in why.splitlines())
        title = "An example of this page failed when the site was built"
        source[0] = f"~~~~{{error}} {title}\n\n```text\n{shown}\n```\n~~~~\n\n{source[0]}"


def setup(app):
    """Register what is done with every page as it is read."""
    app.connect("source-read", show_failure)
