"""Presets of `bubbles`: materials by name.

Lengths are shares of the mean distance between bubbles, so that they hold in any unit; that
distance is in voxels until a density is given. Light to import: the registry reads the names.
"""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # A fine, uneven crumb, flattened as the loaf is, with a thin crust that the outer bubbles
    # follow.
    "bread": {
        "distance": 10.0,
        "thickness": 0.2,
        "spread": 0.45,
        "regularity": 0.7,
        "roughness": 0.4,
        "coalescence": 0.25,
        "time": 0.8,
        "flow": "elliptic",
        "flow_axis": "x",
        "randomness": 0.65,
        "silhouette_share": 1.5,
        "crust_share": 0.4,
    },
    # Large holes beside small ones, drawn out along the windings of the rolled dough; a thick
    # crust.
    "baguette": {
        "distance": 11.0,
        "thickness": 0.18,
        "spread": 0.55,
        "regularity": 0.5,
        "roughness": 0.5,
        "coalescence": 0.2,
        "time": 0.85,
        "flow": "roll",
        "flow_axis": "x",
        "randomness": 0.5,
        "silhouette_share": 1.5,
        "crust_share": 0.45,
    },
    # Open cells of one size, alike in all directions.
    "sponge": {
        "distance": 12.0,
        "thickness": 0.1,
        "spread": 0.25,
        "regularity": 0.9,
        "roughness": 0.3,
        "coalescence": 0.95,
        "porosity": 0.66,
    },
    # Round eyes that were stopped before they met, below a rind.
    "cheese": {
        "distance": 34.0,
        "thickness": 0.08,
        "spread": 0.35,
        "regularity": 0.7,
        "roughness": 0.15,
        "time": 0.4,
        "crust_share": 0.12,
    },
    # Fewer and uneven vesicles in much mass, a little flattened, some of them run together.
    "stone": {
        "thickness": 0.08,
        "spread": 0.6,
        "regularity": 0.2,
        "roughness": 0.6,
        "coalescence": 0.3,
        "porosity": 0.4,
        "flow": "horizontal",
        "randomness": 0.75,
    },
    # Closed polyhedral cells that have grown until they met.
    "foam": {
        "distance": 20.0,
        "thickness": 0.11,
        "spread": 0.12,
        "regularity": 0.8,
        "roughness": 0.0,
    },
    # Plates and rods between open cells, what is left of their walls; drawn out along the principal
    # axis.
    "bone": {
        "thickness": 0.2,
        "spread": 0.2,
        "regularity": 0.9,
        "roughness": 0.7,
        "coalescence": 0.82,
        "time": 0.72,
        "flow": "axial",
        "randomness": 0.6,
        "crust_share": 0.3,
    },
}
