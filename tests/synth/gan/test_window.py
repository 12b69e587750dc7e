"""Any box of what a generator makes, and the file that it is kept in. Weights are untrained: they
make material too.
"""

import json
import subprocess
import sys

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine import tensors
from trabecula.errors import FileError, RequestError

torch = pytest.importorskip("torch", reason="gan needs the extra 'learn', which is not installed")

from trabecula.synth.api.exemplar_info import exemplar_info  # noqa: E402
from trabecula.synth.api.serialize import load_model  # noqa: E402
from trabecula.synth.gan import decode  # noqa: E402
from trabecula.synth.gan.config import GanConfig  # noqa: E402
from trabecula.synth.gan.decode import remove_specks  # noqa: E402
from trabecula.synth.gan.method import GanModel  # noqa: E402
from trabecula.synth.gan.networks import (  # noqa: E402
    arithmetic,
    load_generator,
    new_generator,
)

BONE = tb.crop(tb.sample("bone"), 40)


def untrained(exemplar=BONE, calibration=None, seed=0, **settings):
    """A model whose weights are chance, and whose threshold is the median."""
    config = GanConfig(**{"width": 4, "latent": 6, "fractions": 0, **settings})
    calibration = calibration or {"kind": "labels", "present": [0, 1], "offsets": [0.0]}
    count = len(calibration.get("present", ()))
    torch.manual_seed(seed)
    weights = new_generator(config, count if count > 2 else 1).state_dict()
    for name, weight in weights.items():
        if name.endswith("bias"):
            weight.zero_()
    return GanModel(
        config,
        [exemplar_info(exemplar)],
        {"generator": weights, "calibration": calibration, "training": {"x": 1}},
    )


@pytest.fixture(scope="module")
def model():
    return untrained()


@pytest.fixture(scope="module", params=["subpixel", "deconvolution"])
def either(request):
    """With both kinds of generator."""
    settings = {"discriminator": "score"} if request.param == "deconvolution" else {}
    return untrained(generator=request.param, width=2, **settings)


def test_a_tile_is_made_by_its_place_alone(either):
    """Boxes that share tiles in part, whole or not at all, beyond the request too; all of them
    parts of one material.
    """
    edge = 8 * either.config.cell
    whole = either.window(10, ((edge - 30, edge + 5), (-edge, -edge + 40), (3, 20)), seed=2)
    assert 0.02 < whole.mean() < 0.98
    one = either.window(10, ((edge - 1, edge + 5), (-edge + 7, -edge + 8), (3, 9)), seed=2)
    assert np.array_equal(one, whole[29:, 7:8, :6])
    other = either.window(10, ((edge, edge + 5), (-edge, -edge + 40), (3, 20)), seed=3)
    assert not np.array_equal(other, whole[30:])


def test_specks_are_taken_away_across_the_faces_of_tiles(monkeypatch):
    """As from the whole at once: a face of a tile hides nothing, and a box does not either."""
    model = untrained(width=2, precision="float32", specks=2)
    edge = 8 * model.config.cell
    box = ((edge - 12, edge + 12), (edge - 12, edge + 12), (-12, 12))
    found = model.window(10, box, seed=3)
    part = model.window(10, tuple((first + 5, last - 7) for first, last in box), seed=3)
    assert np.array_equal(part, found[5:-7, 5:-7, 5:-7])
    monkeypatch.setattr(decode, "remove_specks", lambda labels, edge: labels)
    raw = model.window(10, tuple((first - 3, last + 3) for first, last in box), seed=3)
    wanted = remove_specks(raw, 2)[3:-3, 3:-3, 3:-3]
    assert (raw[3:-3, 3:-3, 3:-3] != wanted).sum() > 20
    near = np.s_[10:14, :, :], np.s_[:, 10:14, :], np.s_[:, :, 10:14]
    assert all((raw[3:-3, 3:-3, 3:-3][face] != wanted[face]).any() for face in near)
    assert np.array_equal(found, wanted)


