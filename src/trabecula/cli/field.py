"""`trabecula field KIND ... --out FILE`: target fields, measured, drawn, interpolated, or from
topology optimisation.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.core.errors import InputError

KINDS = {
    "measure": "of an image: a descriptor of the window around every voxel",
    "density": "of an image: a local density that varies as the image's, of any shape",
    "property": "of a field of a property: the volume fraction at which an exemplar has it",
    "ramp": "linear from one face to the opposite one",
    "radial": "linear from a middle outwards",
    "formula": "by a formula in z y x (positions) and Z Y X (sides)",
    "direction": "a field of directions, by formulas of its components z, y, x",
    "picture": "drawn: black is --low, white is --high",
    "interpolate": "from values at points, by inverse distance",
    "simp": "the density of the stiffest part under its loads",
    "stress": "of a finished part: its stress under the loads of a case",
    "import": "of a solver's result: an array of its mesh on the voxels of an image",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the kinds of field, each with its own options."""
    kinds = parser.add_subparsers(
        metavar="KIND", dest="made", required=True, parser_class=type(parser)
    )
    for name, summary in KINDS.items():
        sub = kinds.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            allow_abbrev=False,
        )
        _ARGUMENTS[name](sub)
        sub.add_argument(
            "--out", required=True, metavar="FILE", help="field to write (.npy .tif .zarr ...)"
        )
        sub.add_argument("--json", action="store_true", help="print what was made as JSON")


def run(options: argparse.Namespace) -> int:
    """Make the field and write it."""
    from trabecula import fields
    from trabecula.io.files import write
    from trabecula.pipeline.outputs import check_target

    if options.made == "direction":
        return _direction(fields, options)
    check_target(options.out)
    field = _MAKERS[options.made](fields, options)
    write(field, options.out)
    report: dict[str, Any] = {
        "out": options.out,
        "shape": field.shape,
        "unit": field.unit,
        "spacing": field.spacing,
    }
    report |= {"least": float(field.values.min()), "mean": float(field.values.mean(dtype=float))}
    report |= {"most": float(field.values.max())}
    if options.json:
        terminal.show_json({**report, "recipe": field.recipe.to_json()})
    else:
        print(
            f"{options.out}: {field!r}\n{report['least']:.4g} .. {report['most']:.4g}, mean "
            f"{report['mean']:.4g}"
        )
    return 0


def _add_property(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", metavar="EXEMPLAR", help="volume of void and solid, or a scan, or sample:NAME"
    )
    parser.add_argument(
        "name", metavar="NAME", help="stiffness, conductivity, diffusivity, permeability; or NAME:z"
    )
    parser.add_argument(
        "values", metavar="FIELD", help="the property at every voxel (.npy .tif .zarr ...)"
    )
    parser.add_argument(
        "--window", metavar="N", help="side of the windows in voxels (default: a third)"
    )
    parser.add_argument("--count", default="24", metavar="N", help="windows solved (default 24)")
    parser.add_argument(
        "--method", metavar="NAME", help="windows of what this method makes, not of the exemplar"
    )
    parser.add_argument(
        "--seed", default="0", metavar="N", help="of what the method makes (default 0)"
    )
    shared.add_reading(parser)


def _property(fields: Any, options: argparse.Namespace) -> Any:
    from trabecula.pipeline.inputs import load

    exemplar = shared.load_exemplar(options.file, options)
    window = None if options.window is None else shared.integer(options.window, name="--window")
    model = None
    if options.method is not None:
        from trabecula.synth.api.registry import method

        model = method(options.method).fit(exemplar)
    law = fields.property_law(
        exemplar,
        options.name,
        window=window,
        count=shared.integer(options.count, name="--count"),
        model=model,
        seed=shared.integer(options.seed, name="--seed"),
    )
    terminal.note(str(law))
    return law.fraction(load(options.values, threshold="none", kind="grey"))


def _add_grid(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--shape",
        nargs="+",
        required=True,
        metavar="N",
        help="voxels: one number (a cube), z y x, or y x",
    )
    _add_edges(parser)


def _add_edges(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--spacing",
        nargs="+",
        metavar="S",
        help="edge of a voxel: one number, or one per axis (default 1)",
    )
    parser.add_argument("--unit", default="voxel", help="unit of the spacing (default voxel)")


