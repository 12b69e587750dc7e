"""Build the documentation: write pages, run examples, draw pictures, call Sphinx. `make docs` runs
this.

1. Pages that follow from the code: methods, settings, formats, command line, measures, API
(steps/pages.py).
2. Every example of every page and of the README, in a folder of its own (steps/examples.py); those
that passed and have not changed since are left out (steps/cache.py), unless `--fresh` is given. A
page whose example fails says so, the rest is built, and the exit status is 1.
3. The pictures of the gallery (steps/pictures.py), and the live page (steps/live.py).
4. sphinx-build with warnings as errors, into docs/_build/html; then every link of the site is
followed, and what it would load from elsewhere is a fault.

With names of pages as arguments (`docs/build.py howto/formats.md`) only those pages' examples are
run and nothing is built; with `gallery` only the pictures are drawn, with `strip`
that of the README.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from steps import examples, links, live, pages, pictures, strip
from steps.cache import ExampleCache

DOCS = Path(__file__).resolve().parent
README = DOCS.parent / "README.md"
GENERATED = ("methods", "reference")
NOT_PAGES = ("_build", "steps", "made", "gallery")
"""Folders without examples to run: the gallery, drawn later, shows parts of those that drew it."""
FAILED = DOCS / "_build" / "failed.json"
ROOT = DOCS.parent
SOURCES = (ROOT / "src" / "trabecula", DOCS / "examples", DOCS / "steps")
SCANS = ROOT.parent / "shared" / "data"
"""Published scans for the tutorials, where they are at hand; else these fetch them."""
PLACES = {"gallery": DOCS / "gallery", "live": DOCS / "made" / "live"}
"""Folders of what is drawn; that of the live page is copied into the site as it is."""
EXAMPLES = DOCS / "examples"
"""Modules that pages show and import; tests/contract holds them to the contract."""


def main(names: list[str]) -> int:
    """Run the steps, each with its time, and return the exit status."""
    fresh = "--fresh" in names
    names = [name for name in names if name != "--fresh"]
    if names == ["gallery"]:
        run_timed("gallery", lambda: pictures.draw(PLACES["gallery"]))
        return 0
    if names == ["strip"]:
        run_timed("strip", lambda: strip.draw(DOCS / "images" / "strip.png"))
        return 0
    if SCANS.is_dir():
        os.environ.setdefault("TRABECULA_DATA", str(SCANS))
    if not names or any(name.partition("/")[0] in GENERATED for name in names):
        run_timed("pages", lambda: pages.write(DOCS))
    sys.path.append(str(EXAMPLES))
    chosen = [(DOCS / name).resolve() for name in names] or [README, *list_pages()]
    cache = ExampleCache(ROOT / "build" / "docs-cache", SOURCES)
    if fresh:
        cache.clear()
    kept = None if names else cache  # a page that is asked for by name is run
    failures = run_timed("examples", lambda: examples.run(chosen, home=ROOT, cache=kept))
    for failure in failures.values():
        print(failure, file=sys.stderr)
    if names:
        return 1 if failures else 0
    write_failures(failures, FAILED)
    drawings = {"gallery": pictures.draw, "live": live.draw}
    for name, draw in drawings.items():
        key, place = cache.key(name, []), PLACES[name]
        if cache.has(key):
            cache.restore(key, place)
        else:
            run_timed(name, lambda draw=draw, place=place: draw(place))
            cache.add(key, name, place)
    return run_timed("sphinx", sphinx) or (1 if failures else 0)


def write_failures(failures: dict[str, str], path: Path) -> None:
    """Write what failed for `conf.py`, which shows it on top of its page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(failures), encoding="utf-8")


def list_pages() -> list[Path]:
    """List the pages whose examples are run, generated ones included."""
    return sorted(
        path for path in DOCS.rglob("*.md") if path.relative_to(DOCS).parts[0] not in NOT_PAGES
    )


def sphinx() -> int:
    """Build the site from nothing, so that no page of an earlier build is left."""
    out = DOCS / "_build" / "html"
    shutil.rmtree(out, ignore_errors=True)
    shutil.rmtree(out.parent / "doctrees", ignore_errors=True)
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-b",
        "html",
        "-W",
        "--keep-going",
        "-q",
        "-d",
        str(out.parent / "doctrees"),
    ]
    command += [str(DOCS), str(out)]
    status = subprocess.run(command, check=False).returncode
    for fault in links.check(out.resolve()):
        status = 1
        print(fault, file=sys.stderr)
    print(f"docs: {out / 'index.html'}" if status == 0 else "docs: Sphinx found faults, see above")
    return status


def run_timed(label, step):
    """Return the result of `step` and print the time that it took."""
    start = time.monotonic()
    result = step()
    print(f"docs: {label} {time.monotonic() - start:.1f} s", flush=True)
    return result


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
