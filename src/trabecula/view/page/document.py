"""The page as one file: template, style, scripts and volumes put together, with a policy that lets
nothing else in.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.engine.files import replacing
from trabecula.view.looks import as_table
from trabecula.view.page import server
from trabecula.view.picture import check_suffix
from trabecula.view.rays import BLOCK
from trabecula.view.shading import DEPTH, ENTRY, LEAST
from trabecula.view.volume import LEVELS, WEIGHTS

_SCRIPTS = (
    "volume.js",
    "scene.js",
    "drawing.js",
    "slices.js",
    "controls.js",
    "pointer.js",
    "app.js",
)


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
    """

    html: str
    title: str = "trabecula"
    height: int = 640

    def save(self, path: str | PathLike[str]) -> Path:
        """Write it as one self-contained file, ending in .html."""
        check_suffix(path, ".html")
        with replacing(Path(path)) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        return Path(path)

    def show(self, *, port: int = 0, browser: bool = True) -> None:
        """Serve it on this machine alone and open a browser; returns when interrupted. See
        `server.serve`.
        """
        server.serve(self.html, port=port, browser=browser)

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


def document(title: str, about: Mapping[str, Any], volumes: Sequence[str]) -> str:
    """Write the whole page.

    Parameters
    ----------
    title : str
    about : mapping
        Plain JSON for the script: look, volumes, and whether they are aligned.
    volumes : sequence of str
        Their voxels, `pack`.
    """
    style, script = _asset("page.css"), _script()
    policy = (
        f"default-src 'none'; script-src 'sha256-{_hash(script)}'; "
        f"style-src 'sha256-{_hash(style)}'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    tables = {
        **as_table(),
        "block": BLOCK,
        "levels": LEVELS,
        "blur": WEIGHTS[: len(WEIGHTS) // 2 + 1].tolist(),
    }
    constants = (
        f"const float DEPTH = {DEPTH}, ENTRY = {ENTRY}, LEAST = {LEAST}, BLOCK = {float(BLOCK)};"
    )
    blocks = (
        f'<script type="application/gzip" id="voxels-{k}">{text}</script>'
        for k, text in enumerate(volumes)
    )
    parts = {
        "policy": policy,
        "title": escape(title),
        "style": style,
        "volumes": "\n".join(blocks),
        # A name of a file may hold "</script>"; in JSON an escape says the same.
        "page": json.dumps({"title": title, **about, "table": tables}, allow_nan=False).replace(
            "<", "\\u003c"
        ),
        "vertex": _asset("march.vert"),
        "fragment": _asset("march.frag").replace("// {constants}", constants),
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
    parts = "\n".join(_asset(name).replace('"use strict";\n', "") for name in _SCRIPTS)
    return f'(() => {{\n"use strict";\n{head}\n{parts}}})();'


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
