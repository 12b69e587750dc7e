"""Settings of Sphinx. `docs/build.py` writes the generated pages first and then calls it."""

import json
import sys
from pathlib import Path

import trabecula

_DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(_DOCS))

from steps import notebooks  # noqa: E402

project = "trabecula"
author = "The trabecula developers"
copyright = author
release = version = trabecula.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "steps", "made"]
html_theme = "furo"
html_title = f"trabecula {release}"
html_static_path = ["_static"]
html_extra_path = [str(_DOCS / notebooks.MADE / "live")]
html_css_files = ["wide.css"]
html_theme_options = {"navigation_with_keys": True}
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


_FAILED = _DOCS / "_build" / "failed.json"


def show_failure(app, docname, source):
    """Say on top of a page which of its examples failed."""
    failed = json.loads(_FAILED.read_text(encoding="utf-8")) if _FAILED.exists() else {}
    why = failed.get(f"docs/{docname}.md")
    if why is not None:
        shown = "\n".join(line.rstrip() for line in why.splitlines())
        title = "An example of this page failed when the site was built"
        source[0] = f"~~~~{{error}} {title}\n\n```text\n{shown}\n```\n~~~~\n\n{source[0]}"


def show_outputs(app, docname, source):
    """Put into a tutorial what its cells gave, and into the list of tutorials that of the data."""
    folder, _, name = docname.partition("/")
    if folder == notebooks.FOLDER and name != "index":
        made = _DOCS / notebooks.MADE / folder / name
        source[0] = notebooks.with_outputs(source[0], made, name)
    source[0] = source[0].replace("{{ data_sets }}", notebooks.data_sets_table())


def setup(app):
    """Register what is done with every page as it is read."""
    app.connect("source-read", show_outputs)
    app.connect("source-read", show_failure)
