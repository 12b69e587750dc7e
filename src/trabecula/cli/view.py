"""`trabecula view FILE [FILE2 ...] [--html OUT]`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import view_input
from trabecula.core.errors import FileError, InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the files, the page's place and the figures beside them."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="volumes or pictures side by side, or sample:NAME; 6 at most",
    )
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
    from trabecula.view.page import server, view
    from trabecula.view.page.fitting import forecast

    if options.html:
        check_page(options.html)
    port = shared.integer(options.port, name="--port")
    certificate = _certificate(options.certificate) if options.certificate else None
    # Greys are shown as they are, unless a threshold is given.
    options.threshold = options.threshold or "none"
    images = [
        view_input.load_for_view(file, options, need=lambda *volume: forecast(*volume).peak)
        for file in options.files
    ]
    names = [Path(file).name for file in options.files]
    page = view(*images, names=names, look=options.look, certificate=certificate)
    if options.html:
        page.save(options.html)
        print(f"{options.html}: {len(page.html) / 1e6:.1f} MB")
        return 0
    server.serve(page.html, port=port, browser=not options.no_browser, tell=terminal.note)
    return 0


def _certificate(path: str) -> Any:

    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror}; check the path") from error
    except (ValueError, RecursionError):
        raise InputError(
            f"{path} is no JSON: write it with `trabecula verify ... --json > {path}`"
        ) from None
