"""Write the pages that follow from the code: docs/methods and docs/reference. A new method,
setting, format, verb, measure or public name appears without an edit here."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import os
import re
import shutil
import typing
from collections.abc import Iterable, Sequence
from pathlib import Path

import trabecula
from steps.presets import pictured
from trabecula.synth.api.method import Capabilities
from trabecula.synth.api.registry import methods
from trabecula.synth.api.settings import preset_settings, settings_of

# Rooms in the order of the data, with their titles on the API page; a room that is not named here
# comes last.
_ROOMS = {
    "core": "Images, requests and recipes",
    "io": "Files",
    "exemplar": "Exemplars",
    "fields": "Target fields",
    "synth": "Methods and models",
    "finish": "Finish",
    "measure": "Measure",
    "report": "The certificate",
    "mesh": "Surfaces",
    "view": "Pictures",
    "pipeline": "From file to file",
    "engine": "Memory, threads and long runs",
    "testing": "Tests of methods and formats",
}
# Names that public functions return or take, and that are no names of `trabecula` itself.
_ALSO = {
    "synth.api": (
        "Capabilities",
        "Method",
        "Model",
        "ModelState",
        "WindowModel",
        "ExemplarInfo",
        "register",
    ),
    "report.verdict": ("Certificate",),
    "report.metrics": ("Metric",),
    "report.inspection": ("Inspection",),
    "report.recommend": ("Recommendation",),
    "measure.margins": ("Margins",),
    "pipeline.trials": ("Trial",),
    "mesh.surface": ("mesh",),
    "mesh.base": ("Mesh",),
    "mesh.check": ("check", "MeshCheck"),
    "mesh.files": ("write_mesh",),
    "view.page.show": ("view",),
    "view.page.document": ("Page",),
    "view.still": ("turntable",),
    "view.slices": ("slices", "montage"),
    "engine.memory": ("Plan",),
    "engine.lazy_volume": ("Slabs", "as_slabs"),
    "testing": ("check_method", "check_format", "MethodCase"),
}
# Sections of the measures page and the modules and packages of each; one that is not named here
# comes last.
_MEASURES = {
    "Everything at once": ("describe", "blockwise", "effective_properties"),
    "Amount and surface": ("fractions", "minkowski", "curvatures"),
    "Sizes": ("thickness", "morphometry", "distance"),
    "Correlation": ("correlation",),
    "Connectivity": ("components", "labelling", "percolation"),
    "Directions": ("fabric", "orientation"),
    "Grey values and texture": ("grey",),
    "Phases and their contacts": ("each_phase", "phase_lists", "contacts", "triple_lines"),
    "Two fluids": ("drainage", "imbibition", "displacement", "relative_permeability"),
    "Networks and bodies": ("network", "bodies"),
    "Bone and coatings": ("bone", "plates", "coating"),
    "Transport": ("transport",),
    "Stiffness": ("mechanics",),
    "Confidence": ("confidence", "mean_variance"),
    "Copying": ("copying",),
}


def write(docs: Path) -> None:
    """Write every generated page anew."""
    for folder in ("methods", "reference"):
        shutil.rmtree(docs / folder, ignore_errors=True)
        (docs / folder).mkdir()
    found = methods()
    for name, spec in found.items():
        (docs / "methods" / f"{name}.md").write_text(method_page(spec), encoding="utf-8")
    pages = {
        "methods/index.md": methods_index(found),
        "reference/formats.md": formats_page(),
        "reference/command-line.md": command_line_page(),
        "reference/measures.md": measures_page(),
        "reference/api.md": api_page(),
    }
    for name, text in pages.items():
        (docs / name).write_text(text, encoding="utf-8")


def methods_index(found: dict[str, Capabilities]) -> str:
    """Return the table of methods."""
    dimensions = {"2d": "2-D", "3d": "3-D", None: "none"}
    rows = [
        (
            f"[{name}]({name}.md)",
            spec.summary,
            spec.paper,
            dimensions[spec.exemplar] + (f", {' or '.join(spec.kinds)}" if spec.exemplar else ""),
            ", ".join(("shape", "seed", *sorted(spec.honours))),
            ", ".join(f"`trabecula[{extra}]`" for extra in spec.extras) or "nothing",
        )
        for name, spec in found.items()
    ]
    head = ("method", "makes", "after", "exemplar", "honours", "needs besides the base install")
    return f"""# Methods

