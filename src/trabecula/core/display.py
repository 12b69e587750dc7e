"""How a notebook shows an Image: named here by the package's top level, so that the core knows no
pictures.
"""

from __future__ import annotations

import importlib
from typing import Any

html: str | None = None
"""A function that gives an Image as HTML, as "module:function"; None where no room of the package
draws.
"""


def as_html(image: Any) -> str | None:
    """Return the image as HTML, or None: then a notebook prints it in a line."""
    if html is None:
        return None
    module, _, name = html.partition(":")
    shown: str | None = getattr(importlib.import_module(module), name)(image)
    return shown
