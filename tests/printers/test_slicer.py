"""A slicer itself reads what is exported: PrusaSlicer (`make test-printers`).

It is a Debian package, prusa-slicer; where it is not installed these tests are skipped.
"""

import re
import shutil
import subprocess

import numpy as np
import pytest

import trabecula as tb
from trabecula.mesh.check import check

pytestmark = [
    pytest.mark.whole,
    pytest.mark.skipif(
        shutil.which("prusa-slicer") is None,
        reason="PrusaSlicer is not installed: apt-get install prusa-slicer",
    ),
]


def slicer(*words):
    """Run the slicer without its window; return all that it says."""
    done = subprocess.run(
        ["prusa-slicer", *map(str, words)], capture_output=True, text=True, check=False
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-2000:]
    assert not re.search(r"error|warning|repair", said, re.IGNORECASE), said[-2000:]
    return said


@pytest.fixture(scope="module")
def part():
    """Return a foam in one piece, large enough to print."""
    foam = tb.finish.connect(tb.crop(tb.sample("foam"), 40))
    return tb.Image(foam.values, "labels", 0.4, unit="mm", phases=foam.phases)


@pytest.mark.parametrize("suffix", ["3mf", "stl", "obj"])
@pytest.mark.parametrize("tolerance", [None, 0.5])
def test_it_finds_nothing_to_mend(part, tmp_path, suffix, tolerance):
    path = tb.export(part, tmp_path / f"part.{suffix}", tolerance=tolerance)
    said = slicer("--info", path)
    told = dict(re.findall(r"^(\w+) = +(\S+)$", said, re.MULTILINE))
    surface = tb.read_mesh(path, unit="mm")
    assert told["manifold"] == "yes" and "facets_reversed" not in told
    assert int(told["number_of_facets"]) == len(surface.faces)
    assert float(told["volume"]) == pytest.approx(check(surface).volume, rel=1e-3)
    sizes = [float(told[f"size_{axis}"]) for axis in "xyz"]
    assert np.allclose(sizes, 16, atol=0.05)


def test_it_slices_a_decimated_part_and_fills_as_much(part, tmp_path):
    used = {}
    for name, tolerance in (("whole", None), ("fewer", 0.5)):
        path = tb.export(part, tmp_path / f"{name}.3mf", tolerance=tolerance)
        code = tmp_path / f"{name}.gcode"
        slicer("--export-gcode", "--layer-height", "0.2", "--output", code, path)
        used[name] = float(re.search(r"filament used \[mm\] = (\S+)", code.read_text())[1])
    assert used["fewer"] == pytest.approx(used["whole"], rel=0.03)


def test_several_phases_arrive_as_several_parts(tmp_path):
    values = np.zeros((20, 16, 16), np.uint8)
    values[2:10, 2:-2, 2:-2], values[10:18, 2:-2, 2:-2] = 1, 2
    image = tb.Image(values, "labels", 1.0, unit="mm", phases=("void", "steel", "rubber"))
    path = tb.export(image, tmp_path / "two.3mf", phase=["steel", "rubber"])
    assert slicer("--info", path).count("manifold = yes") == 2
