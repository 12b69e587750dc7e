"""3MF (core specification 1.3): a zip of three XML parts. The model declares its unit and carries the recipe."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

from trabecula import __version__
from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import metres, recipe_json
from trabecula.mesh.text import rows

_UNITS = {1e-6: "micron", 1e-3: "millimeter", 1e-2: "centimeter", 1.0: "meter"}

_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""

_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in its own unit where 3MF has it, else in micrometres; plain voxels count as millimetres."""
    unit, factor = _unit(mesh)
    with zipfile.ZipFile(path, "w") as package:
        for name, text in (("[Content_Types].xml", _TYPES), ("_rels/.rels", _RELATIONSHIPS)):
            package.writestr(_entry(name), text)
        # Level 1: 3 times quicker than the default for a file some 10 % larger.
        with package.open(_entry("3D/3dmodel.model"), "w", force_zip64=True) as part:
            _write_model(mesh, io.TextIOWrapper(part, encoding="utf-8", write_through=True), unit=unit, factor=factor)


def _entry(name: str) -> zipfile.ZipInfo:
    # A fixed date: the same mesh gives the same bytes.
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry._compresslevel = 1  # type: ignore[attr-defined]  # public as `compress_level` from Python 3.13
    return entry


def _unit(mesh: Mesh) -> tuple[str, float]:
    """The 3MF name of the mesh's unit and the factor that coordinates need."""
    size = metres(mesh)
    if size is None:
        return "millimeter", 1.0
    for known, name in _UNITS.items():
        if abs(size / known - 1) < 1e-9:
            return name, 1.0
    return "micron", size * 1e6


def _write_model(mesh: Mesh, file: io.TextIOWrapper, *, unit: str, factor: float) -> None:
    file.write(
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<model unit="{unit}" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        'xmlns:tb="urn:trabecula">\n'
        f'<metadata name="Application">trabecula {__version__}</metadata>\n'
        f'<metadata name="tb:unit">{escape(mesh.unit)}</metadata>\n'
        f'<metadata name="tb:recipe">{escape(recipe_json(mesh))}</metadata>\n'
        '<resources>\n<object id="1" type="model">\n<mesh>\n<vertices>\n'
    )
    vertices = mesh.vertices * factor if factor != 1.0 else mesh.vertices
    file.writelines(rows('<vertex x="%.7g" y="%.7g" z="%.7g"/>\n', vertices))
    file.write("</vertices>\n<triangles>\n")
    file.writelines(rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', mesh.faces))
    file.write('</triangles>\n</mesh>\n</object>\n</resources>\n<build>\n<item objectid="1"/>\n</build>\n</model>\n')
    file.flush()
    file.detach()