def _grid(options: argparse.Namespace) -> dict[str, Any]:
    spacing = shared.numbers(options.spacing, name="--spacing") if options.spacing else None
    shape = shared.integers(options.shape, name="--shape")
    return {
        "shape": shape[0] if len(shape) == 1 else shape,
        "spacing": spacing,
        "unit": options.unit,
    }


def _number(word: str, name: str) -> float:
    return shared.numbers([word], name=name)[0]


def _add_measure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", metavar="FILE", help="volume or picture of labels, or a scan, or sample:NAME"
    )
    parser.add_argument(
        "--name",
        default="volume_fraction",
        help="descriptor: volume_fraction (default), porosity, surface, apparent_stiffness:z, ...",
    )
    parser.add_argument("--size", required=True, metavar="N", help="side of the windows in voxels")
    parser.add_argument("--phase", metavar="NAME", help="phase that is measured (default: solid)")
    shared.add_reading(parser)


def _measure(fields: Any, options: argparse.Namespace) -> Any:
    image = shared.load_exemplar(options.file, options)
    return fields.measure(
        image, options.name, size=shared.integer(options.size, name="--size"), phase=options.phase
    )


def _add_density(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", metavar="FILE", help="volume or picture of labels, or a scan, or sample:NAME"
    )
    parser.add_argument(
        "--shape",
        nargs="+",
        required=True,
        metavar="N",
        help="voxels, also more than FILE has: one number (a cube), z y x, or y x",
    )
    parser.add_argument("--seed", default="0", metavar="N", help="0 .. 2**63 - 1 (default 0)")
    parser.add_argument(
        "--window",
        metavar="N",
        help="side of the windows whose density is learned, voxels (default: a quarter of the "
        "shortest side)",
    )
    parser.add_argument("--phase", metavar="NAME", help="phase that is measured (default: solid)")
    shared.add_reading(parser)


def _density(fields: Any, options: argparse.Namespace) -> Any:
    image = shared.load_exemplar(options.file, options)
    shape = shared.integers(options.shape, name="--shape")
    return fields.density_like(
        image,
        shape[0] if len(shape) == 1 else shape,
        window=None if options.window is None else shared.integer(options.window, name="--window"),
        phase=options.phase,
        seed=shared.integer(options.seed, name="--seed"),
    )


def _add_ramp(parser: argparse.ArgumentParser) -> None:
    _add_grid(parser)
    parser.add_argument("--axis", default="z", metavar="A", help="along z (default), y or x")
    parser.add_argument(
        "--from", dest="start", required=True, metavar="V", help="value of the first voxel"
    )
    parser.add_argument(
        "--to", dest="end", required=True, metavar="V", help="value of the last voxel"
    )


def _ramp(fields: Any, options: argparse.Namespace) -> Any:
    ends: dict[str, Any] = {
        "start": _number(options.start, "--from"),
        "end": _number(options.end, "--to"),
    }
    return fields.ramp(**_grid(options), axis=options.axis, **ends)


def _add_radial(parser: argparse.ArgumentParser) -> None:
    _add_grid(parser)
    parser.add_argument("--inside", required=True, metavar="V", help="value in the middle")
    parser.add_argument(
        "--outside", required=True, metavar="V", help="value from the radius outwards"
    )
    parser.add_argument(
        "--radius", metavar="R", help="in the unit of the spacing (default: half the shortest side)"
    )
    parser.add_argument(
        "--centre", nargs="+", metavar="C", help="in the unit of the spacing (default: the middle)"
    )
    parser.add_argument(
        "--axis", metavar="A", help="around a line along z, y or x (default: around a point)"
    )


def _radial(fields: Any, options: argparse.Namespace) -> Any:
    return fields.radial(
        **_grid(options),
        inside=_number(options.inside, "--inside"),
        outside=_number(options.outside, "--outside"),
        radius=None if options.radius is None else _number(options.radius, "--radius"),
        centre=None if options.centre is None else shared.numbers(options.centre, name="--centre"),
        axis=options.axis,
    )


def _add_formula(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "formula", metavar="FORMULA", help="such as '0.3 + 0.2 * sin(2 * pi * x / X)'"
    )
    _add_grid(parser)


