"""What a format needs beside the bricks, and what it reports."""

from __future__ import annotations

from dataclasses import dataclass, field

from trabecula.core.recipe import Recipe
from trabecula.mesh.bricks.faces import FaceNodes
from trabecula.mesh.bricks.load_case import LoadCase


@dataclass(frozen=True, eq=False)
class ExportContext:
    """What is written beside nodes and bricks.

    Attributes
    ----------
    unit : str
    recipe : Recipe
    moduli : dict
        Name of a phase -> Young's modulus and Poisson's ratio.
    faces : FaceNodes, optional
    case : LoadCase, optional
    axis : int
        Of the flow.
    suffix : str
        Of the file.
    """

    unit: str
    recipe: Recipe
    moduli: dict[str, tuple[float, float]] = field(default_factory=dict)
    faces: FaceNodes | None = None
    case: LoadCase | None = None
    axis: int = 0
    suffix: str = ""