A method learns from an exemplar and gives a model; the model makes material.
`trabecula methods` prints the first columns.

{table(head, rows)}

*Honours* lists the parts of a {{py:class}}`request <trabecula.Request>` that the method follows.
It refuses the others by name.

```{{toctree}}
:hidden:
:glob:

*
```
"""


def method_page(spec: Capabilities) -> str:
    """Return a method's card, its CAPABILITIES and its settings."""
    package = importlib.import_module(f"trabecula.synth.{_folder(spec)}")
    card = Path(package.__file__).with_name("README.md")
    text = (
        _without_dead_links(card.read_text(encoding="utf-8").strip())
        if card.exists()
        else spec.summary
    )
    if not text.startswith("# "):
        text = f"# {spec.name}\n\n{text}"
    facts = [
        ("after", spec.paper),
        ("exemplar", f"{spec.exemplar}: {' or '.join(spec.kinds)}" if spec.exemplar else "none"),
        ("honours", ", ".join(("shape", "seed", *sorted(spec.honours)))),
        ("targets", ", ".join(spec.targets) if "target" in spec.honours else "none"),
        ("scaling", spec.scaling),
        ("presets", ", ".join(spec.presets) or "none"),
        ("extras", ", ".join(spec.extras) or "none"),
    ]
    rows = [
        (
            f"`{one.name}`",
            one.unit,
            one.allowed,
            "required" if one.default is dataclasses.MISSING else f"`{one.default!r}`",
            one.meaning,
        )
        for one in settings_of(spec)
    ]
    settings = table(("setting", "unit", "range", "default", "meaning"), rows)
    presets = presets_of(spec)
    return f"""{text}

## At a glance

{table(("what", ""), facts)}

## Settings

In Python `tb.method("{spec.name}", name=value)`; on the command line `--set name=value`.

{settings}
{presets}"""


def presets_of(spec: Capabilities) -> str:
    """Return the settings of every preset, with a still where it can be drawn without an
    exemplar.
    """
    if not spec.presets:
        return ""
    rows = []
    for name, given in preset_settings(spec).items():
        shown = (
            f"![{name}](../gallery/{spec.name}-{name}.png)"
            if name in pictured().get(spec.name, ())
            else ""
        )
        words = ", ".join(f"`{key}={value}`" for key, value in given.items()) or "the defaults"
        rows.append((f"`{name}`", words, shown))
    drawn = any(row[2] for row in rows)
    head = ("preset", "settings", "a still, and a slice") if drawn else ("preset", "settings")
    return f"""
## Presets

In Python `tb.method("{spec.name}", preset=NAME)`; on the command line `--preset NAME`.
Settings that are given as well replace the preset's.

{table(head, [row[: len(head)] for row in rows])}
"""


def formats_page() -> str:
    """Return the page of the suffixes that are read and written."""
    from trabecula.io.formats import SLICES, suffixes
    from trabecula.io.readers import readers
    from trabecula.mesh.bricks.formats import FORMATS as BRICKS
    from trabecula.mesh.formats import FORMATS, READABLE

    rows: dict[tuple[str, str], list[str]] = {}
    for suffix, form in suffixes().items():
        rows.setdefault((form.name, form.note), []).append(f"`{suffix}`")
    volumes = [(" ".join(names), name, note) for (name, note), names in rows.items()]
    volumes.append(("`/`", SLICES.name, SLICES.note))
    surfaces = [
        (f"`{suffix}`", "read, written" if suffix in FORMATS else "read (extra `mesh`)", form.note)
        for suffix, form in READABLE.items()
    ]
    alone = [
        (" ".join(f"`{one}`" for one in reader.suffixes), reader.name, reader.extra, reader.note)
        for reader in readers()
    ]
    bricks = [(f"`{suffix}`", form.note, ", ".join(form.cases)) for suffix, form in BRICKS.items()]
    return f"""# Formats

How they are used: [read and write formats](../howto/formats.md).

## Volumes and pictures, read and written

{table(("suffix", "format", "note"), volumes)}

## Read alone

Of scanners and solvers; also folders of a DICOM series, and the logs of Bruker and Nikon beside
slices.

{table(("suffix", "format", "extra", "note"), alone)}

## Surfaces

{table(("suffix", "", "format"), surfaces)}

## Bricks for solvers, written

How they are used: [into a solver](../howto/solvers.md).

{table(("suffix", "format", "load cases"), bricks)}
"""


