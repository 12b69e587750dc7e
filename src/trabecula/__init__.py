"""Trabecula: porous and heterogeneous materials by example.

    exemplar = tb.read("femur.tif", spacing=19.5, unit="um")
    model    = tb.method("texture").fit(exemplar)
    material = model.generate((240, 240, 240), seed=7)
    part     = tb.finish.connect(material)
    verdict  = tb.verify(exemplar, part)
    tb.write(part, "femur.zarr"); tb.export(part, "femur.stl")

Everything public is a name of this module, loaded at its first use.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

# public name -> the module that holds it (a name equal to its module's last part is the module itself)
_HOMES = {
    "Image": "trabecula.core.image",
    "labels": "trabecula.core.image",
    "Request": "trabecula.core.request",
    "Recipe": "trabecula.core.recipe",
    "errors": "trabecula.core.errors",
    "threads": "trabecula.engine.tiles",
    "read": "trabecula.io.files",
    "write": "trabecula.io.files",
    "segment": "trabecula.exemplar.segment",
    "crop": "trabecula.exemplar.crop",
    "samples": "trabecula.exemplar.samples",
    "measure": "trabecula.measure",
    "describe": "trabecula.measure.describe",
    "method": "trabecula.synth.registry",
    "methods": "trabecula.synth.registry",
    "finish": "trabecula.finish",
    "mesh": "trabecula.mesh.surface",
    "export": "trabecula.flow",
    "render": "trabecula.view.still",
    "verify": "trabecula.report.certificate",
    "rerun": "trabecula.flow",
}

__all__ = ["__version__", *sorted(_HOMES)]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'trabecula' has no attribute {name!r}")
    module = importlib.import_module(_HOMES[name])
    value = module if module.__name__.rpartition(".")[2] == name and not callable(getattr(module, name, None)) else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
