"""A user's script in which a type checker knows every type: read, fit, generate, measure, verify,
finish, write, export.
"""

from pathlib import Path
from typing import Any, assert_type

from numpy.typing import NDArray

import trabecula as tb
from trabecula.core.image import Image
from trabecula.finish import PrintCheck
from trabecula.mesh.base import Mesh
from trabecula.report.metrics import Metric
from trabecula.report.verdict import Certificate
from trabecula.synth.api import Capabilities, Method, Model


def ensemble(exemplar: tb.Image, folder: Path, seeds: range) -> list[tb.Image]:
    """Make connected volumes like an exemplar, each into a store."""
    capabilities = assert_type(tb.methods()["texture"], Capabilities)
    method = assert_type(tb.method(capabilities.name, neighbourhood=4, rounds=(1,)), Method)
    model = assert_type(method.fit(exemplar), Model)
    parts: list[tb.Image] = []
    for seed in seeds:
        with tb.threads(1):
            material = assert_type(model.generate((20, 20, 24), seed=seed), Image)
        parts.append(tb.finish.connect(material, reach=8))
        tb.write(parts[-1], folder / f"volume{seed}.zarr")
    return parts


def main(folder: Path) -> dict[str, float]:
    """Return figures of an ensemble."""
    tb.write(tb.crop(tb.sample("bone"), 24), folder / "scan.npy")
    exemplar = assert_type(tb.read(folder / "scan.npy", spacing=0.05, unit="mm"), Image)
    part, *others = parts = ensemble(exemplar, folder, range(2))
    porosity = [assert_type(tb.measure.porosity(one), float) for one in parts]
    curve: NDArray[Any] = tb.measure.two_point(part, r_max=8)
    verdict = assert_type(tb.verify(exemplar, part, r_max=8, level="quick"), Certificate)
    metric = assert_type(verdict.metrics["porosity"], Metric)
    assert_type(tb.verify(exemplar, part, *others, level="quick"), list[Certificate])
    check = assert_type(tb.print_check(part, printer="sla"), PrintCheck)
    surface = assert_type(tb.mesh(part, phase="solid"), Mesh)
    field = assert_type(tb.fields.ramp((8, 8, 8), start=0.2, end=0.6), Image)
    assert_type(part.spacing, tuple[float, ...])
    assert_type(verdict.passed, bool | None)
    tb.export(part, folder / "part.stl", scale=10)
    tb.render(part, folder / "part.png", size=(64, 48))
    tb.view(part).save(folder / "part.html")
    try:
        tb.read(folder / "missing.npy")
    except tb.errors.FileError as error:
        assert_type(error, tb.errors.FileError)
    figures = {"porosity": sum(porosity) / len(porosity), "exemplar": float(metric.exemplar)}
    sizes = {"faces": len(surface.faces), "curve": len(curve), "findings": len(check.findings)}
    return {**figures, **sizes, "field": float(field.values.mean())}
