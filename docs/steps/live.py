"""The page to turn on the landing page: an exemplar and material made from it, one file."""

from __future__ import annotations

from pathlib import Path

import trabecula as tb

_SIDE = 72
_SEED = 7


def draw(folder: Path) -> None:
    """Make material and write live.html into `folder`."""
    exemplar = tb.crop(tb.sample("bone"), _SIDE)
    material = tb.finish.connect(tb.method("texture").fit(exemplar).generate(_SIDE, seed=_SEED))
    page = tb.view(exemplar, material, names=["the exemplar", "made from it"], title="trabecula")
    folder.mkdir(parents=True, exist_ok=True)
    page.save(folder / "live.html")
