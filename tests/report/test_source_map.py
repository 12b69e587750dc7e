"""Source maps: copied material is patches of one colour, other material of the same scan crumbs."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure.evenness import depth_of
from trabecula.pipeline.certificate_page import write_page
from trabecula.report.source_map import SourceMap, own_source_map, source_map


def bone(*corner, side=48):
    return tb.crop(tb.sample("bone"), side, corner=corner)


def colours(drawn: SourceMap):
    """The colours that voxels of the middle slice have where they have a source, and how many."""
    pixels = drawn.picture.values.reshape(-1, 3)
    grey = (pixels == pixels[:, :1]).all(axis=1)
    return np.unique(pixels[~grey], axis=0, return_counts=True)[1]


@pytest.mark.whole
def test_a_copy_has_one_colour_and_another_part_many():
    exemplar = bone(0, 0, 0)
    copied = source_map(exemplar, tb.crop(exemplar, 32))
    other = source_map(exemplar, bone(48, 48, 48))
    assert len(colours(copied)) <= 2  # solid, and paler void
    assert len(colours(other)) > 40
    assert copied.patch > 50 * other.patch
    assert 0.4 < other.patch / own_source_map(tb.sample("bone")).patch < 2.5


@pytest.mark.whole
def test_two_pieces_side_by_side_have_two_colours_with_a_seam_between():
    exemplar = bone(0, 0, 0)
    here, there = exemplar.values[:32, :32, :16], exemplar.values[10:42, 10:42, 20:36]
    drawn = source_map(exemplar, tb.Image(np.concatenate([here, there], axis=2), "labels"))
    counts = np.sort(colours(drawn))[::-1]
    assert counts[:4].sum() > 0.6 * counts.sum()  # the rest is at the seam
    pixels = drawn.picture.values
    assert len(pixels) >= 320 and len(pixels) % 32 == 0


@pytest.mark.whole
def test_what_cannot_be_searched_has_no_map():
    exemplar = bone(0, 0, 0)
    assert source_map(exemplar, tb.Image(np.zeros((32, 32, 32), np.uint8), "labels")) is None
    assert source_map(exemplar, tb.Image(exemplar.values[0], "labels")) is None
    assert source_map(tb.Image(depth_of((40, 40)), "grey"), exemplar) is None
    picture = tb.Image(exemplar.values[20], "labels")
    assert source_map(picture, picture).patch > 100


@pytest.mark.whole
@pytest.mark.slow
def test_the_page_shows_it_beside_real_material(tmp_path):
    exemplar, image = bone(0, 0, 0), bone(48, 48, 48)
    for level, shown in (("default", True), ("quick", False)):
        found = tb.verify(exemplar, image, names=["other"], level=level)
        write_page(tmp_path / "page.html", exemplar, [image], [found])
        text = (tmp_path / "page.html").read_text()
        assert ("Where it comes from" in text) == shown
        assert ("one half of the exemplar, searched in the other" in text) == shown