def command_line_page() -> str:
    """Return every verb with its usage and options, from the parsers themselves."""
    from trabecula.cli.main import VERBS, _parser

    os.environ["COLUMNS"] = "100"
    parts = [
        "# Command line reference\n\nHow the verbs go together: "
        "[the command line](../guide/command-line.md). Every verb has `--help`. Exit status: 0 "
        "where the verb did its work, 2 where it was refused, 130 where it was interrupted.\n"
    ]
    for verb in VERBS:
        parser, _ = _parser(verb)
        parts.append(_verb_section(verb, parser._subparsers._group_actions[0].choices[verb]))
    return "\n".join(parts)


def measures_page() -> str:
    """Return the page of every public measure by section, with the classes that it returns."""
    sections = _measures_by_section()
    rows = [
        (
            f"[{title}](#{title.lower().replace(' ', '-')})",
            f"{{py:obj}}`{name} <trabecula.measure.{name}>`",
            what,
        )
        for title, homes in sections.items()
        for names in homes.values()
        for name, what in names.items()
    ]
    parts = [
        "# Measures\n\nEvery measure is a function of `trabecula.measure` (`tb.measure`) that "
        "takes an Image or an array of labels; those of grey values take a grey or colour Image. "
        "`tb.describe` and `trabecula measure FILE` give the common ones at once. What lengths, "
        "phases, masks and axes mean: [conventions](../guide/conventions.md). How to use them: "
        "[transport and stiffness](../howto/transport.md), [copying](../howto/copying.md), "
        "[confidence intervals](../howto/confidence.md), "
        "[the certificate](../howto/certificate.md).\n\n"
        f"{table(('section', 'measure', 'what it is'), rows)}\n"
    ]
    parts.append(
        "## Descriptors\n\n"
        "The figures that `describe` and the certificate report, in the order of the certificate. "
        "An axis (`diffusivity_z`), a phase (`components_void`) or two (`contact_active_binder`) "
        "may follow a name. How each is judged: *inside* its band, *at least* or *at most* an end "
        "of it; a *distance* is 0 for the exemplar and passes up to the upper end; a *count* is "
        "scaled to the volume and fails above the band.\n\n"
        f"{descriptors_table()}\n"
    )
    for title, homes in sections.items():
        parts.append(f"## {title}\n")
        for home, names in homes.items():
            about = _summary(importlib.import_module(f"trabecula.measure.{home}"))
            shown = [f"trabecula.measure.{name}" for name in names]
            parts.append(f"{about}\n\n{directives(shown + _result_classes(names))}")
    return "\n".join(parts)


def descriptors_table() -> str:
    """Return the table of all descriptors, from their registry."""
    from trabecula.measure.registry import DESCRIPTORS, GROUPS

    rows = [
        (
            f"`{one.name}`",
            f"{one.title}. {one.meaning}",
            one.unit,
            ", ".join(one.kinds),
            one.level,
            ", ".join((*one.each, *(("axis",) if one.by_axis else ()))),
            "yes" if one.streams else "",
            f"{one.rule} ({GROUPS[one.group].lower()})" if one.group else "",
        )
        for one in DESCRIPTORS.values()
    ]
    head = ("name", "meaning", "unit", "image", "from level", "also of each", "in slabs", "judged")
    return table(head, rows)


def _measures_by_section() -> dict[str, dict[str, dict[str, str]]]:
    """Map section -> module or package -> name of a measure -> its summary."""
    from trabecula import measure

    homes: dict[str, dict[str, str]] = {}
    # classes last
    for name in sorted(measure.__all__, key=lambda name: inspect.isclass(getattr(measure, name))):
        thing = getattr(measure, name)
        homes.setdefault(thing.__module__.split(".")[2], {})[name] = _summary(thing)
    sections = {
        title: {home: homes.pop(home) for home in own if home in homes}
        for title, own in _MEASURES.items()
    }
    sections |= {home.capitalize(): {home: names} for home, names in sorted(homes.items())}
    return {title: own for title, own in sections.items() if own}


def _result_classes(names: Iterable[str]) -> list[str]:
    """List the classes that these measures return and that are no public measures."""
    from trabecula import measure

    functions = [
        thing for thing in (getattr(measure, name) for name in names) if inspect.isfunction(thing)
    ]
    found = dict.fromkeys(typing.get_type_hints(function).get("return") for function in functions)
    return [
        f"{kind.__module__}.{kind.__qualname__}"
        for kind in found
        if inspect.isclass(kind)
        and kind.__module__.startswith("trabecula.measure.")
        and kind.__name__ not in measure.__all__
    ]


