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

# Public name -> the module that holds it. `__init__.pyi` says the same to type checkers:
# `python tests/types/public_stub.py` writes it from these two tables.
_NAMES = {
    "Image": "trabecula.core.image",
    "labels": "trabecula.core.image",
    "Request": "trabecula.core.request",
    "Recipe": "trabecula.core.recipe",
    "progress": "trabecula.core.progress",
    "threads": "trabecula.engine.parallel",
    "kept_at": "trabecula.engine.checkpoint",
    "read": "trabecula.io.files",
    "write": "trabecula.io.files",
    "open_slabs": "trabecula.io.lazy",
    "crop": "trabecula.exemplar.crop",
    "find_margins": "trabecula.exemplar.margins",
    "crop_margins": "trabecula.exemplar.margins",
    "read_mesh": "trabecula.mesh.files",
    "voxelise": "trabecula.mesh.voxels",
    "tetrahedra": "trabecula.mesh.tetrahedra.make",
    "segment": "trabecula.exemplar.segment",
    "sample": "trabecula.exemplar.samples",
    "samples": "trabecula.exemplar.samples",
    "fetch": "trabecula.exemplar.fetch",
    "datasets": "trabecula.exemplar.datasets",
    "describe": "trabecula.measure",
    "method": "trabecula.synth.api.registry",
    "methods": "trabecula.synth.api.registry",
    "ensemble": "trabecula.pipeline.ensemble",
    "match_property": "trabecula.pipeline.property_target",
    "choose_settings": "trabecula.pipeline.trials",
    "load_model": "trabecula.synth.api.serialize",
    "load": "trabecula.pipeline.inputs",
    "export": "trabecula.pipeline.outputs",
    "rerun": "trabecula.pipeline.replay",
    "render": "trabecula.view.still",
    "verify": "trabecula.report.certificate",
    "verify_ensemble": "trabecula.report.ensemble",
    "inspect": "trabecula.report.inspection",
    "print_check": "trabecula.finish.printing",
    "write_layers": "trabecula.layers.write",
    "plan_layers": "trabecula.layers.write",
}
_MODULES = {
    "errors": "trabecula.errors",
    "measure": "trabecula.measure",
    "finish": "trabecula.finish",
    "mesh": "trabecula.mesh",
    "fields": "trabecula.fields",
    "view": "trabecula.view",
}

display.html = "trabecula.view.notebook:as_html"

__all__ = ["__version__", *sorted({*_NAMES, *_MODULES})]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value: Any = importlib.import_module(_MODULES[name])
    elif name in _NAMES:
        value = getattr(importlib.import_module(_NAMES[name]), name)
    else:
        raise AttributeError(f"module 'trabecula' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
