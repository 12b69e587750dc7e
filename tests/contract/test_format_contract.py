"""Formats of volumes keep the contract that others may check their own with."""

import pytest

import trabecula as tb
from trabecula.testing import check_format

WHAT = {".vti": {"ndim": (3,)}, ".png": {"ndim": (2,), "greys": ("uint8", "uint16")}}


@pytest.mark.parametrize("suffix", [".tif", ".npy", ".nrrd", ".nii.gz", ".mha", ".vti", ".png"])
def test_the_contract(suffix):
    check_format(suffix, **WHAT.get(suffix, {}))


def test_a_format_that_loses_something_is_found(monkeypatch):

    def without_spacing(image, path):
        return tb.write(tb.Image(image.values, image.kind, 1.0, "um", image.phases), path)

    monkeypatch.setattr("trabecula.testing.format.write", without_spacing)
    with pytest.raises(AssertionError, match=r"\.nrrd: 2-D labels uint8: spacing is"):
        check_format(".nrrd")
