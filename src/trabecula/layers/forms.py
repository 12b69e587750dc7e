"""Forms of layers: what is written for which printer, with its usual pitch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trabecula.core.checks import check_name


@dataclass(frozen=True)
class LayerForm:
    """A form in which layers are written.

    Parameters
    ----------
    pitch : (z, y, x), optional
        Usual layer thickness, row and column pitch in millimetres; None: the volume's voxels.
    suffix : str
        Of a layer's file; of the one file where `single`.
    note : str
        One line for the docs and the command line.
    single : bool
        All layers are in one file.
    """

    pitch: tuple[float, float, float] | None
    suffix: str
    note: str
    single: bool = False


FORMS: Mapping[str, LayerForm] = {
    "polyjet": LayerForm(
        (0.027, 25.4 / 300, 25.4 / 600),
        ".png",
        "PNG slices with a colour for each material, for material jetting (GrabCAD Voxel Print)",
    ),
    "dlp": LayerForm(
        (0.05, 0.05, 0.05), ".png", "grey PNG masks, anti-aliased, for resin cured by light"
    ),
    "svg": LayerForm(None, ".svg", "contours in millimetres, an SVG for each layer"),
    "cli": LayerForm(
        None, ".cli", "contours in one file, Common Layer Interface 2.0 as text", single=True
    ),
}
"""The pitch is the usual one: a printer's own is given with `pitch`."""


def form_of(name: str) -> LayerForm:
    """Return a form by its name.

    Raises
    ------
    UnknownNameError
        There is none of this name.
    """
    check_name(name, FORMS, name="form of layers")
    return FORMS[name]
