"""`trabecula render FILE --out still.png`."""

from __future__ import annotations

import argparse

from trabecula.cli import options as shared


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file, the picture, the look."""
    parser.add_argument("file", metavar="FILE", help="volume, or sample:NAME")
    parser.add_argument("--out", required=True, metavar="FILE", help="picture to write (.png)")
    parser.add_argument("--look", default="bone", help="bone, foam, bread, sponge or stone")
    parser.add_argument("--size", nargs=2, default=["800", "600"], metavar=("W", "H"), help="pixels (default 800 600)")
    parser.add_argument("--cut", default="corner", help="corner (default) or none")
    parser.add_argument(
        "--camera", nargs=2, default=["32", "26"], metavar=("AZ", "EL"), help="degrees around and above"
    )
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Render and write."""
    from trabecula.flow import check_target
    from trabecula.view.still import render

    check_target(options.out)
    image = shared.load_exemplar(options.file, options)
    size = shared.integers(options.size, name="--size")
    azimuth, elevation = shared.numbers(options.camera, name="--camera")
    render(
        image,
        options.out,
        look=options.look,
        size=(size[0], size[1]),
        cut=options.cut,
        camera=(azimuth, elevation),
    )
    print(f"{options.out}: {size[0]} x {size[1]} pixels")
    return 0
