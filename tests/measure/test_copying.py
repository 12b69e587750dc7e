"""Copying against what is known: crops, mosaics of tiles, mirrored copies, independent fields, and
search by brute force.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure.copying import (
    coherence,
    coherent_patches,
    diversity,
    sources,
    turned_copies,
)
from trabecula.measure.copying.coherence import _sample_sites
from trabecula.measure.copying.index import Geometry, build_tree, neighbourhoods_of, search
from trabecula.measure.copying.kernels import FAR
from trabecula.measure.copying.pair import _coarse, prepare_pair
from trabecula.measure.copying.turned import axis_names, list_symmetries, name_symmetry


def blobs(shape, *, seed, phases=2, width=3):
    """Draw independent material with structures of a few voxels: smoothed noise, cut into equal
    shares.
    """
    field = np.random.default_rng(seed).normal(size=shape)
    for axis in range(len(shape)):
        for _ in range(width):
            field = field + np.roll(field, 1, axis)
    edges = np.quantile(field, np.arange(1, phases) / phases)
    return np.digitize(field, edges).astype(np.uint8)


def neighbourhoods(values, size):
    """Return every neighbourhood as a row, by plain NumPy."""
    views = np.lib.stride_tricks.sliding_window_view(values, (size,) * values.ndim)
    return views.reshape(*views.shape[: values.ndim], -1)


SCAN = blobs((40, 40, 40), seed=0)


@pytest.mark.parametrize(("phases", "size", "step"), [(2, 9, 1), (2, 5, 2), (3, 7, 1), (5, 5, 1)])
def test_the_search_is_exact(phases, size, step):
    """Compare with every candidate in NumPy: the distance, a source that has it, and the best of
    all that move along.
    """
    exemplar, image = (blobs((18, 19, 20), seed=seed, phases=phases) for seed in (1, 2))
    geometry = Geometry((size,) * 3, step, max(1, (phases - 1).bit_length()), 1)
    tree, cubes = (
        build_tree(neighbourhoods_of(exemplar, geometry), geometry, leaf=32),
        neighbourhoods_of(image, geometry),
    )
    rng = np.random.default_rng(3)
    sites = np.stack([rng.integers(2, side - 2, 12) for side in cubes.counts.shape], -1)
    moves = np.tile(np.array([[2, 0, 0], [0, 0, -1]]), (len(sites), 1, 1))
    best, source, along = search(
        tree, cubes, geometry, sites, moves, np.full(len(sites), FAR, np.int32)
    )

    span = (size - 1) * step + 1
    every = [
        neighbourhoods(part, span).reshape(*cubes.counts.shape, *(span,) * 3)[
            ..., ::step, ::step, ::step
        ]
        for part in (exemplar, image)
    ]
    candidates = np.argwhere(tree.cubes.counts)
    for n, site in enumerate(sites):
        differing = np.array(
            [np.count_nonzero(every[0][tuple(c)] != every[1][tuple(site)]) for c in candidates]
        )
        assert best[n] == differing.min()
        nearest = candidates[differing == best[n]]
        assert np.any(
            np.all(nearest == np.unravel_index(source[n], tree.cubes.counts.shape), axis=1)
        )
        for m, move in enumerate(moves[n]):
            ends = nearest + move
            ends = ends[np.all((ends >= 0) & (ends < tree.cubes.counts.shape), axis=1)]
            there = every[1][tuple(site + move)]
            wanted = min(
                (np.count_nonzero(every[0][tuple(end)] != there) for end in ends), default=int(FAR)
            )
            assert along[n, m] == wanted


@pytest.mark.whole
@settings(max_examples=20)
@given(corner=st.tuples(*[st.integers(0, 18)] * 3), seed=st.integers(0, 5), half=st.booleans())
def test_a_crop_is_coherent_wherever_it_lies(corner, seed, half):
    crop = SCAN[tuple(slice(c, c + 22) for c in corner)]
    for share in coherence(SCAN, crop, k=(1, 2), samples=40, seed=seed, half=half).values():
        assert share == 1


def test_the_sources_of_a_crop_are_where_it_was_taken():
    taken = sources(SCAN, SCAN[5:33, 7:35, 2:30])
    counted = taken.position[..., 0] >= 0
    assert (
        counted[4:-4, 4:-4, 4:-4].mean() > 0.3
        and not counted[:4].any()
        and not counted[:, :, -4:].any()
    )
    assert np.all(taken.position[counted] - np.argwhere(counted) == (5, 7, 2))
    assert np.all(taken.distance[counted] == 0) and np.all(np.isnan(taken.distance[~counted]))
    assert not taken.mirror.any()


def test_half_resolution_has_the_same_frame():
    taken = sources(SCAN, SCAN[1:, 4:39, 3:], size=5, half=True)
    counted = taken.position[..., 0] >= 0
    assert counted.shape == (39, 35, 37)
    assert np.all(taken.position[counted] - np.argwhere(counted) == (1, 4, 3))


@pytest.mark.slow
def test_a_mosaic_falls_into_its_tiles():
    """Copy tiles of s^3 from random places: coherence(k) is about the share of pairs within a tile,
    patches about a tile.
    """
    rng, s, tiles = np.random.default_rng(4), 16, 3
    exemplar = blobs((48, 48, 48), seed=5)
    mosaic = np.empty((s * tiles,) * 3, np.uint8)
    for tile in np.ndindex(tiles, tiles, tiles):
        corner = rng.integers(0, 48 - s, 3)
        here = tuple(slice(i * s, (i + 1) * s) for i in tile)
        mosaic[here] = exemplar[tuple(slice(c, c + s) for c in corner)]
    shares = coherence(exemplar, mosaic, k=(1, 4, 8), samples=800, size=5)
    # neighbourhoods across a seam are nobody's copy, which costs a few percents more
    for k, share in shares.items():
        assert (s - k) / s - 0.18 < share < (s - k) / s + 0.06
    patches = coherent_patches(sources(exemplar, mosaic, size=5))
    assert 0.3 * s**3 < patches.mean < 1.1 * s**3
    assert patches.largest <= 1.3 * s**3


@pytest.mark.whole
def test_independent_material_is_not_coherent():
    other = blobs((40, 40, 40), seed=6)
    shares = coherence(SCAN, other, k=(1, 4, 8), samples=500)
    assert shares[1] > shares[4] > shares[8]
    assert shares[1] < 0.6 and shares[4] < 0.1 and shares[8] < 0.02
    assert coherent_patches(sources(SCAN, other)).mean < 60


@pytest.mark.whole
def test_a_mirrored_copy_is_found_with_mirrors_alone():
    copy = SCAN[4:30, 30:4:-1, 5:31]
    assert coherence(SCAN, copy, k=(8,), samples=60)[8] < 0.1
    assert coherence(SCAN, copy, k=(1, 8), samples=60, mirrors=True) == {1: 1, 8: 1}
    taken = sources(SCAN, copy, mirrors=True)
    counted = taken.position[..., 0] >= 0
    place = np.argwhere(counted)
    assert np.all(taken.mirror[counted] == 2)
    assert np.all(
        taken.position[counted]
        == np.stack([place[:, 0] + 4, 30 - place[:, 1], place[:, 2] + 5], -1)
    )
    assert coherent_patches(taken).mean > 0.9 * np.count_nonzero(counted)


def test_a_mirrored_candidate_that_is_nearer_breaks_a_patch():
    """The image continues the exemplar for five planes; the last two are mirrored there, so that
    the moved source is the nearest but for its mirror image.
    """
    rng = np.random.default_rng(0)
    exemplar = rng.integers(0, 2, (7, 12, 5), np.uint8)
    exemplar[2:5, :, 3:] = exemplar[2:5, :, 1::-1]  # the same in the mirror
    image = exemplar.copy()
    image[5:] = exemplar[5:, :, ::-1]
    assert coherence(exemplar, image, k=(2,), size=5) == {2: 1}
    found = coherence(exemplar, image, k=(2,), size=5, mirrors=True)[2]
    assert found < 0.7


def test_pairs_lie_forwards_and_backwards_along_every_axis():
    pair = prepare_pair(SCAN, SCAN[:, 2:, 4:], size=5, half=False)
    cubes = neighbourhoods_of(pair.image, pair.geometry)
    sites, moves, fits = _sample_sites(cubes, pair, [1, 4], 600, 0)
    assert np.all(np.count_nonzero(moves[fits], axis=1) == 1)
    ways = [np.count_nonzero(moves[:, 1, axis] == way) for axis in range(3) for way in (-4, 4)]
    assert min(ways) > 0.5 * max(ways)
    assert np.all(cubes.counts[tuple((sites[:, None] + moves)[fits].T)])
    assert np.mean(_sample_sites(cubes, pair, [1, 4], 600, 1)[0] != sites) > 0.3


def test_at_half_resolution_the_highest_of_equally_frequent_labels_wins():
    quarter = np.array([0, 1, 1, 0, 0, 1, 0, 1], np.uint8).reshape(2, 2, 2)
    assert _coarse(quarter, 0).tolist() == [[[1]]]
    assert _coarse(quarter * 2, 0).tolist() == [[[2]]]
    quarter[0, 0, 1] = 0
    assert _coarse(quarter, 0).tolist() == [[[0]]]


def test_flat_images_have_sources_too():
    scan = blobs((120, 120), seed=7)
    assert coherence(scan, scan[30:90, 20:80], samples=200) == {1: 1, 4: 1, 8: 1}
    taken = sources(scan, scan[30:90, 20:80])
    counted = taken.position[..., 0] >= 0
    assert taken.position.shape == (60, 60, 2)
    assert np.all(taken.position[counted] - np.argwhere(counted) == (30, 20))
    assert coherence(scan, scan[30:90, 80:20:-1], k=(8,), samples=200, mirrors=True) == {8: 1}
    assert coherence(scan, blobs((60, 60), seed=8), k=(8,), samples=200)[8] < 0.2


@pytest.mark.whole
def test_threads_do_not_matter_and_the_seed_decides():
    other = blobs((34, 30, 28), seed=9)
    with tb.threads(1):
        first, taken = coherence(SCAN, other, seed=3, samples=100), sources(SCAN, other)
    with tb.threads(3):
        again, retaken = coherence(SCAN, other, seed=3, samples=100), sources(SCAN, other)
    assert first == again and np.array_equal(taken.position, retaken.position)
    assert coherence(SCAN, other, seed=4, samples=100) != first


@pytest.mark.whole
@settings(max_examples=20)
@given(seed=st.integers(0, 20))
def test_pieces_share_out_what_counts(seed):
    taken = sources(SCAN[:20], blobs((14, 15, 16), seed=seed), size=5, sweeps=seed % 3)
    patches = coherent_patches(taken)
    assert patches.sizes.sum() == np.count_nonzero(taken.position[..., 0] >= 0)
    assert patches.largest == patches.sizes.max() >= patches.mean >= 1
    assert np.all(np.diff(patches.sizes) <= 0)


@pytest.mark.whole
def test_diversity_of_equal_shifted_and_independent_images():
    realisations = [SCAN, blobs((40, 40, 40), seed=10), np.roll(SCAN, 6, axis=1)]
    found = diversity(realisations, samples=80)
    assert np.array_equal(found.distance, found.distance.T) and not found.distance.diagonal().any()
    assert 0.9 < found.distance[0, 1] < 1.1 and 0.5 < found.distance[0, 2] < 1.3
    assert found.coherence[0, 2] > 0.6 and found.coherence[0, 1] < 0.05
    assert diversity([SCAN, SCAN], samples=20).distance.max() == 0


def test_what_cannot_be_compared_is_refused():
    named = tb.Image(SCAN, "labels", phases=("void", "bone"))
    for wrong, words in [
        (lambda: coherence(SCAN, SCAN[0]), "2-D"),
        (lambda: coherence(SCAN, SCAN[:6]), "neighbourhood spans 9"),
        (lambda: coherence(SCAN, SCAN, size=4), "even"),
        (lambda: coherence(SCAN, SCAN, size=17), "size"),
        (lambda: coherence(SCAN, SCAN, k=(0,)), "k=0"),
        (lambda: coherence(SCAN, SCAN, k=(39,)), "k = 39"),
        (lambda: coherence(SCAN, np.zeros_like(SCAN)), "no neighbourhood of the image"),
        (lambda: coherence(np.zeros_like(SCAN), SCAN), "no neighbourhood of the exemplar"),
        (lambda: coherence(named, tb.Image(SCAN, "labels")), "do not correspond"),
        (lambda: coherence(SCAN * 255, SCAN), "tb.labels"),
        (lambda: diversity([SCAN]), "two or more"),
        (lambda: diversity([SCAN, SCAN[1:]]), "one shape"),
    ]:
        with pytest.raises(InputError, match=words):
            wrong()


TURNS = {
    "mirrored along z": lambda values: values[::-1],
    "turned by 90 degrees about y": lambda values: np.rot90(values, 1, (0, 2)),
    "mirrored along x and turned by 90 degrees about x": lambda values: np.rot90(
        values[:, :, ::-1], 1, (0, 1)
    ),
}


@pytest.mark.parametrize("text", TURNS)
def test_a_copy_is_found_however_it_was_turned(text):
    copy = TURNS[text](SCAN)[4:34, 6:36, 3:33]
    found = turned_copies(SCAN, copy, samples=60)
    assert found.share == 1 and found.text == text


def test_half_a_turned_copy_is_found_and_independent_material_is_not():
    scan, other = (blobs((36,) * 3, seed=seed, width=6) for seed in (11, 12))
    half = other.copy()
    half[:18] = scan.transpose(0, 2, 1)[:18]
    assert turned_copies(scan, other, samples=80).share <= 0.05
    found = turned_copies(scan, half, samples=80)
    assert 0.2 < found.share < 0.8 and found.axes == ("z", "x", "y")
    assert found.text == "mirrored across the diagonal of y and x"
    assert turned_copies(scan, scan, samples=80).share == 0, "a plain copy is not turned"


def test_a_material_that_is_its_own_mirror_image_holds_no_turned_copies():
    scan = blobs((40, 40, 40), seed=13)
    scan[20:] = scan[19::-1]
    assert turned_copies(scan, scan[3:37], samples=60).share == 0


def test_turned_copies_of_flat_images():
    scan = blobs((120, 120), seed=7)
    found = turned_copies(scan, np.rot90(scan)[30:100, 20:90], samples=200)
    assert found.share == 1 and found.text == "turned by 90 degrees"
    assert found.axes in {("x", "-y"), ("-x", "y")}
    assert turned_copies(scan, blobs((70, 70), seed=8), samples=200).share < 0.1


@pytest.mark.parametrize("ndim", [2, 3])
def test_every_symmetry_has_a_name_and_says_where_axes_run(ndim):
    values = np.random.default_rng(ndim).random((3, 4, 5)[:ndim])
    names = "zyx"[3 - ndim :]
    found = list_symmetries(ndim)
    assert len({axis_names(*each) for each in found}) == len(found) == (8 if ndim == 2 else 48)
    for order, back in found[1:]:
        axes = axis_names(order, back)
        # the exemplar is the image, its axes put in order and reversed; the names take it back
        exemplar = np.flip(values.transpose(order), [n for n, b in enumerate(back) if b])
        again = exemplar.transpose([names.index(axis[-1]) for axis in axes])
        again = np.flip(again, [n for n, axis in enumerate(axes) if axis[0] == "-"])
        assert np.array_equal(again, values)
        assert name_symmetry(axes).startswith(("mirrored ", "turned by "))
