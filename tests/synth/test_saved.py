"""Models in files: the same voxels from them, and one clear line for every way in which a file can
lie.
"""

import json
import re
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula import models
from trabecula.engine import tensors
from trabecula.errors import FileError, TrabeculaError, UnknownNameError
from trabecula.synth.api.exemplar_info import ExemplarInfo, exemplar_info
from trabecula.synth.api.serialize import load_model
from trabecula.synth.shared.content.kinds import content_of

EXEMPLAR = tb.crop(tb.sample("bone"), 16)


@pytest.fixture(scope="module")
def noise():
    return tb.method("noise", reach=4, corrections=2).fit(EXEMPLAR)


@pytest.fixture(scope="module")
def data(noise, tmp_path_factory):
    return noise.save(tmp_path_factory.mktemp("model") / "bone.model").read_bytes()


def about(data):
    """What a file says of itself, and its arrays."""
    arrays, words = tensors.decode(data)
    return json.loads(words["trabecula"]), arrays


def changed(data, arrays=None, **changes):
    """A file that says something else."""
    said, held = about(data)
    said = {name: value for name, value in {**said, **changes}.items() if value is not None}
    return tensors.encode(held if arrays is None else arrays, {"trabecula": json.dumps(said)})


def refused(folder, data):
    path = folder / "x.model"
    path.write_bytes(data)
    with pytest.raises(FileError) as caught:
        load_model(path)
    message = str(caught.value)
    assert message.startswith(f"cannot read {path} as a model: ") and "\n" not in message
    return message


@pytest.mark.whole
@pytest.mark.parametrize("name", ["noise", "texture"])
def test_a_model_from_a_file_makes_the_same(name, tmp_path):
    settings = {
        "texture": {"neighbourhood": 4, "first_rounds": 1, "rounds": (1,)},
        "noise": {"reach": 5},
    }[name]
    model = tb.method(name, **settings).fit(EXEMPLAR)
    again = tb.load_model(model.save(tmp_path / "some folder" / "m.model"))
    one, two = model.generate((18, 17, 16), seed=4), again.generate((18, 17, 16), seed=4)
    assert np.array_equal(one.values, two.values) and one.recipe.to_json() == two.recipe.to_json()
    assert (two.spacing, two.unit, two.phases) == (EXEMPLAR.spacing, EXEMPLAR.unit, EXEMPLAR.phases)
    assert again.config == model.config and again.facts == model.facts and again.name == "m.model"


def test_a_model_learned_from_several_keeps_them_all(tmp_path):
    pictures = [tb.Image(EXEMPLAR.values[i], "labels", EXEMPLAR.spacing[1:], "um") for i in (4, 9)]
    model = tb.method("sliced").fit(pictures)
    again = tb.load_model(model.save(tmp_path / "m.model"))
    assert [
        np.array_equal(a.values, b.values)
        for a, b in zip(model.exemplars, again.exemplars, strict=True)
    ] == [True] * 2


def test_the_same_model_is_the_same_bytes_and_its_digest_outlives_versions(noise, data):
    said, arrays = about(data)
    assert (
        noise.to_bytes() == load_model_of(data).to_bytes()
        and noise.sha256 == load_model_of(data).sha256
    )
    assert said["versions"]["trabecula"] == tb.__version__
    assert np.array_equal(arrays["exemplar.0"], EXEMPLAR.values)
    other = tb.method("noise", reach=5, corrections=2).fit(EXEMPLAR)
    assert other.sha256 != noise.sha256


def load_model_of(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.model"
        path.write_bytes(data)
        return load_model(path)


def test_facts_survive_json_and_know_shares():
    facts = exemplar_info(EXEMPLAR)
    assert facts.shares == pytest.approx((1 - EXEMPLAR.values.mean(), EXEMPLAR.values.mean()))
    assert ExemplarInfo.from_json(json.loads(json.dumps(facts.to_json()))) == facts
    grey = exemplar_info(tb.Image(np.random.default_rng(0).random((4, 5)), "grey"))
    assert grey.shares == () and grey.shape == (4, 5) and grey.ndim == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"format": 2, "versions": {"trabecula": "9.1"}},
            "trabecula 9.1 wrote it, in format 2.*newer",
        ),
        ({"format": None}, "damaged"),
        ({"format": True}, "damaged"),
        ({"method": "telepathy"}, "method 'telepathy' is not in this trabecula"),
        ({"method": ["noise"]}, "."),
        ({"settings": {"reach": 1}}, "reach"),
        ({"settings": {"raech": 5}}, "did you mean 'reach'"),
        ({"settings": [1]}, "."),
        ({"settings": None}, "settings"),
        ({"exemplars": []}, "names no exemplar"),
        ({"exemplars": [{}]}, "kind"),
        ({"exemplars": None}, "exemplars"),
    ],
)
def test_what_a_file_says_of_itself_is_checked(data, tmp_path, changes, words):
    assert re.search(words, refused(tmp_path, changed(data, **changes)))


