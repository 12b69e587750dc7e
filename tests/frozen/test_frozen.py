"""Results that must not change: the voxels of small cases, and files that version 0.1 wrote."""

import json
from pathlib import Path

import pytest

import trabecula as tb
from frozen.cases import CASES, FILES, PRESETS, digest
from trabecula.engine.checkpoint import identity_of
from trabecula.pipeline.replay import model_and_request

HASHES = json.loads((Path(__file__).parent / "hashes.json").read_text(encoding="utf-8"))

QUICK = {
    *("bubbles", "exemplar", "export", "fields", "finish", "gan", "lattice", "measure", "mesh"),
    *("noise", "quilt", "report", "view", "chen-grey", "kopf-grey", "mrf-several", "sliced-mask"),
    *("texture-fixed", "texture-graded", "bubbles-preset.tif", "chen-colour.nrrd"),
    *("crop.nrrd", "field", "noise.nrrd", "quilt.nrrd", "segment.nrrd", "texture-grey.npy"),
}
"""Cases, kinds of cases and files that take little time, but for `SLOW` ones."""

ELSEWHERE = {
    "gan-shipped": {"711b36d090ed715e46c4b1d3b9c7a416dbc8ad72e7f206826a6317c78a30e152"},
    "gan-shipped-in-blocks": {
        "676b74a0f888a61b0a6ace87ea973297572c141891b551b858feab744977241f",
        "30577316ab2327443c74b4b0895dd932e7f144ccda3493d7712fba67f38d193a",
    },
    "gan-shipped-periodic-mask": {
        "6c41f6fc8ea403109e7451dfc40d7898e87d52f0ac3b904e707f8f78fefb6482"
    },
    "gan-trained": {
        "2045814d93f946a236e86225108ab4c0931768cbff009235e407c0b4768a5983",
        "c774a04e7449f56d153dc97d934fd7bc4149d2b64487f8e1741dcb9a133616ce",
    },
}
"""Hashes on processors without matrix tiles (AMX), and without vectors of 512 bits, where PyTorch
sums in another order.
"""

SLOW = {
    *("bubbles-in-blocks", "exemplar-samples", "export-grey", "export-stl", "fields-directions"),
    *("measure-labels-full", "measure-phases", "noise-alone-voronoi", "quilt-flat"),
    *("quilt-several", "gan-trained"),
}


def _cases(names):
    """Return the names as parameters, the slow ones marked."""
    cases = []
    for name in names:
        kind = name.split("-")[0]
        quick = name in QUICK or (kind in QUICK and ("." not in name or kind == "field"))
        quick = quick and name not in SLOW
        cases.append(name if quick else pytest.param(name, marks=pytest.mark.whole))
    return cases


@pytest.mark.parametrize("name", _cases(CASES))
def test_a_case_gives_the_frozen_result(name):
    try:
        result = CASES[name]()
    except tb.errors.MissingExtraError as error:
        pytest.skip(str(error))
    known = {HASHES[name]} | ELSEWHERE.get(name, set())
    assert digest(result) in known, f"{name} changed (python tests/frozen/freeze.py {name})"


def test_every_preset_has_a_case():
    for name, spec in tb.methods().items():
        if name != "gan":
            assert set(spec.presets) == set(PRESETS.get(name, ()))


def test_every_hash_has_its_case():
    assert set(HASHES) == set(CASES)


INPUTS = {"slice", "across", "grey", "colour", "scan", "form", "mask", "known", "fixed", "field"}
RESULTS = sorted(
    path.name
    for path in FILES.iterdir()
    if path.name != "array"
    and path.suffix not in (".model", ".json")
    and path.name.split(".")[0] not in INPUTS
)


@pytest.mark.parametrize("name", _cases(RESULTS))
def test_the_recipe_of_an_old_file_makes_its_voxels(name):
    again = tb.rerun(FILES / name)
    assert digest(again) == digest(tb.read(FILES / name))


def test_an_array_in_memory_is_given_as_a_file():
    again = tb.rerun(FILES / "array" / "texture.nrrd", exemplar=FILES / "array" / "exemplar.npy")
    assert digest(again) == digest(tb.read(FILES / "array" / "texture.nrrd"))


@pytest.mark.parametrize("name", ["texture", "kopf", "chen", "mrf", "quilt", "sliced"])
def test_an_unfinished_run_of_before_is_resumed(name):
    """Its checkpoint names the run by the settings that there were then."""
    step = tb.read(FILES / f"{name}.nrrd").recipe.steps[-1]
    model, request = model_and_request(step, folder=FILES)
    before = identity_of(name, step["settings"], request, model.exemplars)
    assert model.identity(request) == before
