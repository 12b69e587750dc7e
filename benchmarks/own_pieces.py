"""`python benchmarks/own_pieces.py`: pieces of our own beside SciPy's, and what the base costs.

Seconds are the processor's on one thread, the least of five runs with kernels compiled; the volume
is `sample:bone` repeated to 256^3. Sizes are those of installed packages, imports those of a fresh
interpreter. `docs/guide/dependencies.md` has the reasons.
"""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import trabecula as tb
from common import busy, tell
from trabecula.engine.parallel import threads
from trabecula.measure.smooth import gaussian

SIDE = 256
RUNS = 5
BASE = ("numpy", "numba", "llvmlite", "zarr", "tifffile", "pillow", "nibabel", "pynrrd")
OTHERS = ("scipy", "scikit-image", "trimesh")


def pieces() -> None:
    """Seconds of our distance transform, labelling and Gaussian, and of SciPy's."""
    from scipy import ndimage

    bone = tb.sample("bone").values
    solid = np.tile(bone, [-(-SIDE // side) for side in bone.shape])[:SIDE, :SIDE, :SIDE] > 0
    grey = solid.astype(np.float32)
    jobs: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
        "Euclidean distance transform": (
            lambda: tb.measure.distance_transform(solid),
            lambda: ndimage.distance_transform_edt(solid),
        ),
        "connected components (faces)": (
            lambda: tb.measure.label_components(solid, connectivity=6),
            lambda: ndimage.label(solid),
        ),
        "Gaussian, sigma 2": (
            lambda: gaussian(grey, 2.0),
            lambda: ndimage.gaussian_filter(grey, 2),
        ),
    }
    tell(f"at {SIDE}^3", "ours, s", "SciPy's, s")
    with threads(1):
        for name, both in jobs.items():
            both[0]()
            seconds = [min(busy(job)[0] for _ in range(RUNS)) for job in both]
            tell(name, *(f"{one:.2f}" for one in seconds))


def sizes() -> None:
    """Megabytes of the packages that are installed here."""
    tell("package", "version", "MB")
    own = [path for path in Path(tb.__file__).parent.rglob("*") if "__pycache__" not in path.parts]
    size = sum(path.stat().st_size for path in own if path.is_file())
    tell("trabecula", tb.__version__, f"{size / 1e6:.1f}")
    for name in (*BASE, *OTHERS):
        try:
            found = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            continue
        paths = [found.locate_file(file) for file in found.files or ()]
        size = sum(path.stat().st_size for path in paths if path.exists())  # type: ignore[attr-defined]
        tell(name, found.version, f"{size / 1e6:.1f}")


def imports() -> None:
    """Milliseconds of the processor for an import, beyond the interpreter's own."""
    plain = _import_seconds("pass")
    tell("import", "ms")
    for line in ("import trabecula", "import trabecula as tb; tb.read", "import scipy.ndimage"):
        tell(line, f"{1000 * (_import_seconds(line) - plain):.0f}")


def _import_seconds(line: str) -> float:
    found = []
    for _ in range(RUNS):
        before = _children()
        subprocess.run([sys.executable, "-c", line], check=True)
        found.append(_children() - before)
    return min(found)


def _children() -> float:
    times = os.times()
    return times.children_user + times.children_system


if __name__ == "__main__":
    pieces()
    sizes()
    imports()
