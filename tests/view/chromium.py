"""A real browser for tests and benchmarks: headless Chromium, spoken to over a pipe (DevTools
protocol), no package needed.

The pipe is that of `--remote-debugging-pipe`: messages in JSON, each ended by a zero byte, read by
the browser from descriptor 3 and written to 4. Nothing listens on a port.
"""

import base64
import contextlib
import fcntl
import io
import json
import os
import re
import select
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
MISSING = (
    "no Chromium was found: install the package chromium (apt-get install chromium), or set "
    "CHROMIUM to its path"
)
_SECONDS = 60
# SwiftShader draws on the processor: the same pictures on every machine, and no graphics card
# needed.
_FLAGS = (
    "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-extensions", "--disable-sync",
    "--disable-renderer-backgrounding", "--disable-backgrounding-occluded-windows",
    "--disable-dev-shm-usage",
    "--force-device-scale-factor=1", "--hide-scrollbars", "--mute-audio",
)  # fmt: skip


def find_browser() -> str | None:
    """Return the path of the browser, or None."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


class Chromium:
    """A browser without window; `open` makes a page, `close` ends it all."""

    def __init__(self, *flags: str) -> None:
        self.folder = tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True)
        root = ("--no-sandbox",) if os.geteuid() == 0 else ()  # the sandbox does not start for root
        self.log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close()
        theirs, self.out = os.pipe()
        self.back, answers = os.pipe()
        # High numbers first: 3 and 4 themselves may be among these.
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 20) for fd in (theirs, answers)]
        actions = [(os.POSIX_SPAWN_DUP2, high[0], 3), (os.POSIX_SPAWN_DUP2, high[1], 4)]
        actions += [(os.POSIX_SPAWN_DUP2, self.log.fileno(), fd) for fd in (1, 2)]
        words = [
            find_browser(),
            *_FLAGS,
            *root,
            *flags,
            f"--user-data-dir={self.folder.name}",
            "about:blank",
        ]
        self.process = os.posix_spawn(
            words[0], words, os.environ, file_actions=actions, setsid=True
        )
        for fd in (theirs, answers, *high):
            os.close(fd)
        self.number, self.rest, self.pages = 0, b"", {}

    def call(self, method, session=None, **parameters):
        """Return the result of a command; pass events on to their page meanwhile."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.out, data) :]
        while True:
            answer = self._next(f"{method} had no answer")
            if answer.get("id") == message["id"]:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def open(self, url="about:blank", *, size=(800, 600), before=""):
        """Open a page of that size at an address; `before` is run in it first."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        return Tab(self, target, session, url, size, before)

    def pump(self, seconds):
        """Wait for events for a while."""
        until = time.monotonic() + seconds
        while (
            b"\0" in self.rest
            or select.select([self.back], [], [], max(0.0, until - time.monotonic()))[0]
        ):
            self._next("")

    def _next(self, trouble):
        until = time.monotonic() + _SECONDS
        while b"\0" not in self.rest:
            ready, _, _ = select.select([self.back], [], [], max(0.0, until - time.monotonic()))
            data = os.read(self.back, 1 << 20) if ready else b""
            if not data:
                self.log.seek(0)
                raise RuntimeError(f"{trouble}: {self.log.read()[-2000:].decode(errors='replace')}")
            self.rest += data
        line, _, self.rest = self.rest.partition(b"\0")
        message = json.loads(line)
        if "method" in message and message.get("sessionId") in self.pages:
            self.pages[message["sessionId"]].handle_event(message["method"], message["params"])
        return message

    def processes(self):
        """Return (type, bytes of memory, processor seconds) of the browser's processes; what they
        share is shared out.
        """
        listed = subprocess.run(
            ["ps", "-o", "pid=,args=", "-g", str(self.process)], capture_output=True, text=True
        )
        for line in listed.stdout.splitlines():
            number, words = line.split(maxsplit=1)
            kind = next(
                (word.partition("=")[2] for word in words.split() if word.startswith("--type=")),
                "browser",
            )
            with contextlib.suppress(FileNotFoundError):
                ticks = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[11:13]
                memory = re.search(
                    r"^Pss: +(\d+)", Path(f"/proc/{number}/smaps_rollup").read_text(), re.MULTILINE
                )
                yield kind, int(memory[1]) * 1024, sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")

    def close(self):
        """End the browser and every process that it started."""
        for fd in (self.out, self.back):
            os.close(fd)
        until = time.monotonic() + 5
        while time.monotonic() < until and os.waitpid(self.process, os.WNOHANG)[0] == 0:
            time.sleep(0.05)
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            os.killpg(self.process, signal.SIGKILL)
            os.waitpid(self.process, 0)
        self.log.close()
        self.folder.cleanup()


class Tab:
    """A page: `run` evaluates, the mouse and the keys are real events, `errors` and `requests` are
    what came up.
    """

    def __init__(self, browser, target, session, url, size, before):
        self.browser, self.target, self.session = browser, target, session
        self.errors, self.requests, self.loaded = [], [], False
        browser.pages[session] = self
        self.call("Page.bringToFront")
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(*size)
        if before:
            self.call("Page.addScriptToEvaluateOnNewDocument", source=before)
        self.go("Page.navigate", url=url)

    def call(self, method, **parameters):
        """Send a command to this page."""
        return self.browser.call(method, self.session, **parameters)

    def go(self, method, **parameters):
        """Open an address or reload, and wait until the page is loaded."""
        self.loaded = False
        trouble = self.call(method, **parameters).get("errorText")
        if trouble:
            raise RuntimeError(trouble)
        until = time.monotonic() + _SECONDS
        while not self.loaded and time.monotonic() < until:
            self.browser.pump(0.02)

    def handle_event(self, method, about):
        """Keep what tests ask for."""
        if method == "Page.loadEventFired":
            self.loaded = True
        elif method == "Runtime.exceptionThrown":
            details = about["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and about["type"] in (
            "error",
            "warning",
            "assert",
        ):
            self.errors.append(
                str([each.get("value", each.get("description")) for each in about["args"]])
            )
        elif method == "Log.entryAdded" and about["entry"]["level"] == "error":
            self.errors.append(about["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])

    def run(self, expression):
        """Return the value of an expression of JavaScript; wait for promises."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(
                answer["exceptionDetails"].get("exception", {}).get("description", "failed")
            )
        return answer["result"].get("value")

    def resize(self, width, height, *, touch=False):
        """Set the window's inner size; one pixel a CSS pixel."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)

    def picture(self):
        """Return (H, W, 3) uint8: the window as it is shown."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Pillow.open(io.BytesIO(data)).convert("RGB"))

    def mouse(self, kind, x, y, *, button="left", **more):
        """Send mousePressed, mouseMoved, mouseReleased or mouseWheel at a place of the window."""
        held = {"mouseMoved": 1, "mousePressed": 1}.get(kind, 0)
        self.call(
            "Input.dispatchMouseEvent",
            type=kind, x=x, y=y, button=button, buttons=held, clickCount=1, **more,
        )  # fmt: skip

    def drag(self, start, end, steps=4):
        """Press, move, release."""
        self.mouse("mousePressed", *start)
        for k in range(1, steps + 1):
            self.mouse(
                "mouseMoved", *(a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            )
        self.mouse("mouseReleased", *end)

    def press(self, key, **more):
        """Send a key, by its name in JavaScript."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text, **more)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, **more)

    def fingers(self, kind, *places):
        """Send touchStart, touchMove or touchEnd with fingers at these places."""
        self.call(
            "Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in places]
        )

    def close(self):
        """Close the page alone."""
        self.browser.call("Target.closeTarget", targetId=self.target)
        self.browser.pages.pop(self.session)
