"""`trabecula view FILE [FILE2 ...] [--endless MODEL] [--html OUT]`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import view_input
from trabecula.core.errors import FileError, InputError

_LINES = 150


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the files, the page's place and the figures beside them."""
    parser.add_argument(
        "files",
        nargs="*",
        metavar="FILE",
        help="volumes or pictures side by side, or sample:NAME; 6 at most",
    )
    parser.add_argument(
        "--endless",
        metavar="MODEL",
        help="a model of gan, by file or name (trabecula models), that makes new material in the "
        "page: other seeds, sizes, porosities; beside its exemplar, the first FILE, if any",
    )
    parser.add_argument(
        "--side", default="64", metavar="N", help="of endless material: 32, 64 (default), 96 or 128"
    )
    parser.add_argument("--seed", default="0", metavar="N", help="of endless material (default 0)")
    parser.add_argument(
        "--html",
        metavar="OUT",
        help="write the page as one file that needs no network, and open nothing",
    )
    parser.add_argument(
        "--look", default="bone", help="bone (default), foam, bread, sponge or stone: to begin with"
    )
    parser.add_argument(
        "--certificate",
        metavar="FILE",
        help="what `trabecula verify --json` printed: its key figures stand beside each FILE, or "
        "each but the first",
    )
    parser.add_argument(
        "--field",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="a field (trabecula field) that may colour the FILE of its shape, and that the probe "
        "reads; again for more",
    )
    parser.add_argument(
        "--streamlines",
        metavar="AXIS",
        help="solve slow flow through the void of the first FILE along z, y or x, and draw 150 "
        "streamlines",
    )
    parser.add_argument(
        "--port", default="0", metavar="N", help="of 127.0.0.1 (default: a free one)"
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="print the address, open no browser"
    )
    view_input.add_memory(parser)
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Make the page; write it, or serve it until interrupted."""
    from trabecula.cli import terminal
    from trabecula.pipeline.certificate_page import check_page
    from trabecula.pipeline.inputs import load
    from trabecula.synth.api.serialize import load_model
    from trabecula.view.page import view

    if not (options.files or options.endless):
        raise InputError("nothing to show: name a FILE, or a model with --endless")
    if options.html:
        check_page(options.html)
    port = shared.integer(options.port, name="--port")
    certificate = _certificate(options.certificate) if options.certificate else None
    # Greys are shown as they are, unless a threshold is given.
    options.threshold = options.threshold or "none"
    fields = {name: load(file, threshold="none") for name, file in map(_field_words, options.field)}
    images = [_load(file, options) for file in options.files]
    names = [Path(file).name for file in options.files]
    page = view(
        *images,
        names=names,
        look=options.look,
        certificate=certificate,
        fields=fields,
        streamlines=_streamlines(images, options.streamlines),
        endless=load_model(options.endless) if options.endless else None,
        side=shared.integer(options.side, name="--side"),
        seed=shared.integer(options.seed, name="--seed"),
    )
    if options.html:
        page.save(options.html)
        print(f"{options.html}: {len(page.html) / 1e6:.1f} MB")
        return 0
    page.show(port=port, browser=not options.no_browser, tell=terminal.note)
    return 0


def _load(file: str, options: argparse.Namespace) -> Any:
    """Load a volume; labels in a store that a tab does not hold are read as they are needed."""
    from trabecula.view.page.fitting import forecast

    slabs = view_input.slabs_for_page(file, options)
    if slabs is not None:
        return slabs
    return view_input.load_for_view(file, options, need=lambda *volume: forecast(*volume).peak)


def _streamlines(images: list[Any], axis: str | None) -> Any:
    """Return the streamlines of the first volume; None where none are asked for."""
    from trabecula.core.checks import check_name
    from trabecula.core.image import Image
    from trabecula.measure import streamlines

    if axis is None:
        return None
    check_name(axis, "zyx", name="axis of --streamlines")
    if not images or not isinstance(images[0], Image) or images[0].kind != "labels":
        raise InputError(
            "--streamlines: the first FILE is no volume of labels in memory; give one, or --crop"
        )
    lines = streamlines(images[0], axis="zyx".index(axis), count=_LINES)
    if not lines:
        raise InputError(f"--streamlines {axis}: the void does not percolate along {axis}")
    return lines


def _field_words(text: str) -> tuple[str, str]:
    name, sign, file = text.partition("=")
    if not (sign and name and file):
        raise InputError(f"--field {text}: write NAME=FILE, such as thickness=thickness.npy")
    return name, file


def _certificate(path: str) -> Any:

    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror}; check the path") from error
    except (ValueError, RecursionError):
        raise InputError(
            f"{path} is no JSON: write it with `trabecula verify ... --json > {path}`"
        ) from None
