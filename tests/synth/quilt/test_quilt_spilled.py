"""`quilt` in scratch files: the same voxels, found slab by slab, and nothing in memory that grows
with the volume.
"""

import gc
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from quilt_lattice import reference
from scipy import ndimage

import trabecula as tb
from alone import call_alone
from trabecula.engine import checkpoint, memmap
from trabecula.measure.labelling import label_components
from trabecula.synth.quilt import candidates, connectivity, method
from trabecula.synth.quilt.candidates import CandidateDescriptors, CandidatePools
from trabecula.synth.quilt.canvas import EMPTY, FIXED, OUT, PatchGrid
from trabecula.synth.quilt.compatibility import REASONS, RECORDS, PlacementTrace
from trabecula.synth.quilt.connectivity import SOLID, VOID, ComponentTracker, voxel_classes
from trabecula.synth.quilt.method import _count_pooled
from trabecula.synth.quilt.period import phase_key
from trabecula.synth.quilt.run import QuiltRun
from trabecula.testing.peak import peak_bytes

CELL = dict(patch=11, overlap=3)


@pytest.fixture(autouse=True)
def small_arrays_too(monkeypatch):
    monkeypatch.setattr(memmap, "SMALLEST", 1)


@pytest.fixture(scope="module")
def lattice_model():
    return tb.method("quilt", **CELL).fit(tb.Image(reference(), "labels"))


@pytest.fixture(scope="module")
def blobs():
    rng = np.random.default_rng(5)
    return (ndimage.gaussian_filter(rng.random((48, 48, 48)), 1.6) > 0.5).astype(np.uint8)


def slabs(folder, memory=1 << 14):
    return memmap.map_large_arrays(folder, memory=memory, thickest=5)


def same_in_slabs(model, request, folder):
    """Return the values and the trace of a request, after a check that they are the same in
    memory-mapped files.
    """
    values, trace = model.make_with_trace(request)
    with slabs(folder):
        again, other = model.make_with_trace(request)
        assert memmap.file_of(again) is not None
        assert np.array_equal(values, again)
        assert other.summary() == trace.summary()
        del again, other
    assert not list(folder.iterdir())
    return values, trace


def test_a_field_in_a_form_that_repeats(lattice_model, tmp_path):
    shape = (32, 24, 24)
    field = np.broadcast_to(np.linspace(0.4, 0.6, 32, dtype=np.float32)[:, None, None], shape)
    mask = np.hypot(*np.indices(shape)[1:] - 11.5) < 11
    request = tb.Request(
        shape, seed=3, mask=mask, periodic=(True, False, False), target={"volume_fraction": field}
    )
    values, trace = same_in_slabs(lattice_model, request, tmp_path)
    assert not values[~mask].any() and abs(values[mask].mean() - 0.5) < 0.1
    assert trace.summary()["places"] == np.count_nonzero(trace.tried)


@pytest.mark.whole
@pytest.mark.parametrize("connected", ["solid", "both"])
def test_repair(blobs, connected, tmp_path):
    known = np.ones((30, 30, 30), bool)
    known[8:24, 6:25, 9:30] = False
    fixed = tb.Image(np.ascontiguousarray(blobs.T[4:34, 9:39, 2:32]), "labels")
    model = tb.method("quilt", patch=12, overlap=5, connected=connected).fit(blobs)
    values, trace = same_in_slabs(
        model, tb.Request(known.shape, seed=1, fixed=fixed, known=known), tmp_path
    )
    assert np.array_equal(values[known], fixed.values[known])
    assert trace.summary()["mismatch"]["max"] > 0


@pytest.mark.whole
def test_islands_and_patches_taken_back(tmp_path, monkeypatch):
    """Check islands and patches taken back while the table grows."""
    rng = np.random.default_rng(5)
    sparse = (ndimage.gaussian_filter(rng.random((48, 48, 48)), 1.2) > 0.54).astype(np.uint8)
    few = dict(tries=1, candidates=8, mismatch=1.0)
    model = tb.method("quilt", patch=9, overlap=3, connected="both", **few).fit(sparse)
    request = tb.Request((30, 24, 24), seed=2)
    whole = model.make_with_trace(request)[0]
    monkeypatch.setattr(connectivity, "_MORE", 2)
    values, trace = same_in_slabs(model, request, tmp_path)
    summary = trace.summary()
    assert summary["taken_back"] > 0 and summary["painted"] > 0 and summary["struts"] > 0
    assert np.array_equal(values, whole)


def test_a_picture(tmp_path):
    rng = np.random.default_rng(3)
    field = ndimage.gaussian_filter(rng.random((60, 60)), 2)
    section = tb.Image(
        np.digitize(field, np.quantile(field, [0.45, 0.6])).astype(np.uint8), "labels"
    )
    model = tb.method("quilt", patch=13, overlap=5, connected="none").fit(section)
    values, _ = same_in_slabs(model, tb.Request((40, 50), seed=1), tmp_path)
    assert values.shape == (40, 50) and set(np.unique(values)) == {0, 1, 2}


