"""The certificate of a volume in slabs is that of the whole at level "quick"."""

import numpy as np
import pytest

import trabecula as tb
from commands import trabecula
from trabecula.engine.lazy_volume import as_slabs
from trabecula.measure.blockwise import in_core_bytes


@pytest.fixture(scope="module")
def pair():
    def foam(shape, seed):
        noise = np.random.default_rng(seed).random(shape)
        for axis in range(3):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
        return tb.Image(noise > np.median(noise), "labels", spacing=2.0, unit="um")

    return foam((50, 52, 54), 1), foam((70, 40, 44), 2)


@pytest.mark.whole
def test_figures_and_verdicts_are_those_of_the_whole(pair):
    exemplar, image = pair
    whole = tb.verify(exemplar, image, level="quick")
    slabs = tb.verify(exemplar, as_slabs(image))
    assert slabs.to_json()["metrics"] == whole.to_json()["metrics"]
    assert slabs.about["image"] == whole.about["image"] and slabs.about["level"] == "quick"
    assert any(
        "slab by slab" in note and "thickness" in note and "copying" in note for note in slabs.notes
    )


@pytest.mark.whole
def test_images_and_slabs_side_by_side_are_judged_alike(pair):
    exemplar, image = pair
    first, second = tb.verify(exemplar, image, as_slabs(image), names=["small", "large"])
    assert first.to_json()["metrics"] == second.to_json()["metrics"]
    assert all(any("size of large" in note for note in one.notes) for one in (first, second))


def test_slabs_are_checked_as_images_are(pair):
    exemplar, image = pair
    other = as_slabs(tb.Image(image.values, "labels", spacing=3.0, unit="um"))
    with pytest.raises(tb.errors.InputError, match="correspond"):
        tb.verify(exemplar, other)
    picture = tb.Image(exemplar.values[0], "labels", spacing=2.0, unit="um")
    with pytest.raises(tb.errors.InputError, match="crop"):
        tb.verify(picture, as_slabs(image))


@pytest.mark.slow
def test_a_file_that_does_not_fit_is_judged_in_slabs_as_the_exemplar_says(pair, tmp_path):
    exemplar, image = pair
    scan = tb.write(exemplar, tmp_path / "scan.zarr")
    # which states no spacing
    foam = tb.write(tb.Image(image.values, "labels"), tmp_path / "foam.zarr")
    report = tmp_path / "page.html"
    whole = trabecula("verify", scan, foam, "--quick").out
    slabs = trabecula("verify", scan, foam, "--quick", "--memory", 0.002, "--report", report)
    table = [line for line in slabs.out.splitlines() if "slab by slab" not in line]
    assert [line for line in whole.splitlines() if line.strip()] == [
        line for line in table if line.strip()
    ]
    assert any("slab by slab" in line for line in slabs.lines) and "foam.zarr" in report.read_text()


@pytest.mark.slow
def test_the_exemplar_counts_for_what_fits(pair, tmp_path):
    """Above level "quick" its search tree is held beside what the image takes: two of 260^3 took
    1.4 GB where .75 were said.
    """
    files = [tb.write(one, tmp_path / f"{n}.zarr") for n, one in enumerate(pair)]
    takes = [in_core_bytes(one.shape, "default") for one in pair]
    for room, in_slabs in ((takes[1] + takes[0] // 2, True), (1.1 * sum(takes), False)):
        found = trabecula("verify", *files, "--memory", room / 2**30)
        assert any("slab by slab" in line for line in found.lines) == in_slabs
