"""The samples: always the same voxels, of the porosity that they claim, in one piece."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.errors import UnknownNameError
from trabecula.exemplar.samples import SAMPLES

GOLDEN = {
    "bone": "b14d3b524b335e20f6c5d01ff7eb519134da20312a43adf41ba08d13ebfc4fc2",
    "cells": "bf8b4ee6e080c7ffb7375c6bb606416ef2b0693c27b1bc6a34282299cd4d2dba",
    "foam": "4df4839c75769cb437aa26bad054b3134ac6e1202e274ee87dcbbe1481989987",
}


@pytest.fixture(scope="module")
def made(bone):
    return {"bone": bone, "foam": tb.sample("foam"), "cells": tb.sample("cells")}


def test_their_names():
    assert set(tb.samples()) == set(SAMPLES) == set(GOLDEN)
    with pytest.raises(UnknownNameError, match="unknown sample 'bones': did you mean 'bone'"):
        tb.sample("bones")


@pytest.mark.parametrize("name", GOLDEN)
def test_voxels_are_golden(made, name):
    assert digest(made[name].values) == GOLDEN[name]


@pytest.mark.whole
def test_threads_do_not_matter(bone):
    with tb.threads(2):
        assert digest(tb.sample("bone").values) == digest(bone.values)


@pytest.mark.parametrize("name", GOLDEN)
def test_what_they_claim(made, name):
    image, claim = made[name], SAMPLES[name]
    assert (
        image.shape == (96, 96, 96) and image.kind == "labels" and image.phases == ("void", "solid")
    )
    assert image.spacing == (claim.spacing,) * 3 and image.unit == claim.unit
    assert int(image.values.sum()) == pytest.approx(image.values.size * (1 - claim.porosity), abs=3)
    assert image.recipe.steps[0]["verb"] == "sample" and image.recipe.steps[0]["name"] == name
    assert image.recipe.steps[0]["sha256"] == digest(image.values)


@pytest.mark.parametrize("name", GOLDEN)
def test_one_piece_that_goes_through(made, name):
    ndimage = pytest.importorskip("scipy.ndimage")
    solid = made[name].values == 1
    pieces, _ = ndimage.label(solid)
    sizes = np.bincount(pieces.ravel())[1:]
    assert sizes.max() >= 0.98 * sizes.sum()
    body = pieces == 1 + sizes.argmax()
    assert all(body.take(0, axis).any() and body.take(-1, axis).any() for axis in range(3))
    void_pieces = ndimage.label(~solid)[0]
    largest = np.bincount(void_pieces[~solid])[1:].max() / (~solid).sum()
    assert largest < 0.05 if name == "cells" else largest >= 0.98


def test_bone_is_longer_along_z_and_foam_is_not(made):
    """Walking along z one meets the surface less often, where cells are stretched that way."""
    for name, low, high in (("bone", 0.6, 0.9), ("foam", 0.94, 1.06)):
        met = [
            np.count_nonzero(np.diff(made[name].values.astype(np.int8), axis=axis))
            for axis in range(3)
        ]
        assert low < met[0] / met[1] < high and low < met[0] / met[2] < high