def api_page() -> str:
    """Return the page of every public name of the package, by room."""
    rooms: dict[str, list[str]] = {room: [] for room in _ROOMS}
    for name, home in trabecula._NAMES.items():
        rooms.setdefault(home.split(".")[1], []).append(f"trabecula.{name}")
    for home, names in _ALSO.items():
        rooms.setdefault(home.partition(".")[0], []).extend(
            f"trabecula.{home}.{name}" for name in names
        )
    rooms["fields"] += [
        f"trabecula.fields.{name}" for name in trabecula.fields.__all__ if name[0].islower()
    ]
    rooms["finish"] += [
        f"trabecula.finish.{name}"
        for name in trabecula.finish.__all__
        if name[0].islower() and name not in trabecula._NAMES
    ]
    parts = [
        "# Python API\n\nA name such as `trabecula.read` is public and stays; it is loaded at its "
        "first use, so `import trabecula` costs next to nothing. Longer names are what these "
        "functions take and return. `tb.mesh(image)` is `trabecula.mesh.surface.mesh`, "
        "`tb.view(image)` is `trabecula.view.page.show.view`, "
        "`tb.errors` are [the errors](../guide/errors.md), "
        "`tb.measure` has [its own page](measures.md).\n"
    ]
    for room, names in rooms.items():
        shown = [name for name in names if name != "trabecula.describe" or room == "measure"]
        if shown:
            parts.append(f"## {_ROOMS.get(room, room.capitalize())}\n\n{directives(shown)}")
    return "\n".join(parts)


def directives(names: Iterable[str]) -> str:
    """Return Sphinx directives that print the docstrings of these dotted names."""
    lines = ["```{eval-rst}"]
    for name in names:
        home, _, last = name.rpartition(".")
        thing = getattr(importlib.import_module(home), last)
        if inspect.isclass(thing):
            lines += [f".. autoclass:: {name}", "   :members:", ""]
        else:
            lines += [f".. autofunction:: {name}", ""]
    return "\n".join([*lines, "```", ""])


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""

    def row(cells: Iterable[str]) -> str:
        return (
            "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"
        )

    return "\n".join([row(head), "|" + " --- |" * len(head), *(row(cells) for cells in rows)])


def _verb_section(verb: str, parser: argparse.ArgumentParser) -> str:
    usage = (
        parser.format_usage()
        .strip()
        .replace("usage: ", "")
        .replace("\n" + " " * len("usage: "), "\n")
    )
    parts = [f"## {verb}\n\n{parser.description}\n\n```text\n{usage}\n```\n"]
    for group in parser._action_groups:
        rows = [
            (_spell(action), action.help or "")
            for action in group._group_actions
            if action.dest != "help"
        ]
        if rows:
            title = {"positional arguments": "what", "options": "option"}.get(
                group.title, group.title
            )
            parts.append(table((title, ""), rows) + "\n")
    if parser.epilog:
        head, _, lines = parser.epilog.partition("\n")
        parts.append(f"{head.capitalize()}\n\n```sh\n{inspect.cleandoc(lines)}\n```\n")
    for kinds in [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]:
        parts += [
            _verb_section(f"{verb} {kind}", sub).replace("## ", "### ", 1)
            for kind, sub in kinds.choices.items()
        ]
    return "\n".join(parts)


def _spell(action: argparse.Action) -> str:
    if not action.option_strings:
        return f"`{action.metavar or action.dest}`"
    value = "" if action.nargs == 0 else action.metavar or action.dest.upper()
    words = (
        " ".join(value)
        if isinstance(value, tuple)
        else value + (" ..." if action.nargs == "+" else "")
    )
    return f"`{' '.join([', '.join(action.option_strings), words]).strip()}`"


def _folder(spec: Capabilities) -> str:
    return spec.method.partition(":")[0].split(".")[2]


def _summary(thing: object) -> str:
    return inspect.getdoc(thing).partition("\n\n")[0]


def _without_dead_links(text: str) -> str:
    """Turn the links of a card to files beside it, which lead nowhere in the site, into
    plain words.
    """
    return re.sub(r"(?<!!)\[([^\]]+)\]\((?!https?:|#|mailto:)[^)]+\)", r"\1", text)
