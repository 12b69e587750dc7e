"""An Image in a notebook: a line, slices through its middle and, of a volume of labels, a still."""

from __future__ import annotations

import base64
import io
from html import escape

from trabecula.core.image import Image
from trabecula.view.slices import slices
from trabecula.view.still import render

_LARGEST = 256**3
"""Voxels up to which a still is made without being asked for: above, a cell would wait for its
picture.
"""


def as_html(image: Image) -> str:
    """Return the image as HTML without script."""
    pictures = [("slices", slices(image, side=240))]
    drawn = (
        image.kind == "labels" and image.ndim == 3 and any(name != "void" for name in image.phases)
    )
    if drawn and image.values.size <= _LARGEST:
        pictures.append(("still", render(image, size=(400, 300))))
    shown = "".join(
        f'<img alt="{name}" src="data:image/png;base64,{_png(picture)}" style="max-width:100%">'
        for name, picture in pictures
    )
    return f"<div><code>{escape(repr(image))}</code><br>{shown}</div>"


def _png(picture: Image) -> str:
    from PIL import Image as Pillow

    data = io.BytesIO()
    Pillow.fromarray(picture.values).save(data, format="PNG")
    return base64.b64encode(data.getvalue()).decode("ascii")
