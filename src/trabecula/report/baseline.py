"""The baseline of every method: a thresholded Gaussian field with the exemplar's fractions and
two-point function.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.image import Image, with_values
from trabecula.synth.api.registry import method

LARGEST = 128
"""Voxels a side: a larger one says nothing more."""


def gaussian_field(exemplar: Image) -> Image:
    """Generate a field, always of the same seed, as large as the exemplar but for `LARGEST`; of a
    2-D exemplar a 2-D one.
    """
    flat = exemplar.ndim == 2
    lifted = exemplar
    if flat:
        lifted = with_values(exemplar, exemplar.values[None], spacing=(1.0, *exemplar.spacing))
    shape = tuple(min(side, LARGEST) for side in lifted.shape)
    field = method("noise", exact=True).fit(lifted).generate(shape, seed=0)
    if not flat:
        return field
    return with_values(field, np.ascontiguousarray(field.values[0]), spacing=exemplar.spacing)