def _formula(fields: Any, options: argparse.Namespace) -> Any:
    given = _grid(options)
    return fields.formula(given.pop("shape"), options.formula, **given)


def _add_direction(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "formulas",
        nargs=3,
        metavar="FORMULA",
        help="components z, y, x, such as 1 0 'x / X'; only the direction counts",
    )
    _add_grid(parser)


def _direction(fields: Any, options: argparse.Namespace) -> int:
    """Write a field of directions, which is no image, and say where it jumps."""
    given = _grid(options)
    given.pop("unit")
    found = fields.direction_formula(given.pop("shape"), options.formulas, **given)
    _save_directions(found.values, options.out, name="--out")
    faults = shared.note_directions(found.values, None)
    if options.json:
        terminal.show_json({"out": options.out, "shape": found.shape, **faults})
    else:
        print(f"{options.out}: directions of {' x '.join(map(str, found.shape))} voxels")
    return 0


def _save_directions(values: Any, path: str, *, name: str) -> None:
    import numpy as np

    from trabecula.engine.files import replacing

    if Path(path).suffix != ".npy":
        raise InputError(f"{name} {path}: directions are written as .npy")
    with replacing(Path(path)) as temporary, temporary.open("wb") as file:
        np.save(file, values)


def _add_picture(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="picture (.png .jpg .tif)")
    _add_grid(parser)
    parser.add_argument("--low", required=True, metavar="V", help="value of black")
    parser.add_argument("--high", required=True, metavar="V", help="value of white")
    parser.add_argument(
        "--axis", default="z", metavar="A", help="direction one looks along: z (default), y or x"
    )


def _picture(fields: Any, options: argparse.Namespace) -> Any:
    from trabecula.pipeline.inputs import load

    given = _grid(options)
    ends: dict[str, Any] = {
        "low": _number(options.low, "--low"),
        "high": _number(options.high, "--high"),
    }
    image = load(options.file, threshold="none")
    if image.kind == "labels":  # a drawing of few levels: its greys count, not their order
        image = load(options.file, threshold="none", kind="grey")
    return fields.picture(image, given.pop("shape"), axis=options.axis, **ends, **given)


def _add_interpolate(parser: argparse.ArgumentParser) -> None:
    _add_grid(parser)
    parser.add_argument(
        "--point",
        action="append",
        nargs="+",
        required=True,
        metavar="N",
        help="position (z y x or y x, in the unit of the spacing, from the first corner) and value "
        "there; repeatable",
    )
    parser.add_argument("--power", default="4", metavar="P", help="of the distance (default 4)")
    parser.add_argument(
        "--mask", metavar="FILE", help="volume: the domain, inside which distances are counted"
    )


def _interpolate(fields: Any, options: argparse.Namespace) -> Any:
    from trabecula.pipeline.inputs import load

    points = [shared.numbers(words, name="--point") for words in options.point]
    where, values = [words[:-1] for words in points], [words[-1] for words in points]
    mask = None
    if options.mask is not None:
        domain = load(options.mask)
        mask = domain.values != (domain.phases.index("void") if "void" in domain.phases else 0)
    given = _grid(options)
    return fields.interpolate(
        given.pop("shape"),
        where,
        values,
        power=_number(options.power, "--power"),
        mask=mask,
        **given,
    )


def _add_simp(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "case", metavar="CASE", help="cantilever, wheel, or a .json file with supports and loads"
    )
    parser.add_argument(
        "--elements",
        nargs="+",
        metavar="N",
        help="elements along z (up) y x (default: the case's); with --mask: along the longest side "
        "(default 48)",
    )
    parser.add_argument(
        "--mask",
        metavar="FILE",
        help="the part: a closed surface (.stl .obj ...), or a volume of which each voxel is an "
        "element",
    )
    parser.add_argument(
        "--directions",
        metavar="FILE.npy",
        help="also write the direction of the largest principal stress: z, y, x of every element, "
        "with --shape of every voxel; smoothed by --smooth",
    )
    parser.add_argument(
        "--smooth",
        default="1",
        metavar="S",
        help="width in elements over which directions are averaged, weighted by the stress "
        "(default 1; 0: none)",
    )
    parser.add_argument(
        "--shape", nargs="+", metavar="N", help="voxels of the field (default: one an element)"
    )
    for name, words in (
        ("volume", "mean density"),
        ("low", "least density"),
        ("high", "greatest density"),
        ("penalty", "exponent from density to stiffness"),
    ):
        parser.add_argument(f"--{name}", metavar="V", help=f"{words} (default: the case's)")
    parser.add_argument(
        "--radius",
        default="1.5",
        metavar="R",
        help="of the density filter in elements (default 1.5)",
    )
    _add_edges(parser)


