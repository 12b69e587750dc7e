"""3MF (core specification 1.3): a zip of three XML parts; the model declares unit and recipe."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import cycle
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from trabecula import __version__
from trabecula.core.errors import FileError
from trabecula.core.recipe import Recipe
from trabecula.engine.memory import available_memory
from trabecula.mesh.base import Mesh
from trabecula.mesh.text import NO_UNIT, format_rows, metres, parse_unit, recipe_json

_UNITS = {1e-6: "micron", 1e-3: "millimeter", 1e-2: "centimeter", 1.0: "meter"}
_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
BEAMS = "{http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02}"
_COLOURS = ("#E8DCC8", "#7A8CA8", "#B0563C", "#5F8F57", "#C8A94A", "#8A6FA8")
_NO_UNIT_NOTE = "unit unknown: a length of 1 was written as 1 mm"
_PART = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}path"
_FOOT = 12.0  # inches: the one unit of 3MF that an Image does not know
_DEEPEST = 16  # nested components; a file in which one contains itself would never end
_ENTRY = 300  # bytes that a vertex or triangle takes while it is read

_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""

_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in its own unit where 3MF has it, else in micrometres; voxels as millimetres."""
    with opened_model(path, mesh.unit, mesh.recipe) as (file, factor):
        file.write('<object id="1" type="model">\n')
        _write_triangles(file, mesh, factor)
        file.write("</object>\n")


def write_parts(parts: Mapping[str, Mesh], path: Path) -> None:
    """Write several meshes of one unit as objects of one part, each with a material of its name."""
    first = next(iter(parts.values()))
    ids = range(1, len(parts) + 1)
    with opened_model(path, first.unit, first.recipe, items=ids) as (file, factor):
        materials = len(parts) + 1
        file.write(f'<basematerials id="{materials}">\n')
        for name, colour in zip(parts, cycle(_COLOURS)):
            file.write(f"<base name={quoteattr(name)} displaycolor={quoteattr(colour)}/>\n")
        file.write("</basematerials>\n")
        for number, (name, mesh) in enumerate(parts.items(), start=1):
            file.write(
                f'<object id="{number}" type="model" name={quoteattr(name)} '
                f'pid="{materials}" pindex="{number - 1}">\n'
            )
            _write_triangles(file, mesh, factor)
            file.write("</object>\n")


