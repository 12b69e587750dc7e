"""The output of `mrf` at one scale, for its tests."""

from trabecula.engine.memory import Workspace
from trabecula.synth.mrf.lattice import build_lattices, lattice_at, lattice_stages


def empty_lattice(model, request):
    """Return the only scale of an output, before it is started."""
    sizes = {"count": 1, "width": model.config.neighbourhood}
    work = Workspace(lattice_stages(request, model.content, **sizes))
    build_lattices(work, request, model.content, **sizes)
    return lattice_at(work, request, 0)