def test_what_was_cut_off_goes_on_in_scratch_files(lattice_model, tmp_path, monkeypatch):
    request = tb.Request((40, 24, 24), seed=4, target={"volume_fraction": 0.5})
    whole, trace = lattice_model.make_with_trace(request)
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    left = []

    def broken(*arguments, **arrays):
        offered(*arguments, **arrays)
        left.append(arguments)
        if len(left) == 2:
            raise KeyboardInterrupt

    offered = checkpoint.offer
    monkeypatch.setattr(checkpoint, "offer", broken)
    for stopped in (True, False):
        stops = pytest.raises(KeyboardInterrupt) if stopped else nullcontext()
        with slabs(tmp_path / "files"), stops, checkpoint.kept_at(tmp_path / "part"):
            values, report = lattice_model.compute(request)
            assert np.array_equal(values, whole) and report["places"] == trace.summary()["places"]
    assert [number for _, number in left] == [1, 2, 3, 4, 5]


def peaks_of(lengths, folder):
    """Return the traced peak of runs of some lengths, after another run. The smallest mapped array
    and the garbage collector stay changed: for a process of its own.
    """
    memmap.SMALLEST = 1
    model = tb.method("quilt", **CELL).fit(tb.Image(reference(), "labels"))
    gc.disable()
    for size in range(1, 20):  # Python's lists of freed tuples are full, and stay so
        [tuple(range(size)) for _ in range(2500)]
    peaks = []
    for length in (lengths[-1], *lengths):
        with slabs(Path(folder)), tb.threads(1):  # several may hold a cut each, or not
            request = tb.Request((length, 24, 24), seed=1, target={"volume_fraction": 0.5})
            peaks.append(peak_bytes(lambda request=request: model.make_with_trace(request)))
    return peaks[1:]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_volume(tmp_path):
    peaks = call_alone(peaks_of, (24, 144), str(tmp_path))
    assert peaks[1] - peaks[0] < 120 * 24 * 24 // 4, "in core 5 bytes a voxel"


@pytest.mark.whole
@given(
    st.integers(0, 10**6),
    st.sampled_from([1, 3, 50]),
    st.tuples(*[st.booleans()] * 3),
    st.floats(0.2, 0.8),
)
def test_parts_found_in_slabs_are_those_of_the_whole(seed, thick, wraps, share):
    rng = np.random.default_rng(seed)
    values = rng.choice(
        [1, 2, EMPTY], (9, 7, 6), p=[share, (1 - share) / 2, (1 - share) / 2]
    ).astype(np.uint8)
    labels, sizes = label_components(values == 1, periodic=wraps)
    into = np.full(values.shape, 99, np.int32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connectivity, "LABELLED_AT_ONCE", 42 * thick)
        part, found = connectivity.label_slabwise(values, np.arange(256) == 1, wraps, into=into)
        _, counted = connectivity.label_slabwise(values, np.arange(256) == 1, wraps)
    assert found.tolist() == sizes.tolist() == counted.tolist()
    assert np.array_equal(np.where(values == 1, part[np.where(values == 1, into, 0)], 0), labels)
    assert (into[values != 1] == 99).all()


@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True)])
def test_given_voxels_begin_with_their_components(wraps, tmp_path):
    """Check ends, faces towards voxels to make; void that reaches a face of the volume, or `OUT`,
    is component 0.
    """
    rng = np.random.default_rng(7)
    canvas = (
        (ndimage.gaussian_filter(rng.random((17, 15, 13)), 1, mode="wrap") > 0.5) + FIXED
    ).astype(np.uint8)
    canvas[5:9, 4:11, 3:10] = EMPTY
    canvas[12:, 8:] = OUT
    # a pore that is closed, and one that is open to what is to be made
    for z, y, x in ((2, 2, 2), (9, 6, 6)):
        canvas[z if z == 9 else z - 1 : z + 2, y - 1 : y + 2, x - 1 : x + 2] = FIXED + 1
        canvas[z, y, x] = FIXED
    classes = voxel_classes("both", 0, 2)
    with slabs(tmp_path, memory=1):
        made = ComponentTracker(canvas, memmap.zeros(canvas.shape, np.int32), wraps, classes)
        numbers, ends, sizes = (
            np.array(made.numbers),
            np.array(made.ends[: made.count]),
            np.array(made.sizes[: made.count]),
        )
        parent, alive = np.array(made.parent[: made.count]), made.alive
    faces = sum(
        (np.roll(canvas, sign, axis) == EMPTY).astype(int) for axis in range(3) for sign in (-1, 1)
    )  # what is to be made lies away from the ends
    solids, count = label_components(canvas == FIXED + 1, periodic=wraps)
    assert np.array_equal(np.where(solids, numbers, 0), solids)
    for component, size in enumerate(count, start=1):
        assert (parent[component], sizes[component], ends[component]) == (
            component,
            size,
            faces[solids == component].sum(),
        )
    void = (canvas == FIXED) | (canvas == OUT)
    pores, count = label_components(void, periodic=wraps)
    at_end = np.zeros(canvas.shape, bool)
    for axis in (axis for axis in range(3) if not wraps[axis]):
        at_end.swapaxes(0, axis)[[0, -1]] = True
    for axis in range(3):
        for sign in (-1, 1):
            beside = np.roll(canvas == OUT, sign, axis)
            if not wraps[axis]:
                beside.swapaxes(0, axis)[0 if sign == 1 else -1] = False
            at_end |= beside
    inner = [k for k in range(1, len(count) + 1) if not at_end[pores == k].any()]
    assert 2 <= len(inner) < len(count)
    for k in range(1, len(count) + 1):
        assert len(set(numbers[pores == k].tolist())) == 1
        assert (numbers[pores == k][0] > 0) == (k in inner)
    assert {faces[pores == k].any() for k in inner} == {True, False}
    assert alive[0, VOID] == 1 + sum(faces[pores == k].any() for k in inner)
    assert alive[0, SOLID] == np.count_nonzero(ends[1 : 1 + solids.max()])