def _write_triangles(file: io.TextIOWrapper, mesh: Mesh, factor: float) -> None:
    file.write("<mesh>\n<vertices>\n")
    vertices = mesh.vertices * factor if factor != 1.0 else mesh.vertices
    file.writelines(format_rows('<vertex x="%.7g" y="%.7g" z="%.7g"/>\n', vertices))
    file.write("</vertices>\n<triangles>\n")
    file.writelines(format_rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', mesh.faces))
    file.write("</triangles>\n</mesh>\n")


@contextmanager
def opened_model(
    path: Path, unit: str, recipe: Recipe, extension: str = "", items: Sequence[int] = (1,)
) -> Iterator[tuple[io.TextIOWrapper, float]]:
    """Open a package whose model is written: resources go into the file that is yielded, lengths
    times the factor; `extension` are further attributes of the model, `items` the objects that are
    printed.
    """
    name, factor = _unit(unit)
    with zipfile.ZipFile(path, "w") as package:
        for part, text in (("[Content_Types].xml", _TYPES), ("_rels/.rels", _RELATIONSHIPS)):
            package.writestr(_entry(part), text)
        # Level 1: 3 times faster than the default for a file some 10 % larger.
        with package.open(_entry("3D/3dmodel.model"), "w", force_zip64=True) as stream:
            file = io.TextIOWrapper(stream, encoding="utf-8", write_through=True)
            _write_head(file, name, unit, recipe, extension)
            yield file, factor
            printed = "".join(f'<item objectid="{number}"/>\n' for number in items)
            file.write(f"</resources>\n<build>\n{printed}</build>\n</model>\n")
            file.flush()
            file.detach()


def _entry(name: str) -> zipfile.ZipInfo:
    """Return a deflated entry with a fixed date: the same mesh gives the same bytes."""
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    # Public as `compress_level` from Python 3.13.
    entry._compresslevel = 1  # type: ignore[attr-defined]
    return entry


def _unit(unit: str) -> tuple[str, float]:
    """Return the 3MF name of a unit and the factor of its coordinates."""
    size = metres(unit)
    if size is None:
        return "millimeter", 1.0
    for known, name in _UNITS.items():
        if abs(size / known - 1) < 1e-9:
            return name, 1.0
    return "micron", size * 1e6


def _write_head(
    file: io.TextIOWrapper, name: str, unit: str, recipe: Recipe, extension: str
) -> None:
    note = metres(unit) is None
    file.write(
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<model unit="{name}" xml:lang="en-US" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        f'xmlns:tb="urn:trabecula"{extension}>\n'
        f'<metadata name="Application">trabecula {__version__}</metadata>\n'
        f'<metadata name="tb:unit">{escape(unit)}</metadata>\n'
        + (f'<metadata name="tb:note">{_NO_UNIT_NOTE}</metadata>\n' if note else "")
        + f'<metadata name="tb:recipe">{escape(recipe_json(recipe))}</metadata>\n'
        "<resources>\n"
    )


def read(path: Path) -> Mesh:
    """Read every object of the file's build section, each at its place.

    Objects may be in several parts of the package, as of the production extension, which slicers
    write.
    """
    with zipfile.ZipFile(path) as package:
        entries = [info for info in package.infolist() if info.filename.lower().endswith(".model")]
        size = sum(entry.file_size for entry in entries)
        if size * 8 > available_memory():
            raise FileError(
                f"cannot read {path}: its model unpacks to {size >> 20} MiB, too much for memory"
            )
        models = {
            f"/{entry.filename}": ElementTree.fromstring(package.read(entry)) for entry in entries
        }
    # A file without the usual name of the model has one alone.
    first = next((name for name in models if name.lower().endswith("3dmodel.model")), None)
    first = next(iter(models)) if first is None else first
    objects = {
        (name, node.get("id", "")): node
        for name, model in models.items()
        for node in model.iter(f"{_CORE}object")
    }
    model = models[first]
    items = list(model.iter(f"{_CORE}item"))
    _check_copies(objects, [_key(item, first) for item in items])
    parts = [
        part
        for item in items
        for part in _object_parts(objects, _key(item, first), _transform(item))
    ]
    offsets = np.cumsum([0, *(len(points) for points, _ in parts)])
    if not sum(len(corners) for _, corners in parts) and any(
        node.iter(f"{BEAMS}beam") for node in objects.values()
    ):
        raise FileError(f"{path} holds beams and no triangles: a surface is what is read")
    vertices = np.concatenate([points for points, _ in parts])
    faces = np.concatenate(
        [faces + offset for (_, faces), offset in zip(parts, offsets[:-1], strict=True)]
    )
    unit, factor = _read_unit(model)
    return Mesh(vertices * factor, faces, unit)


def _read_unit(model: ElementTree.Element) -> tuple[str, float]:
    """Return the unit, and the factor of the coordinates; "voxel" of our own files is restored."""
    ours = {node.get("name"): node.text for node in model.iter(f"{_CORE}metadata")}.get("tb:unit")
    if ours == NO_UNIT:
        return NO_UNIT, 1.0
    stated = model.get("unit", "millimeter")  # the specification's default
    return ("inch", _FOOT) if stated == "foot" else (parse_unit(stated), 1.0)


def _check_copies(
    objects: dict[tuple[str, str], ElementTree.Element], keys: list[tuple[str, str]]
) -> None:
    """Raise where components repeat objects beyond memory, as ten of ten of ten do."""

    @cache
    def entries(key: tuple[str, str], depth: int) -> int:
        if depth == 0:
            raise ValueError("its components are nested too deep")
        node = objects[key]
        inner = node.iter(f"{_CORE}component")
        return sum(1 for _ in node.iter()) + sum(
            entries(_key(one, key[0]), depth - 1) for one in inner
        )

    count = sum(entries(key, _DEEPEST) for key in keys)
    if count * _ENTRY > available_memory():
        raise ValueError(f"its components repeat {count} entries, too much for memory")


def _object_parts(
    objects: dict[tuple[str, str], ElementTree.Element],
    key: tuple[str, str],
    transform: np.ndarray,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return vertices and faces of an object and of the components in it.

    `transform` is (4, 3): points are rows (x, y, z, 1).
    """
    node = objects[key]
    parts = []
    surface = node.find(f"{_CORE}mesh")
    if surface is not None:
        points = [
            [float(v.get(axis, "")) for axis in "xyz"] for v in surface.iter(f"{_CORE}vertex")
        ]
        faces = [
            [int(t.get(corner, "")) for corner in ("v1", "v2", "v3")]
            for t in surface.iter(f"{_CORE}triangle")
        ]
        placed = np.array(points, np.float64).reshape(-1, 3) @ transform[:3] + transform[3]
        corners = np.array(faces, np.int64).reshape(-1, 3)
        # A mirror turns the surface inside out.
        parts.append((placed, corners if np.linalg.det(transform[:3]) > 0 else corners[:, ::-1]))
    for component in node.iter(f"{_CORE}component"):
        inner = _transform(component)
        whole = np.concatenate(
            [inner[:3] @ transform[:3], (inner[3] @ transform[:3] + transform[3])[None]]
        )
        parts += _object_parts(objects, _key(component, key[0]), whole)
    return parts


def _key(node: ElementTree.Element, part: str) -> tuple[str, str]:
    """Return part and number of the object that an item or component of a part names."""
    return node.get(_PART, part), node.get("objectid", "")


def _transform(node: ElementTree.Element) -> np.ndarray:
    """Return the transform (4, 3) of an item or component."""
    text = node.get("transform")
    return np.eye(4, 3) if text is None else np.array(text.split(), np.float64).reshape(4, 3)
