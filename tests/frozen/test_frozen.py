"""Results that must not change: the voxels of small cases, and files that version 0.1 wrote."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from frozen.cases import CASES, FILES, PRESETS, digest

import trabecula as tb

HASHES = json.loads((Path(__file__).parent / "hashes.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", CASES)
def test_a_case_gives_the_frozen_result(name):
    try:
        result = CASES[name]()
    except tb.errors.MissingExtraError as error:
        pytest.skip(str(error))
    assert digest(result) == HASHES[name], f"{name} changed (python tests/frozen/freeze.py {name})"


def test_every_preset_has_a_case():
    for name, spec in tb.methods().items():
        if name != "gan":
            assert set(spec.presets) == set(PRESETS[name])


def test_every_hash_has_its_case():
    assert set(HASHES) == set(CASES)
