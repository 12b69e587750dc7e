"""`Request`: what it takes, which of its parts are in use, and which contradict each other."""

import dataclasses

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.core.request import check_exemplar
from trabecula.errors import InputError, RequestError


def half(shape=(4, 4, 4), axis=0):
    """True in the first half along an axis."""
    known = np.zeros(shape, bool)
    np.moveaxis(known, axis, 0)[: shape[axis] // 2] = True
    return known


def solid(shape=(4, 4, 4), **fields):
    return tb.Image(np.ones(shape, np.uint8), "labels", **fields)


def halves(shape=(2, 2, 2), **fields):
    """A coarse scan, its first plane solid."""
    values = np.zeros(shape, np.uint8)
    values[0] = 1
    return tb.Image(values, "labels", **fields)


def test_a_coarse_scan_is_a_whole_fraction_of_the_shape():
    request = tb.Request((4, 6, 8), coarse=halves((2, 2, 4)))
    assert request.blocks == (2, 3, 2) and tb.Request(4).blocks == (1, 1, 1)
    assert request.to_json()["coarse"][-1]["verb"] == "array"
    for shape, coarse, says in (
        ((9, 6, 8), halves((2, 3, 4)), r"the nearest is \(8, 6, 8\) \(4 x 2 x 2 voxels in one\)"),
        (1, halves(), r"no whole multiple of the coarse scan's \(2, 2, 2\): the nearest is \(2, 2"),
        (2, halves(), r"as many voxels as the request: ask for a multiple of it, such as \(4, 4"),
    ):
        with pytest.raises(RequestError, match=says):
            tb.Request(shape, coarse=coarse)


def test_a_coarse_scan_is_an_image_with_interfaces_and_stands_alone():
    for coarse, says in (
        (np.ones((2, 2, 2), np.uint8), "coarse is a plain ndarray"),
        (solid((2, 2, 2)), "one value only, and no interface"),
        (tb.Image(np.zeros((2, 2, 2, 3), np.uint8), "colour"), "the coarse scan is colour"),
        (tb.Image(np.eye(2, dtype=np.uint8), "labels"), r"labels of shape \(2, 2\)"),
    ):
        with pytest.raises(InputError, match=says):
            tb.Request(4, coarse=coarse)
    with pytest.raises(
        RequestError, match=r"coarse beside periodic, target: .* leave out periodic"
    ):
        tb.Request(4, coarse=halves(), periodic=True, target={"porosity": 0.5})


def test_a_cube_and_defaults():
    request = tb.Request(5)
    assert request.shape == (5, 5, 5) and request.seed == 0 and request.periodic == (False,) * 3
    assert request.asks_for() == frozenset()


@pytest.mark.parametrize("value", [True, np.True_, (1, 1, 1), [True] * 3])
def test_periodic_along_every_axis(value):
    assert tb.Request(5, periodic=value).periodic == (True, True, True)


def test_parts_in_use_are_named():
    full = tb.Request(
        4,
        periodic=(True, False, False),
        mask=np.ones((4,) * 3, bool),
        target={"porosity": np.ones((4,) * 3)},
        fixed=solid(),
        known=half(),
    )
    assert full.asks_for() == {"periodic", "mask", "target", "fixed"}
    assert tb.Request(4, fixed=solid(), known=half()).asks_for() == {"fixed"}
    assert tb.Request(2, target={}).asks_for() == frozenset()
    assert tb.Request(4, coarse=halves()).asks_for() == {"coarse"}
    assert tb.Request(4, coarse=halves()).is_tied


def test_the_shape_may_be_that_of_the_mask():
    assert tb.Request(None, mask=np.ones((3, 4, 5), bool)).shape == (3, 4, 5)


def test_a_mask_image_is_everything_but_void():
    values = np.arange(3, dtype=np.uint8).repeat(9).reshape(3, 3, 3)
    for phases, void in ((("void", "a", "b"), 0), (("a", "void", "b"), 1), (("a", "b", "c"), 0)):
        mask = tb.Request(3, mask=tb.Image(values, "labels", phases=phases)).mask
        assert mask.dtype == bool and np.array_equal(mask, values != void)


def test_the_origins_of_the_parts_go_into_the_recipe():
    read = tb.Recipe().then("read", np.ones((4, 4, 4), np.uint8), source="part.tif", options={})
    request = tb.Request(
        4,
        seed=3,
        periodic=(True, False, False),
        mask=solid(recipe=read),
        fixed=solid(),
        known=half(),
    )
    told = request.to_json()
    assert (
        told["shape"] == [4, 4, 4]
        and told["seed"] == 3
        and told["periodic"] == [True, False, False]
    )
    assert told["mask"] == read.to_json()
    assert [step["verb"] for step in told["known"] + told["fixed"]] == ["array", "array"]
    # A bool array and the labels that a file gives back of it have one digest.
    assert told["known"][0]["sha256"] == digest(half().astype(np.uint8))
    assert tb.Request(4, seed=3).to_json() == {
        "shape": [4, 4, 4],
        "seed": 3,
        "periodic": [False] * 3,
    }


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        (
            {"mask": np.ones((4, 4, 5), bool)},
            r"mask has shape \(4, 4, 5\), the request \(4, 4, 4\)",
        ),
        ({"mask": np.ones((4, 4, 4), np.uint8)}, "mask is uint8 .*boolean array"),
        ({"mask": np.ones(4, bool)}, "boolean array"),
        ({"mask": np.zeros((4, 4, 4), bool)}, "holds no voxel"),
        ({"mask": tb.Image(np.ones((4, 4, 4)), "grey")}, "mask is grey"),
        ({"shape": None}, "has no shape"),
        ({"fixed": solid()}, "fixed voxels need known"),
        ({"known": half()}, "give fixed as well"),
        ({"fixed": np.ones((4, 4, 4), np.uint8), "known": half()}, "plain ndarray"),
        ({"fixed": solid((4, 4, 3)), "known": half()}, r"fixed has shape \(4, 4, 3\)"),
        ({"fixed": solid(), "known": half((4, 4, 3))}, r"known has shape \(4, 4, 3\)"),
        ({"fixed": solid(), "known": half().astype(int)}, "known is int64"),
        ({"fixed": solid(), "known": np.zeros((4,) * 3, bool)}, "no voxel is known"),
        ({"fixed": solid(), "known": np.ones((4,) * 3, bool)}, "every voxel is known"),
        ({"fixed": solid(), "known": half(), "mask": half()}, "every voxel is known"),
        ({"fixed": solid(), "known": half(), "mask": ~half()}, "no voxel inside the mask is known"),
    ],
)
def test_parts_that_do_not_fit_are_refused(fields, says):
    with pytest.raises(InputError, match=says):
        tb.Request(**{"shape": 4, **fields})


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_fixed_border_cannot_be_periodic(axis):
    periodic = tuple(k == axis for k in range(3))
    for other in range(3):
        if other == axis:
            # known at one end only
            tb.Request(4, fixed=solid(), known=half(axis=axis), periodic=periodic)
            continue
        with pytest.raises(RequestError, match=f"known voxels lie at both ends of {'zyx'[axis]}"):
            tb.Request(4, fixed=solid(), known=half(axis=other), periodic=periodic)