@pytest.mark.parametrize(
    ("field", "value"),
    [("kind", "smell"), ("spacing", [0, 1, 1]), ("spacing", "x"), ("phases", ["void"]),
     ("shares", [1]), ("recipe", 3),
     ("unit", 7), ("shape", [-1, 2, 3])],
)  # fmt: skip
def test_facts_are_checked(data, tmp_path, field, value):
    said, _ = about(data)
    refused(tmp_path, changed(data, exemplars=[{**said["exemplars"][0], field: value}]))


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({}, "voxels of 0 exemplars"),
        ({"exemplar.0": EXEMPLAR.values, "exemplar.1": EXEMPLAR.values}, "voxels of 2"),
        (
            {"exemplar.0": EXEMPLAR.values, "weights": EXEMPLAR.values},
            "'weights', which has no place",
        ),
        ({"exemplar.0": EXEMPLAR.values + np.uint8(40)}, "labels run from"),
        ({"exemplar.0": EXEMPLAR.values[0]}, "."),
        ({"exemplar.0": np.full((16,) * 3, np.nan)}, "NaN"),
        ({"exemplar.0": EXEMPLAR.values * np.uint8(0)}, "one phase only"),
    ],
)
def test_voxels_are_checked(data, tmp_path, arrays, words):
    assert re.search(words, refused(tmp_path, changed(data, arrays)))


def test_files_of_another_sort_are_refused(data, tmp_path):
    assert "none that this package wrote" in refused(
        tmp_path, tensors.encode({"a": EXEMPLAR.values}, {})
    )
    assert "does not start as one" in refused(tmp_path, b"\x80\x04\x95" + bytes(100))  # a pickle
    assert "cut off" in refused(tmp_path, data[:-100])
    assert "damaged" in refused(tmp_path, tensors.encode({}, {"trabecula": "[1]"}))
    refused(tmp_path, tensors.encode({}, {"trabecula": "{"}))


@given(st.integers(0, 2**20), st.binary(min_size=1, max_size=6))
def test_any_damage_is_one_line_or_a_model(data, tmp_path_factory, place, bytes_):
    spoilt = bytearray(data)
    place %= len(spoilt)
    spoilt[place : place + len(bytes_)] = bytes_
    path = tmp_path_factory.mktemp("damage") / "x.model"
    path.write_bytes(bytes(spoilt))
    try:
        model = load_model(path)
    except TrabeculaError as error:
        assert "\n" not in str(error) and str(path) in str(error)
    else:
        assert model.facts[0].shape == model.exemplars[0].shape


def test_where_there_is_no_model(tmp_path):
    with pytest.raises(FileError, match="folder"):
        load_model(tmp_path)
    with pytest.raises(FileError, match="there is no file"):
        load_model(tmp_path / "x.model")
    with pytest.raises(UnknownNameError, match="unknown model"):
        load_model("telepathy")


def test_shipped_models_are_found_by_name(noise, tmp_path, monkeypatch):
    noise.save(tmp_path / "marrow.safetensors")
    (tmp_path / "marrow.md").write_text("# marrow\n\nBone of a test.\n\nMore.\n")
    monkeypatch.setattr(models, "_HERE", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert (
        list(models.shipped_models()) == ["marrow"]
        and models.summary("marrow") == "Bone of a test."
    )
    model = tb.load_model("marrow")
    assert model.name == "marrow" and np.array_equal(
        model.generate(8, seed=1).values, noise.generate(8, seed=1).values
    )
    with pytest.raises(UnknownNameError, match="did you mean 'marrow'"):
        tb.load_model("marow")
    noise.save(tmp_path / "marrow")  # a file of that name comes first
    assert tb.load_model("marrow").name == "marrow" and models.card("nothing") == ""


def test_every_shipped_model_has_a_card_and_can_be_read():
    for name, path in models.shipped_models().items():
        assert models.summary(name), f"{name} has no card"
        card = models.card(name)
        assert all(
            word in card for word in ("Licence and credit", "Recipe", "Figures", "Known failures")
        ), name
        said, arrays = about(path.read_bytes())
        assert said["method"] in tb.methods() and arrays
        source = said["exemplars"][0]["recipe"][0]["source"]
        assert "/" not in source and source.removesuffix(".tif") in card, (
            "it names its scan, not where it lay"
        )
        assert path.stat().st_size <= 60 << 20
        assert struct.unpack("<Q", path.read_bytes()[:8])[0] < 1 << 20


def test_numbers_of_a_model_are_finite(data, tmp_path):
    """Weights that a training has lost would make noise of every later result."""
    _, arrays = about(data)
    for lost in (np.nan, np.inf):
        arrays["state.weights"] = np.array([0.5, lost], np.float32)
        assert "'state.weights' holds NaN" in refused(tmp_path, changed(data, arrays))


def test_outside_of_a_form_is_the_void_wherever_it_stands_among_the_phases():
    facts = exemplar_info(tb.Image(EXEMPLAR.values, "labels", phases=("bone", "void")))
    assert facts.empty_label == 1 and exemplar_info(EXEMPLAR).empty_label == 0
    form = np.zeros((8, 8, 8), bool)
    form[2:6, 2:6, 2:6] = True
    turned = tb.Image(1 - EXEMPLAR.values, "labels", phases=("bone", "void"))
    assert content_of([turned]).empty == 1
    model = tb.method("noise", reach=4, corrections=0).fit(turned)
    assert (model.generate(None, mask=form, seed=1).values[~form] == 1).all()
