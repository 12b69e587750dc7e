"""Targets: what every method that honours them agrees on."""

import importlib.util

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.errors import RequestError
from trabecula.synth.api.registry import methods

SPECS = {name: spec for name, spec in methods().items() if "target" in spec.honours}
SHAPE = (16, 18, 20)


@pytest.fixture(scope="module", params=sorted(SPECS))
def model(request):
    spec = SPECS[request.param]
    if spec.extras and importlib.util.find_spec("torch") is None:
        pytest.skip(f"{spec.name} needs {', '.join(spec.extras)}")
    volume = tb.crop(tb.sample("bone"), 40)
    picture = tb.Image(volume.values[20], "labels", volume.spacing[1:], volume.unit, volume.phases)
    preset = "fast" if "fast" in spec.presets else None
    return tb.method(spec.name, preset=preset, **(spec.trial if spec.stores_exemplar else {})).fit(
        picture if spec.exemplar == "2d" else volume
    )


def test_volume_fraction_is_what_porosity_leaves(model):
    # what walls between bubbles leave, or what is near to the exemplar's
    porosity = 0.6 if model.capabilities.alone else 0.75
    asked = ({"porosity": porosity}, {"volume_fraction": 1 - porosity})
    made = [model.generate(SHAPE, seed=1, target=target) for target in asked]
    assert digest(made[0].values) == digest(made[1].values)
    assert made[0].values.mean() == pytest.approx(1 - porosity, abs=0.06)


def test_a_descriptor_that_is_not_honoured_is_refused_by_name(model):
    other = {
        "surface": 0.1,
        "mean_curvature": 0.0,
        "euler": 0.0,
        "perimeter": 0.1,
        "volume_fraction:solid": 0.2,
    }
    for name, value in other.items():
        head = f"{name.partition(':')[0]}:" if ":" in name else name
        if head not in model.capabilities.targets:
            with pytest.raises(RequestError, match=f"cannot honour the target {name}"):
                model.plan(tb.Request(SHAPE, target={name: value}))


def test_a_field_is_followed_or_refused_before_the_work(model):
    shape = (60, 20, 20)
    field = np.broadcast_to(np.linspace(0.68, 0.9, 60, dtype=np.float32)[:, None, None], shape)
    try:
        made = model.generate(shape, seed=1, target={"porosity": field}).values
    except RequestError as refusal:
        assert "one number" in str(refusal)
    else:
        assert made[:25].mean() > made[35:].mean()
