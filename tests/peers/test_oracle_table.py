"""The tables of docs/guide/oracles.md name every descriptor and format, and tests that exist."""

import re
from pathlib import Path

from trabecula.io.formats import FORMATS
from trabecula.io.networks import FORMATS as NETWORKS
from trabecula.measure.registry import DESCRIPTORS
from trabecula.mesh.bricks.formats import FORMATS as BRICKS
from trabecula.mesh.formats import READABLE as SURFACES

HOME = Path(__file__).parents[2]
PAGE = (HOME / "docs/guide/oracles.md").read_text(encoding="utf-8")
SHORT = {name: f"tests/peers/test_oracles_{name}.py" for name in ("measure", "formats")}
SHORT |= {"M": SHORT["measure"], "F": SHORT["formats"]}


def names(section):
    """Return the names in code type in the first column of a section's tables."""
    text = re.split(r"^## ", PAGE.split(f"## {section}\n")[1], flags=re.MULTILINE)[0]
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row)]


def test_every_descriptor_has_its_row():
    assert sorted(names("Descriptors")) == sorted(DESCRIPTORS)


def test_every_format_has_its_row():
    suffixes = [suffix for form in FORMATS for suffix in form.suffixes]
    assert sorted(names("Formats of volumes and pictures")) == sorted(suffixes)
    assert sorted(names("Formats of surfaces")) == sorted(SURFACES)
    assert sorted(names("Formats of bricks")) == sorted(BRICKS)
    assert sorted(names("Formats of networks")) == sorted(NETWORKS)


def test_every_named_test_exists():
    named = re.findall(r"`([\w/.]+)::(test_\w+)`", PAGE)
    assert len(named) > 60
    for file, test in named:
        text = (HOME / SHORT.get(file, file)).read_text(encoding="utf-8")
        assert f"def {test}(" in text, f"{file} has no {test}"
