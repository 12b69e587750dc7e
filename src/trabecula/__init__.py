"""Trabecula: porous and heterogeneous materials by example.

    exemplar = tb.read("femur.tif", spacing=19.5, unit="um")
    model    = tb.method("texture").fit(exemplar)
    material = model.generate((240, 240, 240), seed=7)
    part     = tb.finish.connect(material)
    verdict  = tb.verify(exemplar, part)
    tb.write(part, "femur.zarr"); tb.export(part, "femur.stl"); tb.view(part)

Everything public is a name of this module, loaded at its first use.
"""

import importlib
from typing import Any

from trabecula.core import display

__version__ = "0.1.0"

# public name -> the module that holds it
_HOMES = {
    "Image": "core.image",
    "labels": "core.image",
    "Request": "core.request",
    "Recipe": "core.recipe",
    "threads": "engine.parallel",
    "kept_at": "engine.checkpoint",
    "read": "io.files",
    "write": "io.files",
    "open_slabs": "io.lazy",
    "crop": "exemplar.crop",
    "find_margins": "exemplar.margins",
    "crop_margins": "exemplar.margins",
    "read_mesh": "mesh.files",
    "voxelise": "mesh.voxels",
    "segment": "exemplar.segment",
    "sample": "exemplar.samples",
    "samples": "exemplar.samples",
    "describe": "measure",
    "method": "synth.api.registry",
    "methods": "synth.api.registry",
    "load_model": "synth.api.serialize",
    "load": "pipeline.demo",
    "export": "pipeline.demo",
    "rerun": "pipeline.demo",
    "render": "view.still",
    "verify": "report.certificate",
    "inspect": "report.inspection",
    "print_check": "finish.printing",
}
_ROOMS = {
    "errors": "errors",
    "measure": "measure",
    "finish": "finish",
    "mesh": "mesh",
    "fields": "fields",
    "view": "view",
}

display.html = "trabecula.view.notebook:as_html"

__all__ = ["__version__", *sorted({*_HOMES, *_ROOMS})]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        value: Any = importlib.import_module(f"trabecula.{_ROOMS[name]}")
    elif name in _HOMES:
        value = getattr(importlib.import_module(f"trabecula.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'trabecula' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
