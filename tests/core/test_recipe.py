"""Recipes: plain JSON that nobody can change, and digests of voxels."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe, digest, versions

VALUES = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)
names = st.text(min_size=1).filter(lambda name: name not in ("verb", "sha256", "versions"))


@pytest.mark.whole
@given(st.lists(st.tuples(st.text(), st.dictionaries(names, plain, max_size=3)), max_size=4))
def test_a_recipe_survives_json(steps):
    recipe = Recipe()
    for verb, parameters in steps:
        recipe = recipe.then(verb, VALUES, **parameters)
    again = Recipe.from_json(json.loads(json.dumps(recipe.to_json(), allow_nan=False)))
    assert again == recipe and len(again.steps) == len(steps)
    for (verb, parameters), step in zip(steps, again.steps, strict=True):
        assert step == {
            "verb": verb,
            **parameters,
            "sha256": digest(VALUES),
            "versions": versions(),
        }


def test_numpy_becomes_plain():
    step = (
        Recipe()
        .then("crop", VALUES, size=(np.int64(3), 4), at=np.array([1.5, 2]), of=np.float32(0.5))
        .steps[0]
    )
    assert step["size"] == [3, 4] and step["at"] == [1.5, 2.0] and step["of"] == 0.5


def test_recipes_of_exemplars_nest():
    inner = Recipe().then("sample", VALUES, name="bone")
    outer = Recipe().then("generate", VALUES, exemplars=[inner])
    assert Recipe.from_json(outer.steps[0]["exemplars"][0]) == inner


@pytest.mark.parametrize("value", [object(), {1, 2}, b"x"])
def test_what_json_cannot_hold_is_no_parameter(value):
    with pytest.raises(TypeError, match="does not belong in a recipe"):
        Recipe().then("crop", VALUES, size=value)


def test_nan_is_no_parameter():
    with pytest.raises(ValueError, match="JSON"):
        Recipe().then("segment", VALUES, threshold=float("nan"))


def test_a_recipe_does_not_change():
    first = Recipe().then("crop", VALUES, size=[1, 2])
    second = first.then("segment", VALUES)
    assert len(first.steps) == 1 and [step["verb"] for step in second.steps] == ["crop", "segment"]
    assert not Recipe() and first
    with pytest.raises(dataclasses.FrozenInstanceError):
        first.steps = ()
    given_out = first.to_json()
    given_out[0]["size"].append(3)
    assert first.steps[0]["size"] == [1, 2]
    taken_in = [{"verb": "crop", "size": [1]}]
    recipe = Recipe.from_json(taken_in)
    taken_in[0]["size"].append(3)
    assert recipe.steps[0]["size"] == [1]


@pytest.mark.parametrize("steps", ["crop", {"verb": "crop"}, [1], [{"name": "crop"}], [[]]])
def test_damaged_recipes_are_told(steps):
    with pytest.raises(InputError, match="the recipe is damaged: it should be a list of steps"):
        Recipe.from_json(steps)


def test_no_recipe_is_an_empty_one():
    assert Recipe.from_json(None) == Recipe() == Recipe.from_json([])


def test_the_digest_is_that_of_type_shape_and_bytes():
    expected = hashlib.sha256(b"u1(2, 3, 4)" + bytes(range(24))).hexdigest()
    assert digest(VALUES) == expected


@given(
    arrays.arrays(
        st.sampled_from(["u1", "<u2", "<i4", "<f4", "<f8", "?"]),
        arrays.array_shapes(min_dims=2, max_dims=3, max_side=4),
    )
)
def test_the_digest_does_not_depend_on_memory(values):
    known = digest(values)
    assert digest(np.asfortranarray(values)) == known
    assert digest(values[::-1][::-1]) == known
    assert digest(np.repeat(values, 2, axis=0)[::2]) == known
    assert digest(values.astype(values.dtype.newbyteorder(">"))) == known
    frozen = values.copy()
    frozen.flags.writeable = False
    assert digest(frozen) == known


def test_the_digest_depends_on_type_shape_and_every_value():
    changed = VALUES.copy()
    changed[1, 2, 3] += 1
    others = [
        VALUES.astype(np.int8),
        VALUES.astype(np.uint16),
        VALUES.reshape(2, 4, 3),
        VALUES.ravel(),
        changed,
        VALUES[:1],
    ]
    digests = {digest(values) for values in (VALUES, *others)}
    assert len(digests) == 1 + len(others)