def _simp(fields: Any, options: argparse.Namespace) -> Any:
    if options.directions is not None and Path(options.directions).suffix != ".npy":
        raise InputError(f"--directions {options.directions}: directions are written as .npy")
    words = {
        name: getattr(options, name) for name in ("volume", "low", "high", "penalty", "radius")
    }
    numbers: dict[str, Any] = {
        name: _number(word, f"--{name}") for name, word in words.items() if word is not None
    }
    elements = shared.integers(options.elements, name="--elements") if options.elements else None
    spacing = shared.numbers(options.spacing, name="--spacing") if options.spacing else None
    given: dict[str, Any] = {"shape": elements, "spacing": spacing, "unit": options.unit}
    chosen = fields.case(options.case)
    part: dict[str, Any] = {}
    if options.mask is not None:
        given, part = _part(options, chosen, elements)
    field = fields.simp(chosen, **given, **part, **numbers)
    if options.directions is not None:
        penalty = numbers.get("penalty")
        ways = _stress_directions(fields, options, field, chosen, {**part, "penalty": penalty})
        _save_directions(ways, options.directions, name="--directions")
    if options.shape is None:
        return field
    return fields.resample(field, shared.integers(options.shape, name="--shape"))


def _stress_directions(
    fields: Any, options: argparse.Namespace, field: Any, chosen: Any, given: dict[str, Any]
) -> Any:
    """Return the directions of the largest principal stress, smoothed, on elements or voxels."""
    import numpy as np

    stress = fields.principal_stress(field, chosen, **given)
    width, ways = _number(options.smooth, "--smooth"), stress.direction
    inside = ways.any(axis=-1)
    if width:
        found = fields.smooth_directions(ways, sigma=width, weights=np.abs(stress.stress))
        ways = np.where(inside[..., None], found.values, 0)
    if options.shape is not None:
        sides = shared.integers(options.shape, name="--shape")
        ways = fields.resample_directions(fields.continue_directions(ways), sides).values
    shared.note_directions(ways, inside if options.shape is None else None)
    return ways


def _part(options: argparse.Namespace, chosen: Any, elements: Any) -> tuple[Any, Any]:
    """Return shape, spacing and unit of a part's elements, and the part."""
    from trabecula.pipeline.designs import load_part

    if options.spacing is not None:
        raise InputError("--spacing beside --mask: the part says how large its elements are")
    if elements is not None and len(elements) != 1:
        raise InputError("--elements with --mask is one number: along the part's longest side")
    found = load_part(
        options.mask,
        chosen,
        elements=None if elements is None else elements[0],
        folders=(Path(options.case).parent, "."),
    )
    image = found.image
    given = {"shape": image.shape, "spacing": image.spacing, "unit": image.unit}
    return given, {"mask": image, "marks": found.marks}


def _add_stress(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="the part: a volume of labels")
    parser.add_argument(
        "case", metavar="CASE", help="cantilever, wheel, or a .json file with supports and loads"
    )
    parser.add_argument("--phase", metavar="NAME", help="what carries (default: solid)")
    parser.add_argument(
        "--mask",
        metavar="FILE",
        help="the form that the part fills: a volume of labels of the same shape (default: all)",
    )
    parser.add_argument(
        "--html",
        metavar="FILE",
        help="also write a page: compliance asked and got, peaks, weakest struts, pictures",
    )
    parser.add_argument(
        "--density",
        metavar="FILE",
        help="with --html: the design that the part follows (field simp): its compliance is asked",
    )
    parser.add_argument(
        "--modulus",
        metavar="PA",
        help="with --html: Young's modulus of the solid in pascal; forces are then newtons",
    )
    shared.add_reading(parser)


