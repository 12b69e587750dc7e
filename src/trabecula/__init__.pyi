"""Types of the public names; written by `python tests/types/public_stub.py`."""

from trabecula import errors as errors
from trabecula import fields as fields
from trabecula import finish as finish
from trabecula import measure as measure
from trabecula.core.image import Image as Image
from trabecula.core.image import labels as labels
from trabecula.core.progress import progress as progress
from trabecula.core.recipe import Recipe as Recipe
from trabecula.core.request import Request as Request
from trabecula.engine.checkpoint import kept_at as kept_at
from trabecula.engine.parallel import threads as threads
from trabecula.exemplar.crop import crop as crop
from trabecula.exemplar.datasets import datasets as datasets
from trabecula.exemplar.fetch import fetch as fetch
from trabecula.exemplar.margins import crop_margins as crop_margins
from trabecula.exemplar.margins import find_margins as find_margins
from trabecula.exemplar.samples import sample as sample
from trabecula.exemplar.samples import samples as samples
from trabecula.exemplar.segment import segment as segment
from trabecula.finish.printing import print_check as print_check
from trabecula.io.files import read as read
from trabecula.io.files import write as write
from trabecula.io.lazy import open_slabs as open_slabs
from trabecula.layers.write import plan_layers as plan_layers
from trabecula.layers.write import write_layers as write_layers
from trabecula.measure import describe as describe
from trabecula.mesh.files import read_mesh as read_mesh
from trabecula.mesh.surface import mesh as mesh
from trabecula.mesh.tetrahedra.make import tetrahedra as tetrahedra
from trabecula.mesh.voxels import voxelise as voxelise
from trabecula.pipeline.ensemble import ensemble as ensemble
from trabecula.pipeline.inputs import load as load
from trabecula.pipeline.outputs import export as export
from trabecula.pipeline.property_target import match_property as match_property
from trabecula.pipeline.replay import rerun as rerun
from trabecula.pipeline.trials import choose_settings as choose_settings
from trabecula.report.certificate import verify as verify
from trabecula.report.ensemble import verify_ensemble as verify_ensemble
from trabecula.report.inspection import inspect as inspect
from trabecula.synth.api.registry import method as method
from trabecula.synth.api.registry import methods as methods
from trabecula.synth.api.serialize import load_model as load_model
from trabecula.view.page import view as view
from trabecula.view.still import render as render

__version__: str
__all__ = [
    "Image",
    "Recipe",
    "Request",
    "__version__",
    "choose_settings",
    "crop",
    "crop_margins",
    "datasets",
    "describe",
    "ensemble",
    "errors",
    "export",
    "fetch",
    "fields",
    "find_margins",
    "finish",
    "inspect",
    "kept_at",
    "labels",
    "load",
    "load_model",
    "match_property",
    "measure",
    "mesh",
    "method",
    "methods",
    "open_slabs",
    "plan_layers",
    "print_check",
    "progress",
    "read",
    "read_mesh",
    "render",
    "rerun",
    "sample",
    "samples",
    "segment",
    "tetrahedra",
    "threads",
    "verify",
    "verify_ensemble",
    "view",
    "voxelise",
    "write",
    "write_layers",
]
