"""A server of one page on this machine: 127.0.0.1, a token that opens once, no other file.

The address holds a token. Whoever comes with it first gets a cookie that opens the page from then
on, and the token is spent; so an address seen in a list of processes or in a history is worth
nothing. The name in the Host header has to be this machine's, against pages elsewhere that give
their name this machine's address.
"""

from __future__ import annotations

import contextlib
import gzip
import hmac
import os
import secrets
import sys
import threading
import webbrowser
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from trabecula.core.errors import InputError

HOST = "127.0.0.1"

Triple = tuple[int, int, int]
Boxes = Callable[[int, int, Triple, Triple], bytes]
"""Volume, fineness, first voxel and size (z, y, x), in voxels of the page -> voxels as bytes; an
InputError where there is no such box.
"""


class PageServer(ThreadingHTTPServer):
    """Server of `html` at `url`, which works once; of finer voxels at /box where `boxes` gives
    them.

    Raises
    ------
    InputError
        The port is taken, or is none.
    """

    daemon_threads = True
    allow_reuse_address = False

    def __init__(self, html: str, *, port: int = 0, boxes: Boxes | None = None) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"port {port} is outside 0..65535 (0 takes a free one)")
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            reason = error.strerror or error
            raise InputError(
                f"port {port} cannot be used ({reason}): leave --port out to take a free one"
            ) from error
        self.body = html.encode()
        self.boxes = boxes
        self.token: str | None = secrets.token_urlsafe(32)
        self.cookie = secrets.token_urlsafe(32)
        self.lock = threading.Lock()

    @property
    def url(self) -> str:
        """Return the address of the page, with the token while it is not spent."""
        return f"http://{HOST}:{self.server_port}/" + (f"?token={self.token}" if self.token else "")

    def spend(self, given: str) -> bool:
        """Return whether it is the token, which is none from then on."""
        with self.lock:
            if self.token is None or not hmac.compare_digest(given.encode(), self.token.encode()):
                return False
            self.token = None
            return True


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version, sys_version = "trabecula", ""

    def do_GET(self) -> None:
        """Send the page to a browser with the cookie, the cookie to one with the token."""
        port = self.server.server_port
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            self._answer(403, "this address is not served here")
            return
        place = urlsplit(self.path)
        known = hmac.compare_digest(self._cookie().encode(), self.server.cookie.encode())
        if place.path == "/box" and self.server.boxes is not None and known:
            self._box(self.server.boxes, parse_qs(place.query))
        elif place.path != "/":
            self._answer(404, "there is nothing here")
        elif known:
            self._answer(200, self.server.body, kind="text/html; charset=utf-8")
        elif self.server.spend(parse_qs(place.query).get("token", [""])[0]):
            # To the address without the token, so that no history keeps it.
            cookie = f"{self._name}={self.server.cookie}; HttpOnly; SameSite=Lax; Path=/"
            self._answer(303, "", headers={"Location": "/", "Set-Cookie": cookie})
        else:
            self._answer(
                403, "this page opens once, with the address that trabecula printed: run it again"
            )

    def _box(self, boxes: Boxes, query: dict[str, list[str]]) -> None:
        """Send a box of finer voxels."""
        try:
            volume, fine = (int(query[name][0]) for name in ("volume", "fine"))
            low, size = (_triple(query[name][0]) for name in ("low", "size"))
            voxels = boxes(volume, fine, low, size)
        except InputError as error:
            self._answer(400, str(error))
        except (KeyError, ValueError):
            self._answer(400, "write /box?volume=0&fine=2&low=z,y,x&size=z,y,x in whole numbers")
        else:
            packed = gzip.compress(voxels, compresslevel=1)
            kind = "application/octet-stream"
            self._answer(200, packed, kind=kind, headers={"Content-Encoding": "gzip"})

    @property
    def _name(self) -> str:
        # Cookies do not know ports: another page of another run must not overwrite this one's.
        return f"trabecula-{self.server.server_port}"

    def _cookie(self) -> str:
        with contextlib.suppress(CookieError):
            found = SimpleCookie(self.headers.get("Cookie", "")).get(self._name)
            return "" if found is None else found.value
        return ""

    def _answer(
        self,
        status: int,
        text: str | bytes,
        *,
        kind: str = "text/plain",
        headers: dict | None = None,
    ) -> None:
        body = text if isinstance(text, bytes) else text.encode()
        self.send_response(status)
        fixed = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
        }
        for name, value in {**fixed, **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        with contextlib.suppress(ConnectionError):  # a tab that was closed meanwhile
            self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the command line shows what matters."""


def _triple(text: str) -> Triple:
    z, y, x = (int(part) for part in text.split(","))
    return z, y, x


def serve(
    html: str,
    *,
    port: int = 0,
    browser: bool = True,
    tell: Callable[[str], None] | None = None,
    boxes: Boxes | None = None,
) -> None:
    """Serve a page until interrupted, and open a browser on it.

    Parameters
    ----------
    html : str
    port : int
        Of 127.0.0.1; 0 takes a free one.
    browser : bool
        Open one.
    tell : callable, optional
        Gets a line with the address, to open it by hand.
    boxes : Boxes, optional
        Finer voxels of what the page shows in blocks.

    Raises
    ------
    InputError
        The port is taken; or no browser is found and `tell` is missing.
    """
    with PageServer(html, port=port, boxes=boxes) as server:
        if browser and has_display() and webbrowser.open(server.url):
            place = f"{HOST}:{server.server_port}"
            line = f"the page is open in your browser, from {place}; Ctrl-C ends it"
        elif tell is None:
            raise InputError(
                "no browser was found on this machine: save(path) writes the page as a file"
            )
        else:
            found = "no browser was found on this machine: open" if browser else "open"
            line = f"{found} {server.url} (works once; Ctrl-C ends it; --html FILE writes a file)"
        if tell is not None:
            tell(line)
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()


def has_display() -> bool:
    """Return whether a browser could show a window: on Linux without one, a text browser would take
    over the terminal.
    """
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
