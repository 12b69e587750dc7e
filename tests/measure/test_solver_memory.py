"""Solvers tell what memory they take before they take it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure import effective_properties
from trabecula.measure.mechanics import homogenise
from trabecula.measure.transport import section
from trabecula.measure.transport.conduction import CONDUCTION_BYTES
from trabecula.measure.transport.permeability import FLOW_BYTES

SOLVERS = {
    "permeability": lambda image, **more: tb.measure.permeability(image, axis=0, **more),
    "diffusivity": lambda image, **more: tb.measure.diffusivity(image, axis=0, **more),
    "tortuosity": lambda image, **more: tb.measure.tortuosity(image, axis=0, **more),
    "conductivity": lambda image, **more: tb.measure.conductivity(
        image, conductivities={"void": 1.0, "solid": 2.0}, axis=0, **more
    ),
    "stiffness": lambda image, **more: tb.measure.stiffness(image, **more),
    "physics": lambda image, **more: tb.measure.describe_physics(image, **more),
}

PEAK = """
import ctypes, gc, os, re, sys
import numpy as np
from trabecula.measure import diffusivity, permeability, stiffness
from trabecula.measure.smooth import gaussian

def material(side):
    field = gaussian(np.random.default_rng(1).random((side,) * 3), 1.5)
    return (field < np.quantile(field, 0.3)).astype(np.uint8)

def resident(name):
    return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read()).group(1)) * 1024

solve = {
    "flow": lambda i: permeability(i, axis=0),
    "conduction": lambda i: diffusivity(i, axis=0),
    "stiffness": stiffness,
}
image = material(40)
np.save(sys.argv[2], image)
solve[sys.argv[1]](material(20))
gc.collect()
# else what imports and the first run have freed serves the second, and no peak is seen
ctypes.CDLL(None).malloc_trim(0)
with open("/proc/self/clear_refs", "w") as file:
    file.write("5")
before = resident("VmRSS")
solve[sys.argv[1]](image)
print(resident("VmHWM") - before)
"""


def medium(side: int) -> np.ndarray:
    return (np.random.default_rng(2).random((side,) * 3) < 0.4).astype(np.uint8)


@pytest.mark.parametrize("name", SOLVERS)
def test_too_large_a_solve_is_refused_and_told_to_take_a_box(name, monkeypatch):
    monkeypatch.setattr("trabecula.engine.memory.available_memory", lambda: 1 << 20)
    with pytest.raises(tb.errors.MemoryBudgetError, match=r"box=, or --box"):
        SOLVERS[name](medium(24))
    SOLVERS[name](medium(24), box=6)


@pytest.mark.parametrize("name", ["permeability", "diffusivity", "stiffness"])
def test_halving_is_part_of_the_forecast(name, monkeypatch):
    monkeypatch.setattr("trabecula.engine.memory.available_memory", lambda: 8 << 20)
    SOLVERS[name](medium(14))
    with pytest.raises(tb.errors.MemoryBudgetError):
        SOLVERS[name](medium(14 if name == "stiffness" else 24), halving=True)


def test_as_many_solves_at_once_as_fit(monkeypatch):
    image = tb.Image(medium(30), "labels")
    one = section.forecast_bytes(image.values == 0, FLOW_BYTES)
    monkeypatch.setattr(effective_properties, "available_memory", lambda: 3 * one + 10)
    assert effective_properties._count_solves(image, None, False) == 3
    assert effective_properties._count_solves(image, 15, False) > 20
    # The solid counts too where most of the image is solid.
    solid = tb.Image(np.ones((30, 30, 30), np.uint8), "labels")
    monkeypatch.setattr(
        effective_properties,
        "available_memory",
        lambda: 2 * section.forecast_bytes(solid.values == 1, CONDUCTION_BYTES),
    )
    assert effective_properties._count_solves(solid, None, False) == 2


@pytest.mark.whole
@pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists() or "NUMBA_DISABLE_JIT" in os.environ,
    reason="Linux, compiled kernels",
)
@pytest.mark.parametrize("name", ["flow", "conduction", "stiffness"])
def test_forecasts_are_near_the_peak_and_above_it(name, tmp_path):
    """Measure resident memory: what kernels allocate is not seen by tracemalloc."""
    thresholds = {
        "MALLOC_MMAP_THRESHOLD_": "65536",
        "MALLOC_TRIM_THRESHOLD_": "65536",
        "TRABECULA_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", PEAK, name, str(tmp_path / "image.npy")],
        env={**os.environ, **thresholds},
        capture_output=True,
        text=True,
        check=True,
    )
    image = np.load(tmp_path / "image.npy")
    with tb.threads(1):
        forecast = {
            "flow": section.forecast_bytes(image == 0, FLOW_BYTES),
            "conduction": section.forecast_bytes(image == 0, CONDUCTION_BYTES),
            "stiffness": homogenise.forecast_bytes(image == 1),
        }[name]
    assert 0.6 * forecast < int(done.stdout) < forecast