@pytest.mark.parametrize(
    ("exemplar", "says"),
    [
        (tb.Image(np.ones((9, 9, 9)), "grey"), "fixed voxels are labels, the exemplar is grey"),
        (
            tb.Image(np.eye(9, dtype=int)[None].repeat(9, 0), "labels", spacing=2),
            "give the spacing of both",
        ),
        (
            tb.Image(np.eye(9, dtype=int)[None].repeat(9, 0), "labels", phases=("pore", "bone")),
            "name the phases",
        ),
        (
            tb.Image(np.zeros((9, 9, 9), int), "labels"),
            "hold the phase solid, which the exemplar lacks",
        ),
    ],
)
def test_fixed_voxels_of_another_material_are_refused(exemplar, says):
    request = tb.Request(4, fixed=solid(), known=half())
    with pytest.raises(RequestError, match=says):
        check_exemplar(request, exemplar)
    check_exemplar(request, tb.Image(np.eye(9, dtype=int)[None].repeat(9, 0), "labels"))
    check_exemplar(tb.Request(4), exemplar)


def test_what_is_not_known_may_be_anything():
    values = np.where(half(), 0, 2)
    request = tb.Request(
        4, fixed=tb.Image(values, "labels", phases=("void", "solid", "dirt")), known=half()
    )
    check_exemplar(request, tb.Image(np.eye(9, dtype=int)[None].repeat(9, 0), "labels"))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"shape": 0}, "must be positive"),
        ({"shape": (4, 4, 4, 4)}, "has 4 numbers"),
        ({"shape": 4.5}, "whole numbers"),
        ({"shape": 10**9}, "more than 2\\*\\*48"),
        ({"shape": 4, "seed": -1}, "seed -1 is outside"),
        ({"shape": 4, "seed": 0.5}, "seed 0.5 is not an integer"),
        ({"shape": 4, "periodic": (True, False)}, "one truth value or three"),
    ],
)
def test_refused(fields, says):
    with pytest.raises(InputError, match=says):
        tb.Request(**fields)


