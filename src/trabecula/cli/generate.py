"""`trabecula generate EXEMPLAR ... --method NAME --shape Z Y X --seed N --out FILE`."""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to make, from what, and where to put it."""
    add_request(parser)
    parser.add_argument(
        "--out", required=True, metavar="FILE", help="volume to write (.zarr .tif .npy .mhd .nrrd .nii.gz .vti)"
    )
    parser.add_argument("--json", action="store_true", help="print what was made as JSON")


def add_request(parser: argparse.ArgumentParser) -> None:
    """The options that `plan` shares."""
    parser.add_argument(
        "exemplars",
        nargs="+",
        metavar="EXEMPLAR",
        help="scan to learn from, or sample:NAME; several where the method can",
    )
    parser.add_argument("--method", default="texture", help="see trabecula methods (default: texture)")
    parser.add_argument(
        "--shape",
        nargs="+",
        metavar="N",
        help="voxels: one number (a cube), or z y x (default: that of --mask, --fixed)",
    )
    parser.add_argument("--seed", default="0", help="0 .. 2**63 - 1 (default 0)")
    parser.add_argument("--preset", help="ready settings of the method")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the method; repeatable"
    )
    parser.add_argument(
        "--memory", type=shared.gibibytes, metavar="GIB", help="memory that may be used (default: what is available)"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads (default: every core)")
    shared.add_parts(parser)
    shared.add_reading(parser)


def prepare(options: argparse.Namespace) -> tuple[Any, Any, Any]:
    """The method, its exemplar (a list of several) and the request. What can be refused without work is refused first."""
    from trabecula.core.checks import as_seed, as_shape
    from trabecula.core.errors import InputError
    from trabecula.core.request import Request
    from trabecula.synth.registry import method

    chosen = method(options.method, preset=options.preset, **shared.settings(options.set))
    if options.shape is None and options.mask is None and options.fixed is None:
        raise InputError("the size of the result is not given: add --shape N, or --shape Z Y X (or a --mask)")
    shape = None if options.shape is None else as_shape(shared.integers(options.shape, name="--shape"))
    seed = as_seed(shared.integer(options.seed, name="--seed"))
    periodic = shared.periodic(options.periodic)
    exemplars = [shared.load_exemplar(source, options) for source in options.exemplars]
    parts = shared.load_parts(options, exemplars, shape, getattr(chosen.config, "views", ()))
    if shape is None:
        shape = (parts["mask"] if "mask" in parts else parts["fixed"]).shape
    request = Request(shape, seed=seed, periodic=periodic, **parts)
    return chosen, exemplars if len(exemplars) > 1 else exemplars[0], request


def run(options: argparse.Namespace) -> int:
    """Generate and write; a run that was interrupted goes on from what it left beside --out."""
    from trabecula.engine.checkpoint import kept_at
    from trabecula.engine.tiles import thread_count, threads
    from trabecula.flow import check_target, part_of
    from trabecula.io.files import write

    check_target(options.out)
    with threads(options.threads if options.threads is not None else thread_count()):
        method, exemplar, request = prepare(options)
        model = method.fit(exemplar, memory=options.memory)
        plan = model.plan(request)
        check_target(options.out, size=plan.disk)
        with kept_at(part_of(options.out)):
            material = model.generate(request, memory=options.memory)
            write(material, options.out)
    digest = material.recipe.steps[-1]["sha256"]
    if options.json:
        terminal.show_json(
            {"out": options.out, "shape": material.shape, "sha256": digest, "recipe": material.recipe.to_json()}
        )
    else:
        print(f"{options.out}: {material!r}\nsha256 {digest}")
    return 0