def test_there_is_no_seam_between_tiles(model):
    """Voxels change across the faces of tiles as often as elsewhere."""
    values = model.generate((128, 128, 80), seed=1).values.astype(int)
    for axis in (0, 1):
        changes = np.abs(np.diff(values, axis=axis)).mean(
            axis=tuple(i for i in range(3) if i != axis)
        )
        near = np.abs(changes[63] - np.mean(changes[55:72]))
        assert near < 4 * np.std(changes), "the face shows"
        assert changes[63] > 0


@pytest.mark.parametrize("cut", [1, 2, 5])
def test_threads_do_not_matter(model, cut):
    box = ((0, 130), (60, 70), (-10, 70))
    with tb.threads(cut):
        found = model.window(10, box, seed=4)
    assert np.array_equal(found, model.window(10, box, seed=4))


def test_a_torus_has_no_seam_and_needs_whole_cells(model):
    values = model.generate((24, 32, 40), seed=1, periodic=True).values
    twice = model.window((24, 32, 40), ((0, 48), (0, 64), (0, 80)), seed=1, periodic=True)
    assert np.array_equal(twice, np.tile(values, (2, 2, 2)))
    alone = model.generate((24, 32, 40), seed=1).values
    assert not np.array_equal(alone, values) and np.array_equal(alone.shape, values.shape)
    with pytest.raises(
        RequestError, match=r"multiples of 8 voxels, the shape has 41 along x: ask for 40 or 48"
    ):
        model.generate((24, 32, 41), periodic=True)
    with pytest.raises(RequestError, match=r"ask for 8,|ask for 8 "):
        model.generate((24, 5, 40), periodic=(False, True, False))
    assert model.generate((24, 32, 41), periodic=(True, True, False)).shape == (24, 32, 41)


def test_three_phases_and_grey():
    three = tb.Image(np.arange(27).reshape(3, 3, 3) % 3, "labels")
    model = untrained(three, {"kind": "labels", "present": [0, 1, 2], "offsets": [0.0, 0.1, -0.1]})
    assert set(np.unique(model.generate(40, seed=1).values)) == {0, 1, 2}
    grey = tb.Image(np.arange(27, dtype=np.uint16).reshape(3, 3, 3), "grey")
    table = {"kind": "grey", "dtype": "uint16", "from": [-1.0, 1.0], "to": [100.0, 900.0]}
    made = untrained(grey, table).generate(40, seed=1)
    assert made.values.dtype == np.uint16 and 100 <= made.values.min() < made.values.max() <= 900


def test_the_two_arithmetics_agree_but_for_last_bits(model):
    exact = untrained(precision="float32")
    assert arithmetic(exact.config) == "float32"
    one, two = model.generate(64, seed=1).values, exact.generate(64, seed=1).values
    assert np.mean(one != two) < 0.02
    assert exact.generate(64, seed=1).recipe.steps[0]["report"] == {
        "torch": str(torch.__version__),
        "arithmetic": "float32",
    }


def test_a_network_keeps_torch_threads_as_they_were(model):
    before = torch.get_num_threads()
    model.generate(8, seed=1)
    assert torch.get_num_threads() == before


