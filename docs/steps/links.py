"""Check the built site: its links lead somewhere, and nothing is loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

_LOADS = {"img": "src", "script": "src", "iframe": "src", "source": "src", "video": "src"}
_SHEETS = {"stylesheet", "icon", "preload", "preconnect"}


class _Page(HTMLParser):
    """The links, the loaded files and the anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        elif tag == "link" and _SHEETS & set(given.get("rel", "").split()):
            self.loads.append(given.get("href", ""))
        elif given.get(_LOADS.get(tag, "")):
            self.loads.append(given[_LOADS[tag]])


def check(site: Path) -> list[str]:
    """Return what is wrong with the site, a line each."""
    pages = {path: _parse(path) for path in sorted(site.rglob("*.html"))}
    return [
        f"{path.relative_to(site)}: {fault}" for path in pages for fault in _faults(path, pages)
    ]


def _parse(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def _faults(path: Path, pages: dict[Path, _Page]) -> Iterator[str]:
    page = pages[path]
    for load in page.loads:
        if urlsplit(load).netloc:
            yield f"loads {load} from elsewhere"
    for link in dict.fromkeys([*page.links, *page.loads]):
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            continue
        place, anchor = urldefrag(link)
        target = (path.parent / unquote(urlsplit(place).path)).resolve() if place else path
        if target.is_dir():
            target /= "index.html"
        if not target.is_file():
            yield f"{link} leads nowhere"
        elif anchor and target in pages and unquote(anchor) not in pages[target].anchors:
            yield f"{link}: there is no such place on that page"
