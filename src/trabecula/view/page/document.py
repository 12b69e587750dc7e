"""The page as one file: template, style, scripts and volumes put together, with a policy that lets
nothing else in.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.engine.files import replacing
from trabecula.view.colouring import ANCHORS, BANDS
from trabecula.view.looks import as_table
from trabecula.view.page import server
from trabecula.view.picture import check_suffix
from trabecula.view.rays import BLOCK
from trabecula.view.shading import DEPTH, ENTRY, LEAST
from trabecula.view.volume import LEVELS, WEIGHTS

_SCRIPTS = (
    "volume.js",
    "scene.js",
    "lines.js",
    "drawing.js",
    "probe.js",
    "tape.js",
    "slices.js",
    "controls.js",
    "state.js",
    "detail.js",
    "pointer.js",
    "endless.js",
    "app.js",
)
_WORKER = ("philox.js", "convolution.js", "network.js", "maker.js", "worker.js")


@dataclass(frozen=True)
class Live:
    """A page that asks its server for finer voxels.

    Parameters
    ----------
    html : str
    boxes : callable, optional
        `boxes(volume, fine, low, size)` gives the bytes of a box; `server.Boxes`.
    """

    html: str
    boxes: server.Boxes | None


@dataclass(frozen=True)
class Page:
    """A page that shows volumes: `save` it, `show` it in a browser, or let a notebook display it.

    Parameters
    ----------
    html : str
        All of it.
    title : str
    height : int
        Pixels that it takes in a notebook.
    live : Live, optional
        What a server shows in its place, where the page alone holds blocks of voxels.
    """

    html: str
    title: str = "trabecula"
    height: int = 640
    live: Live | None = None

    def save(self, path: str | PathLike[str]) -> Path:
        """Write it as one self-contained file, ending in .html."""
        check_suffix(path, ".html")
        with replacing(Path(path)) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        return Path(path)

    def show(
        self,
        *,
        port: int = 0,
        browser: bool = True,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        """Serve it on this machine alone and open a browser; returns when interrupted. See
        `server.serve`.
        """
        live = self.live or Live(self.html, None)
        server.serve(live.html, port=port, browser=browser, tell=tell, boxes=live.boxes)

    def _repr_html_(self) -> str:
        frame = (
            'style="width:100%;border:1px solid #d5d9df" sandbox="allow-scripts allow-downloads"'
        )
        return (
            f'<iframe title="{escape(self.title)}" height="{self.height}" {frame} '
            f'srcdoc="{escape(self.html)}"></iframe>'
        )

    def __repr__(self) -> str:
        return f"<Page {self.title!r}, {len(self.html) / 1e6:.1f} MB: .save(path), .show()>"


def pack(values: np.ndarray) -> str:
    """Pack bytes as the page unpacks them: gzip in base64, the same for the same bytes."""
    return base64.b64encode(gzip.compress(values.tobytes(), compresslevel=6, mtime=0)).decode(
        "ascii"
    )


def document(
    title: str,
    about: Mapping[str, Any],
    volumes: Sequence[str],
    blocks: Mapping[str, str] | None = None,
    *,
    live: bool = False,
) -> str:
    """Write the whole page.

    Parameters
    ----------
    title : str
    about : mapping
        Plain JSON for the script: look, volumes, and whether they are aligned.
    volumes : sequence of str
        Their voxels, `pack`.
    blocks : mapping, optional
        Further packed bytes by the names of their elements: "field-VOLUME-FIELD",
        "lines-VOLUME", and of endless material "weights" and "quantiles".
    live : bool
        It may ask its own server.
    """
    style, script = _asset("page.css"), _script()
    endless = "endless" in about  # a worker of this page's own text, and its kernel
    run, work = (" 'wasm-unsafe-eval'", "; worker-src blob:") if endless else ("", "")
    policy = (
        f"default-src 'none'; script-src 'sha256-{_hash(script)}'{run}; "
        f"style-src 'sha256-{_hash(style)}'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
        + work
        + ("; connect-src 'self'" if live else "")
    )
    tables = {
        **as_table(),
        "block": BLOCK,
        "levels": LEVELS,
        "ramp": ANCHORS.tolist(),
        "bands": BANDS,
        "blur": WEIGHTS[: len(WEIGHTS) // 2 + 1].tolist(),
    }
    constants = (
        f"const float DEPTH = {DEPTH}, ENTRY = {ENTRY}, LEAST = {LEAST}, BLOCK = {float(BLOCK)}, "
        f"BANDS = {float(BANDS)};"
    )
    packed = {f"voxels-{k}": text for k, text in enumerate(volumes)}
    packed |= blocks or {}
    elements = (
        f'<script type="application/gzip" id="{name}">{text}</script>'
        for name, text in packed.items()
    )
    parts = {
        "policy": policy,
        "title": escape(title),
        "style": style,
        "volumes": "\n".join(elements),
        # A name of a file may hold "</script>"; in JSON an escape says the same.
        "page": json.dumps({"title": title, **about, "table": tables}, allow_nan=False).replace(
            "<", "\\u003c"
        ),
        "vertex": _asset("march.vert"),
        "fragment": _asset("march.frag").replace("// {constants}", constants),
        "showing": _asset("show.frag"),
        "linevertex": _asset("lines.vert"),
        "linefragment": _asset("lines.frag"),
        "worker": _joined(_WORKER) if endless else "",
        "script": script,
    }
    # In one pass, so that nothing that is put in is taken for a place to put something.
    return re.sub(r"\{(\w+)\}", lambda place: parts.get(place[1], place[0]), _asset("page.html"))


@cache
def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


@cache
def _script() -> str:
    head = (
        'const PAGE = JSON.parse(document.getElementById("page").textContent), TABLE = PAGE.table;'
    )
    return f'(() => {{\n"use strict";\n{head}\n{_joined(_SCRIPTS)}}})();'


def _joined(names: Sequence[str]) -> str:
    """Return scripts one after the other."""
    return "\n".join(_asset(name).replace('"use strict";\n', "") for name in names)


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
