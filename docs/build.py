"""Build the documentation: write pages, run examples, draw pictures, call Sphinx. `make docs` runs
this.

1. Pages that follow from the code: methods, settings, formats, command line, measures, API
(steps/pages.py).
2. Every example of every page and of the README, in a folder of its own (steps/examples.py).
3. The pictures of the gallery (steps/pictures.py).
4. sphinx-build with warnings as errors, into docs/_build/html.

With names of pages as arguments (`docs/build.py howto/formats.md`) only those pages' examples are
run and nothing is built; with `gallery` only the pictures are drawn.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

from steps import examples, pages, pictures

DOCS = Path(__file__).resolve().parent
README = DOCS.parent / "README.md"
NOT_PAGES = ("_build", "steps")
EXAMPLES = DOCS / "examples"
"""Modules that pages show and import; tests/contract holds them to the contract."""


def main(names: list[str]) -> int:
    """The steps, each with its time; returns the exit status."""
    if names == ["gallery"]:
        timed("pictures", lambda: pictures.draw(DOCS / "gallery"))
        return 0
    timed("pages", lambda: pages.write(DOCS))
    sys.path.append(str(EXAMPLES))
    chosen = [(DOCS / name).resolve() for name in names] or [README, *written_pages()]
    failures = timed("examples", lambda: examples.run(chosen, home=DOCS.parent))
    for failure in failures:
        print(failure, file=sys.stderr)
    if failures or names:
        return 1 if failures else 0
    timed("pictures", lambda: pictures.draw(DOCS / "gallery"))
    return timed("sphinx", sphinx)


def written_pages() -> list[Path]:
    """Every page of the documentation, the generated ones included."""
    return sorted(
        path for path in DOCS.rglob("*.md") if path.relative_to(DOCS).parts[0] not in NOT_PAGES
    )


def sphinx() -> int:
    """Build the site from nothing, so that no page of an earlier build is left."""
    out = DOCS / "_build" / "html"
    shutil.rmtree(out.parent, ignore_errors=True)
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
    print(f"docs: {out / 'index.html'}" if status == 0 else "docs: Sphinx found faults, see above")
    return status


def timed(label, step):
    """What `step` returns; says how long it took."""
    start = time.monotonic()
    result = step()
    print(f"docs: {label} {time.monotonic() - start:.1f} s", flush=True)
    return result


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
