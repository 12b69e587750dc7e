"""The table of formats, and a format of another distribution."""

import importlib
import sys
import textwrap

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.io import formats
from trabecula.io.metadata import FileContent

MODULE = '''
import json
from pathlib import Path

import numpy as np

from trabecula.engine.files import replacing
from trabecula.io import FileContent, Format
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import decode, encode

FORMAT = Format("Slab", (".slab",), "slab_package", "a text header and plain bytes")
TAKEN = Format("Mine", (".tif",), "slab_package", "")


def write(image, path):
    """Write .slab: a line of JSON, then the voxels."""
    head = encode(image, dtype=image.values.dtype.str, sides=image.values.shape)
    with replacing(path) as temporary:
        temporary.write_bytes(head.encode() + b"\\n" + image.values.tobytes())
    return path


def read(path):
    """Read .slab."""
    with report_damage(path, "Slab"):
        head, _, raw = Path(path).read_bytes().partition(b"\\n")
        fields = decode(head)
        dtype, sides = np.dtype(fields["dtype"]), fields["sides"]
        check_claim(path, sides, dtype, stored=len(raw))
        values = np.frombuffer(raw, dtype).reshape(sides)
    return FileContent(values, colour=fields["kind"] == "colour", fields=fields)
'''


@pytest.fixture
def fresh():
    """Forget the table before and after."""
    for cached in (formats.suffixes, formats._longest_first):
        cached.cache_clear()
    yield
    for cached in (formats.suffixes, formats._longest_first):
        cached.cache_clear()
    sys.modules.pop("slab_package", None)


def install(folder, monkeypatch, entry):
    """Install a distribution with a format."""
    (folder / "slab_package.py").write_text(textwrap.dedent(MODULE), encoding="utf-8")
    about = folder / "slab_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: slab-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[trabecula.formats]\nslab = {entry}\n")
    monkeypatch.syspath_prepend(folder)
    importlib.invalidate_caches()


def test_every_row_has_a_module_that_reads_and_writes():
    for form in (*formats.FORMATS, formats.SLICES):
        assert callable(form.load().read) and callable(form.load().write)
        assert form.note and set(form.ndim) <= {2, 3}
    found = [suffix for form in formats.FORMATS for suffix in form.suffixes]
    assert len(found) == len(set(found)) and all(one == one.lower() for one in found)


def test_a_format_states_a_spacing_of_its_own_where_the_table_says_so(tmp_path, monkeypatch):
    for module in ("tiff", "metaimage", "nrrd", "nifti", "vti"):
        monkeypatch.setattr(f"trabecula.io.{module}.encode", lambda image: '{"somebody": "else"}')
    image = tb.Image(np.arange(60, dtype=np.uint8).reshape(3, 4, 5), "grey", (2.0, 3.0, 4.0), "um")
    for form in formats.FORMATS:
        if 3 in form.ndim and not form.folder:
            path = tb.write(image, tmp_path / f"x{form.suffixes[0]}")
            content = form.read(path)
            assert (content.spacing is not None) == form.resolution, form.name


def test_a_format_of_another_distribution(tmp_path, monkeypatch, fresh):
    install(tmp_path, monkeypatch, "slab_package:FORMAT")
    image = tb.Image(np.eye(4, dtype=np.uint8), "labels", (0.5, 2.0), "mm", ("pore", "rock"))
    path = tb.write(image, tmp_path / "x.slab")
    back = tb.read(path)
    assert np.array_equal(back.values, image.values) and back.phases == image.phases
    assert (back.spacing, back.unit) == (image.spacing, image.unit)
    assert isinstance(formats.format_of(path).read(path), FileContent)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(tb.errors.FileError, match="is it whole"):
        tb.read(path)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("slab_package:GONE", "cannot be loaded"),
        ("no_such_package:FORMAT", "cannot be loaded"),
        ("slab_package:TAKEN", ".tif is taken"),
    ],
)
def test_a_format_that_cannot_be_used_is_reported_and_left_out(
    entry, says, tmp_path, monkeypatch, fresh
):
    install(tmp_path, monkeypatch, entry)
    lines = []
    with listen(lambda line, fraction: lines.append(line)):
        assert ".slab" not in formats.suffixes()
    assert len(lines) == 1 and says in lines[0] and "slab" in lines[0]
    assert formats.suffixes()[".tif"].name == "TIFF"