def test_a_request_does_not_change():
    with pytest.raises(dataclasses.FrozenInstanceError):
        tb.Request(5).seed = 1


def test_a_target_is_a_number_or_a_field():
    field = np.linspace(0, 1, 24).reshape(2, 3, 4)
    assert tb.Request((2, 3, 4), target={"porosity": np.float32(0.25)}).target == {"porosity": 0.25}
    for given in (field, tb.Image(field, "grey")):
        kept = tb.Request((2, 3, 4), target={"porosity": given}).target["porosity"]
        assert kept.dtype == np.float32 and np.array_equal(kept, field.astype(np.float32))


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ({"porosty": 0.3}, "did you mean 'porosity'"),
        ({"porosity": 1.2}, r"1\.2, outside 0 \.\. 1"),
        ({"porosity": -0.1}, "outside"),
        ({"porosity": np.nan}, "NaN"),
        ({"porosity": "much"}, "give a number"),
        ({"porosity": True}, "give a number"),
        ({"porosity": None}, "give a number"),
        ({"porosity": np.full((2, 2, 3), 0.5)}, r"shape \(2, 2, 3\), the request \(2, 2, 2\)"),
        ({"porosity": np.full((2, 2, 2), 55)}, "rescale"),
        ({"porosity": np.full((2, 2, 2), np.inf)}, "infinite"),
        ({"porosity": tb.Image(np.ones((2, 2, 2), np.uint8), "labels")}, "field of numbers"),
        (0.3, "give names with values"),
        ({"porosity": 0.3, "volume_fraction": 0.7}, "give one of them"),
        ({"volume_fraction:solid": 1.5}, r"outside 0 \.\. 1"),
        ({"volume_fraction:": 0.5}, "did you mean 'volume_fraction'"),
        ({"surface": -0.1}, r"outside 0 \.\. inf"),
        ({"euler": "many"}, "give a number, or a field"),
    ],
)
def test_a_target_that_says_nothing_is_refused(target, words):
    with pytest.raises(InputError, match=words):
        tb.Request(2, target=target)


def test_descriptors_have_their_ranges():
    asked = {
        "volume_fraction:binder": 0.2,
        "surface": 2,
        "mean_curvature": -0.1,
        "euler": np.full((2, 2, 2), -3e-4),
    }
    kept = tb.Request(2, target=asked).target
    assert (
        kept["surface"] == 2.0
        and kept["mean_curvature"] == -0.1
        and kept["euler"].dtype == np.float32
    )


def test_targets_are_told():
    field = np.full((2, 2, 2), 0.5)
    assert "target" not in tb.Request(2).to_json()
    assert tb.Request(2, target={"porosity": 0.3}).to_json()["target"] == {"porosity": 0.3}
    told = tb.Request(2, target={"porosity": field}).to_json()
    assert [step["verb"] for step in told["target"]["porosity"]] == ["array"]
    assert (
        told["target"]["porosity"][0]["sha256"] == digest(field) and "target.porosity" not in told
    )


def test_fixed_voxels_have_the_spacing_of_the_result():
    picture = tb.Image(np.eye(4, dtype=int), "labels", (2.0, 2.0), "um")
    for spacing, unit, good in (
        ((2.0,) * 3, "um", True),
        ((3.0, 2.0, 2.0), "um", False),
        ((2.0, 2.0, 3.0), "um", False),
        ((2.0,) * 3, "mm", False),
    ):
        request = tb.Request(
            4,
            fixed=tb.Image(np.eye(4, dtype=int)[None].repeat(4, 0), "labels", spacing, unit),
            known=half(),
        )
        if good:
            check_exemplar(request, picture, spacing=(2.0,) * 3)
        else:
            with pytest.raises(RequestError, match="spacing"):
                check_exemplar(request, picture, spacing=(2.0,) * 3)


def test_a_mask_states_the_size_of_its_voxels():
    form = np.ones((4, 4, 4), np.uint8)
    assert tb.Request(None, mask=form.astype(bool)).voxel is None
    assert tb.Request(None, mask=tb.Image(form, "labels")).voxel is None
    assert tb.Request(None, mask=tb.Image(form, "labels", (3, 2, 2), "um")).voxel == (
        (3.0, 2.0, 2.0),
        "um",
    )
    assert tb.Request(None, mask=tb.Image(form, "labels", 0.5)).voxel == ((0.5,) * 3, "voxel")