def _stress(fields: Any, options: argparse.Namespace) -> Any:
    from trabecula.pipeline.certificate_page import check_page
    from trabecula.pipeline.inputs import load

    if options.html is not None:
        check_page(options.html)
    elif options.density is not None or options.modulus is not None:
        raise InputError("--density and --modulus are for the page: give --html FILE as well")
    image = shared.load_exemplar(options.file, options)
    mask = None if options.mask is None else load(options.mask)
    field = fields.part_stress(image, options.case, phase=options.phase, mask=mask)
    report = field.recipe.steps[-1]["report"]
    for n, (got, solid) in enumerate(
        zip(report["compliance"], report["solid_compliance"], strict=True), start=1
    ):
        terminal.note(f"load case {n}: {got / solid:.4g} times as compliant as solid throughout")
    where = ", ".join(" ".join(map(str, place)) for place in report["weakest"][:3])
    terminal.note(
        f"largest stress {report['largest']:.4g}, 99 % of the solid below {report['99 %']:.4g}; "
        f"most stressed at z y x {where}"
    )
    if report["loose"] > 0:
        terminal.note(f"{report['loose']:.2%} of the solid is held by nothing and was left out")
    if options.html is not None:
        _write_page(fields, options, image, field, mask)
    return field


def _write_page(
    fields: Any, options: argparse.Namespace, image: Any, field: Any, mask: Any
) -> None:
    """Write the page of a part under its loads."""
    from trabecula.core.image import Image
    from trabecula.pipeline.design_page import asked_compliance, write_design_page
    from trabecula.pipeline.inputs import load

    asked = None
    if options.density is not None:
        density = load(options.density, threshold="none")
        form = None
        if mask is not None:
            void = mask.phases.index("void") if "void" in mask.phases else 0
            inside = Image((mask.values != void).astype("float32"), "grey")
            form = fields.resample(inside, density.shape).values > 0.5
        asked = asked_compliance(density, options.case, mask=form)
    modulus = None if options.modulus is None else _number(options.modulus, "--modulus")
    write_design_page(options.html, image, field, asked=asked, modulus=modulus)
    terminal.note(f"{options.html}: the part under its loads as a page")


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", metavar="RESULT", help="what a solver wrote: .vtu, .vti, .vtk, or .frd of CalculiX"
    )
    parser.add_argument(
        "--like", required=True, metavar="FILE", help="volume whose voxels the field is to have"
    )
    parser.add_argument(
        "--array", metavar="NAME", help="array of the result (default: the only one)"
    )
    parser.add_argument(
        "--component",
        metavar="WORD",
        help="x, y, z or magnitude of a vector; xx, yy, zz, xy, yz, xz, mises, mean, largest or "
        "smallest (principal) of a tensor; or a number from 0",
    )
    parser.add_argument(
        "--unit",
        metavar="UNIT",
        help="of the result's coordinates (default: that of --like; of OpenFOAM m)",
    )
    parser.add_argument(
        "--fill",
        default="0",
        metavar="V",
        help="value outside of the mesh (default 0), or extend: the values near by",
    )
    parser.add_argument(
        "--range",
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="spread the field over this range, as a target needs it: its least value becomes LOW",
    )


def _import(fields: Any, options: argparse.Namespace) -> Any:
    from trabecula.pipeline.inputs import load

    field = fields.import_result(
        options.file,
        like=load(options.like),
        array=options.array,
        component=options.component,
        file_unit=options.unit,
        fill=options.fill if options.fill == "extend" else _number(options.fill, "--fill"),
    )
    if options.range:
        low, high = (_number(word, "--range") for word in options.range)
        field = fields.rescale(field, low=low, high=high)
    return field


_ARGUMENTS = {
    "measure": _add_measure,
    "density": _add_density,
    "property": _add_property,
    "ramp": _add_ramp,
    "radial": _add_radial,
    "formula": _add_formula,
    "direction": _add_direction,
    "picture": _add_picture,
    "interpolate": _add_interpolate,
    "simp": _add_simp,
    "stress": _add_stress,
    "import": _add_import,
}
_MAKERS = {
    "measure": _measure,
    "density": _density,
    "property": _property,
    "ramp": _ramp,
    "radial": _radial,
    "formula": _formula,
    "picture": _picture,
    "interpolate": _interpolate,
    "simp": _simp,
    "stress": _stress,
    "import": _import,
}
