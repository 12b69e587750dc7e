"""Contours as text: SVG, a file for each layer, and Common Layer Interface, one for all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.layers.contours import signed_area

# of a line of Common Layer Interface
_INNER, _OUTER = 0, 1
_CLI_UNIT = 0.001  # millimetres


def svg_text(lines: Sequence[np.ndarray], width: float, height: float) -> str:
    """Return an SVG of closed lines (N, 2) in millimetres; y points up in the part, down in the
    file.
    """
    paths = " ".join(
        "M" + " L".join(f"{x:.4f},{height - y:.4f}" for x, y in line) + "Z" for line in lines
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 0 {width:.4f} {height:.4f}">\n'
        f'<path fill="#000" fill-rule="evenodd" d="{paths}"/>\n</svg>\n'
    )


def cli_header(size: Sequence[float], layers: int, label: str) -> str:
    """Return the header of Common Layer Interface 2.0 as text; `size` is (z, y, x) in
    millimetres.
    """
    z, y, x = (round(side / _CLI_UNIT) for side in size)
    return (
        "$$HEADERSTART\n$$ASCII\n"
        f"$$UNITS/{_CLI_UNIT:.8f}\n$$VERSION/200\n$$LABEL/1,{label}\n"
        f"$$DIMENSION/0,0,0,{x},{y},{z}\n$$LAYERS/{layers:06d}\n"
        "$$HEADEREND\n$$GEOMETRYSTART\n"
    )


def cli_layer(lines: Sequence[np.ndarray], top: float) -> str:
    """Return a layer whose upper side is at `top` millimetres."""
    text = [f"$$LAYER/{round(top / _CLI_UNIT)}\n"]
    for line in lines:
        points = np.rint(np.concatenate([line, line[:1]]) / _CLI_UNIT).astype(np.int64)
        turn = _OUTER if signed_area(line) > 0 else _INNER
        text.append(
            f"$$POLYLINE/1,{turn},{len(points)}," + ",".join(map(str, points.ravel())) + "\n"
        )
    return "".join(text)


CLI_END = "$$GEOMETRYEND\n"