PEAK = """
import sys
from pathlib import Path
import trabecula as tb
model = tb.load_model(sys.argv[1])
with tb.threads(2):
    model.generate(128, seed=1, memory=4 << 30)
    plan = model.plan(tb.Request(128))
# getrusage would give the parent's peak where that is higher.
status = Path("/proc/self/status").read_text()
print(int(status.split("VmHWM:")[1].split()[0]) * 1024, plan.peak)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is told elsewhere")
def test_the_forecast_of_the_process_holds(tmp_path):
    path = untrained(width=16, latent=16).save(tmp_path / "wide.model")
    printed = subprocess.run(
        [sys.executable, "-c", PEAK, path], capture_output=True, text=True, check=True
    ).stdout
    peak, forecast = map(int, printed.split())
    assert peak <= forecast <= 1.5 * peak


def spoilt(model, tmp_path, arrays=None, **changes):
    """The line that a changed file is refused with."""
    held, words = tensors.decode(model.save(tmp_path / "x.model").read_bytes())
    about = json.loads(words["trabecula"])
    about["learned"]["calibration"].update(changes.pop("calibration", {}))
    about["settings"].update(changes.pop("settings", {}))
    (tmp_path / "x.model").write_bytes(
        tensors.encode({**held, **(arrays or {})}, {"trabecula": json.dumps({**about, **changes})})
    )
    with pytest.raises(FileError) as caught:
        load_model(tmp_path / "x.model")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_file_that_contradicts_itself_is_refused(model, tmp_path):
    name = "learned." + sorted(model.parts["generator"])[0]
    weight = model.parts["generator"][name.removeprefix("learned.")]
    assert "NaN" in spoilt(model, tmp_path, {name: weight * np.float32(np.nan)})
    assert "its settings make" in spoilt(model, tmp_path, {name: weight[:1]})
    assert "has no weight 'more'" in spoilt(model, tmp_path, {"learned.more": weight})
    assert "no place in it" in spoilt(model, tmp_path, {"more": weight})
    assert "its settings make" in spoilt(model, tmp_path, settings={"width": 8})
    assert "phases [0, 2]" in spoilt(model, tmp_path, calibration={"present": [0, 2]})
    assert "damaged" in spoilt(model, tmp_path, calibration={"offsets": [1.0, 2.0]})
    assert "calibrated for 'grey'" in spoilt(model, tmp_path, calibration={"kind": "grey"})
    assert "'calibration'" in spoilt(model, tmp_path, learned={})


def test_a_file_holds_no_voxel_of_the_exemplar_and_no_path(tmp_path):
    model = untrained(run=str(tmp_path / "secret"))
    data = model.save(tmp_path / "x.model").read_bytes()
    arrays, words = tensors.decode(data)
    assert (
        all(name.startswith("learned.") for name in arrays) and "secret" not in words["trabecula"]
    )
    assert dict(load_model(tmp_path / "x.model").history) == {"x": 1}
    assert model.exemplars == () and model.facts[0].shares[1] == pytest.approx(BONE.values.mean())


def test_weights_of_half_precision_make_the_same_from_the_file(tmp_path):
    model = untrained()
    half = {name: weight.astype(np.float16) for name, weight in model.parts["generator"].items()}
    small = GanModel(model.config, model.facts, {**model.parts, "generator": half})
    again = load_model(small.save(tmp_path / "half.model"))
    assert np.array_equal(again.generate(32, seed=1).values, small.generate(32, seed=1).values)
    assert (tmp_path / "half.model").stat().st_size < 0.7 * model.save(
        tmp_path / "full.model"
    ).stat().st_size


def test_loading_makes_the_network_that_was_saved(model):
    network = load_generator(model.config, 1, model.parts["generator"])
    assert not network.training and not any(weight.requires_grad for weight in network.parameters())


NO_TORCH = """
import sys
sys.modules["torch"] = None
import trabecula as tb
from trabecula.cli.main import main
assert "gan" in tb.methods()
try:
    tb.load_model(sys.argv[1])
except tb.errors.MissingExtraError as error:
    print(error)
sys.exit(main(["generate", "--model", sys.argv[1], "--shape", "8", "--out", sys.argv[1] + ".npy"]))
"""


def test_without_torch_the_extra_is_named(model, tmp_path):
    path = model.save(tmp_path / "x.model")
    done = subprocess.run(
        [sys.executable, "-c", NO_TORCH, path], capture_output=True, text=True, check=False
    )
    assert (
        done.stdout.strip()
        == "method 'gan' needs torch, which is not installed: pip install 'trabecula[learn]'"
    )
    assert done.stderr.strip() == f"trabecula: {done.stdout.strip()}" and done.returncode == 2