def test_a_trace_sums_what_was_laid():
    grid = PatchGrid((20, 20, 20), (False,) * 3, (8, 8, 8), (5, 5, 5), (0, -2, 0))
    trace = PlacementTrace(
        grid, {name: memmap.empty(grid.counts, dtype) for name, dtype in RECORDS.items()}
    )
    shares = np.random.default_rng(0).random(int(np.prod(grid.counts)))
    for number, share in enumerate(shares[:-3]):
        trace.add(
            number,
            share if number else float("nan"),
            float("nan"),
            2,
            number % 2,
            REASONS[number % 3],
        )
    trace.drop(len(shares) - 4)
    summary, laid = trace.summary(), np.arange(len(shares) - 4)
    assert summary["places"] == len(laid) and summary["taken_back"] == 1
    assert summary["mismatch"] == {
        "mean": round(shares[laid][1:].mean(), 6),
        "max": round(shares[laid][1:].max(), 6),
    }
    assert "descriptors" not in summary
    assert summary["struts"] == summary["strut_voxels"] == (laid % 2).sum()
    assert summary["gave_way"] == np.count_nonzero(laid % 3)
    assert summary["gave_way_at"] == [
        {"voxel": list(grid.corner(int(n))), "in": REASONS[n % 3]} for n in laid[laid % 3 > 0][:5]
    ]


@pytest.fixture(scope="module")
def out_of_step():
    """Fit cells of 7.25 voxels, laid every 6: every place has a phase of its own."""
    x = np.indices((40, 40, 40)) % 7.25 < 4
    return tb.method("quilt", patch=9, overlap=3, connected="none").fit(
        (x.sum(axis=0) > 1).astype(np.uint8)
    )


def test_pools_that_are_forgotten_are_made_again(out_of_step, monkeypatch):
    assert all(period == pytest.approx(7.25, abs=0.1) for period in out_of_step.periods)
    request = tb.Request((30, 24, 24), seed=1)
    values = out_of_step.make_with_trace(request)[0]
    monkeypatch.setattr(candidates, "HELD", 0)
    run = QuiltRun(out_of_step.library, out_of_step.config, request)
    assert np.array_equal(run.lay_all(), values)
    assert not run.pools._made


def test_the_forecast_counts_the_pools_of_all_phases(out_of_step):
    library = out_of_step.library
    grid = PatchGrid((30, 24, 24), (False,) * 3, library.box, library.step, (0, 0, 0))
    made = CandidatePools(
        library, CandidateDescriptors.measure(library, ["volume_fraction"], {}), 0
    )
    keys = {phase_key(grid.corner(n), library.periods) for n in range(int(np.prod(grid.counts)))}
    assert len(keys) > 50
    assert sum(len(made.pool(phase).at) for phase in keys) == _count_pooled(library, grid, 0)


def test_what_must_stay_in_memory_does_not_grow(lattice_model):
    """Check that memory does not grow, except by a plane; the rest is memory-mapped."""
    short, long = (tb.Request((length, 64, 64), seed=1) for length in (64, 640))
    assert lattice_model.resident_memory(short) == lattice_model.resident_memory(long)
    more = lattice_model.plan(long).peak - lattice_model.plan(short).peak
    assert 5 * 576 * 64 * 64 < more < 6 * 576 * 64 * 64


def test_a_form_in_pieces_is_found_in_slabs(monkeypatch):
    monkeypatch.setattr(connectivity, "LABELLED_AT_ONCE", 1)
    mask = np.zeros((9, 6, 6), bool)
    mask[:, 1:3] = True
    method._check_one_form(mask, (False,) * 3)
    mask[4] = False
    method._check_one_form(mask, (True, False, False))
    with pytest.raises(tb.errors.RequestError, match="2 connected components"):
        method._check_one_form(mask, (False,) * 3)
