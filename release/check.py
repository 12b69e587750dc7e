"""Check what a release needs, before it is published.

    python release/check.py --tag v0.2.0           version, citation, changelog, addresses
    python release/check.py --wheel dist/*.whl     its size and what is in it
    python release/check.py --conda dist/*.tar.gz  write build/release/recipe.yaml

The version has one home, `src/trabecula/__init__.py`; a tag is that version with a `v` before it.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import sys
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LARGEST_WHEEL = 7_000_000
"""Bytes. Six trained models take 5 MB, before they are packed."""
PLACEHOLDER = "example.org"
RECIPE = Path("release", "conda", "recipe.yaml")
OUT = Path("build", "release")


def main(words: Sequence[str] | None = None) -> int:
    """Print what is wrong, one a line, and return 1 where anything is."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tag", help="the tag that is to be published, vX.Y.Z")
    parser.add_argument("--wheel", type=Path, metavar="FILE")
    parser.add_argument("--conda", type=Path, metavar="SDIST")
    options = parser.parse_args(words)
    faults: list[str] = []
    if options.tag:
        faults += check_tag(options.tag)
    if options.wheel:
        faults += check_wheel(options.wheel)
    if options.conda:
        print(write_recipe(options.conda, ROOT / OUT / RECIPE.name))
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


def version(root: Path = ROOT) -> str:
    """Return the version of the package, without importing it."""
    text = (root / "src" / "trabecula" / "__init__.py").read_text(encoding="utf-8")
    return re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE)[1]


def check_tag(tag: str, root: Path = ROOT) -> Iterator[str]:
    """Yield what keeps this tag from being released."""
    here = version(root)
    if tag != f"v{here}":
        yield f"the tag is {tag}, the version v{here}: src/trabecula/__init__.py has the version"
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    if f"\nversion: {here}\n" not in citation:
        yield f"CITATION.cff has not the version {here}"
    log = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(here)}, (.+)$", log, re.MULTILINE)
    if found is None or not re.fullmatch(r"\d{4}-\d{2}-\d{2}", found[1]):
        yield f'CHANGELOG.md has no title "## {here}, YYYY-MM-DD"'
    elif f'\ndate-released: "{found[1]}"\n' not in citation:
        yield f"CITATION.cff is not of {found[1]}, as CHANGELOG.md is"
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name, address in project["urls"].items():
        if PLACEHOLDER in address:
            yield f"pyproject.toml: the address of {name} is a placeholder, {address}"


def check_wheel(path: Path) -> Iterator[str]:
    """Yield what is wrong with a wheel."""
    size = path.stat().st_size
    print(f"{path.name}: {size / 1e6:.2f} MB of {LARGEST_WHEEL / 1e6:.0f}")
    if size > LARGEST_WHEEL:
        yield f"{path.name} has {size} bytes, more than {LARGEST_WHEEL}"
    with zipfile.ZipFile(path) as file:
        names = file.namelist()
    for needed in ("trabecula/py.typed", "trabecula/__init__.pyi", "trabecula/napari/napari.yaml"):
        if needed not in names:
            yield f"{path.name} lacks {needed}"
    strange = {name.partition("/")[0] for name in names} - {
        "trabecula",
        f"trabecula-{path.name.split('-')[1]}.dist-info",
    }
    for name in sorted(strange):
        yield f"{path.name} installs {name} beside the package"


def write_recipe(sdist: Path, out: Path) -> Path:
    """Write conda's recipe for this source distribution, with its version and hash."""
    found = re.fullmatch(r"trabecula-(.+)\.tar\.gz", sdist.name)
    text = (ROOT / RECIPE).read_text(encoding="utf-8")
    text = re.sub(r'(?m)^  version: ".*"$', f'  version: "{found[1]}"', text)
    digest = hashlib.sha256(sdist.read_bytes()).hexdigest()
    text = re.sub(r"(?m)^  sha256: .*$", f"  sha256: {digest}", text)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
    return out


if __name__ == "__main__":
    sys.exit(main())
