"""Measure again what README and docs quote, and fail where a figure moved: `make figures`.

    python benchmarks/quoted.py [NAME ...]

quoted.toml lists the figures: the words in the file, what measures them, and how far each may move.
Every row of the README's table is among them. Tables of figures.md are not measured again: their
cases take hours, or scans that are not part of the project. Where the README sums one up, the sum
is made again from the table's rows.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".toml")
Figures = Mapping[str, float]
_MATERIALS = 14
"""Rows of the table of materials."""


def main(names: Sequence[str]) -> int:
    """Print every figure beside what was measured, and return 1 where one moved."""
    entries = [one for one in read() if not names or one["measure"] in names]
    found: dict[str, Figures] = {}
    moved = 0
    for entry in entries:
        name = entry["measure"]
        if name not in found:
            found[name] = MEASURES[name]()
        for fault in compare(entry, found[name]):
            moved += 1
            print(f"MOVED  {fault}")
        print(f"{entry['file']}: {entry['text']!r}: measured {dict(found[name])}", flush=True)
    print(f"{len(entries)} places, {moved} figures moved")
    return 1 if moved else 0


def read(path: Path = LIST) -> list[dict[str, Any]]:
    """Return the entries of the list."""
    return tomllib.loads(path.read_text(encoding="utf-8"))["quoted"]


def compare(entry: Mapping[str, Any], found: Figures, root: Path = ROOT) -> list[str]:
    """Return what is wrong with an entry: its words are gone, or a figure lies outside."""
    faults = []
    if entry["text"] not in (root / entry["file"]).read_text(encoding="utf-8"):
        faults.append(f"{entry['file']} does not say {entry['text']!r}")
    for name, quoted in entry["figures"].items():
        if abs(found[name] - quoted) > entry["within"] * abs(quoted):
            faults.append(
                f"{entry['file']}: {name} is quoted as {quoted}, and {found[name]:.4g} was measured"
            )
    return faults


def measure_strip() -> Figures:
    """Judge the material of the README's strip, as docs/steps/strip.py makes it."""
    import trabecula as tb

    exemplar = tb.sample("bone")
    material = tb.finish.connect(tb.method("texture").fit(exemplar).generate(120, seed=7))
    metrics = tb.verify(exemplar, material).metrics.values()
    return {
        "passed": sum(one.passed is True for one in metrics),
        "judged": sum(one.passed is not None for one in metrics),
    }


def measure_bubbles() -> Figures:
    """Grow 7,000 bubbles on 384^3 with one thread, kernels compiled, best of three."""
    from bubbles import _best, _model, grown
    from trabecula.engine.parallel import threads

    with threads(1):
        grown(_model(32), 32)
        return {"seconds": _best(_model(384), 384)}


def measure_quilt() -> Figures:
    """Make the cantilever of lattice with turned patches and without, one thread."""
    import trabecula as tb
    from common import busy
    from graded import WAYS
    from graded_lattice import reference
    from trabecula import fields
    from trabecula.engine.parallel import threads

    field = fields.resample(fields.simp("cantilever"), (160, 80, 300))
    request = tb.Request(field.shape, seed=1, target={"volume_fraction": field})
    found, parts = [], []
    with threads(1):
        for settings in WAYS.values():
            model = tb.method("quilt", **settings).fit(reference())
            model.generate(32, seed=1, target={"volume_fraction": 0.5})  # kernels
            seconds, made = busy(lambda model=model: model.generate(request))
            found.append(seconds)
            parts.append(tb.measure.components(made))
    return {"least": min(found), "most": max(found), "components": max(parts)}


def measure_gan() -> Figures:
    """Make 420^3 of bone by the shipped model into a store, one thread; needs PyTorch."""
    import trabecula as tb
    from common import busy
    from trabecula.engine.parallel import threads
    from trabecula.pipeline.generate import generate_to

    with threads(1), tempfile.TemporaryDirectory() as folder:
        model = tb.load_model("bone")
        model.generate(64, seed=0)
        request = tb.Request((420,) * 3, seed=1)
        return {"seconds": busy(lambda: generate_to(model, request, Path(folder) / "b.zarr"))[0]}


def sum_materials() -> Figures:
    """Sum up the table of materials in figures.md: figures in band, of three seeds each."""
    text = (ROOT / "docs" / "guide" / "figures.md").read_text(encoding="utf-8")
    table = text.partition("| out, before | out, now |")[2]
    rows = re.findall(r"\| (\d+, \d+, \d+) of (\d+) (?=\|)", table)[:_MATERIALS]
    now = [(sum(map(int, out.split(", "))), 3 * int(number)) for out, number in rows]
    outside, figures = (sum(column) for column in zip(*now, strict=True))
    return {
        "materials": len(now),
        "figures": figures,
        "percent": round(100 * (1 - outside / figures), 1),
    }


def measure_wheel() -> Figures:
    """Build the wheel."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, str(ROOT)]
        subprocess.run([sys.executable, *words], check=True)
        (wheel,) = Path(folder).glob("*.whl")
        return {"megabytes": wheel.stat().st_size / 1e6}


def measure_extras() -> Figures:
    """Read the lowest version of PyTorch that is allowed, and the pinned one."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    pins = (ROOT / "requirements" / "learn.txt").read_text(encoding="utf-8")
    lowest = re.search(r"torch>=(\d+\.\d+)", project)[1]
    return {"lowest": float(lowest), "pinned": float(re.search(r"torch==(\d+\.\d+)", pins)[1])}


MEASURES: dict[str, Callable[[], Figures]] = {
    "strip": measure_strip,
    "bubbles": measure_bubbles,
    "quilt": measure_quilt,
    "gan": measure_gan,
    "materials": sum_materials,
    "wheel": measure_wheel,
    "extras": measure_extras,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
