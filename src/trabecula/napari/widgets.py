"""Panels beside napari's canvas: inspect a scan, generate material, judge it by the certificate.

Each is a function that returns a magicgui Container. The work runs in a thread (`PanelTask`).
"""

from __future__ import annotations

from typing import Any

import trabecula as tb
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.optional import need
from trabecula.exemplar.margins import crop_margins
from trabecula.napari.layers import layer_data, layer_image
from trabecula.napari.tasks import PanelTask
from trabecula.report.recommend import recommend
from trabecula.report.summary_text import summary
from trabecula.synth.api.registry import method, methods

RECOMMENDED = "recommended"
"""The method that `inspect` recommends for the exemplar."""


def inspect_panel(napari_viewer: Any = None) -> Any:
    """Return the panel that says what a scan is, what fits it and what can be decided about it."""
    widgets = _widgets()
    scan = _layer_choice("scan")
    text, bar = _text(), widgets.ProgressBar(max=100, label="progress")
    button = widgets.PushButton(text="Inspect")
    task = PanelTask(button, bar, lambda line: setattr(text, "value", line))

    def start() -> None:
        image = _checked(scan, text)
        if image is not None:
            task.start(lambda: tb.inspect(image).to_table(), lambda table: _show(text, table))

    button.changed.connect(start)
    return _panel([scan, button, bar, text], task)


def generate_panel(napari_viewer: Any = None) -> Any:
    """Return the panel that makes material like a layer, as a new layer."""
    widgets = _widgets()
    scan = _layer_choice("exemplar")
    choice = widgets.ComboBox(label="method", choices=[RECOMMENDED, *_method_names()])
    sides = [widgets.SpinBox(label=axis, value=96, min=1, max=1_000_000) for axis in "zyx"]
    seed = widgets.SpinBox(label="seed", value=0, min=0, max=2**31 - 1)
    repeat = widgets.CheckBox(label="periodic", value=False)
    text, bar = _text(), widgets.ProgressBar(max=100, label="progress")
    button = widgets.PushButton(text="Generate")
    task = PanelTask(button, bar, lambda line: setattr(text, "value", line))

    def start() -> None:
        image = _checked(scan, text)
        if image is None:
            return
        shape = tuple(side.value for side in sides)
        name, number, wraps = choice.value, seed.value, (repeat.value,) * 3

        def work() -> tuple[Image, str]:
            chosen, why = _method_for(image, name)
            made = chosen.fit(image).generate(shape, seed=number, periodic=wraps)
            return made, why

        def finish(found: tuple[Image, str]) -> None:
            made, why = found
            data, options, kind = layer_data(made, f"{scan.value.name} {number}")
            viewer = napari_viewer or _current_viewer()
            getattr(viewer, f"add_{kind}")(data, **options)
            _show(text, f"{why}\n{made!r}")

        task.start(work, finish)

    button.changed.connect(start)
    return _panel([scan, choice, *sides, seed, repeat, button, bar, text], task)


def certificate_panel(napari_viewer: Any = None) -> Any:
    """Return the panel that judges a layer against another one, with a page on request."""
    widgets = _widgets()
    scan, result = _layer_choice("exemplar"), _layer_choice("result")
    level = widgets.ComboBox(label="level", choices=["quick", "default", "full"], value="default")
    page = widgets.FileEdit(label="page", mode="w", filter="*.html", value="")
    text, bar = _text(), widgets.ProgressBar(max=100, label="progress")
    button = widgets.PushButton(text="Verify")
    task = PanelTask(button, bar, lambda line: setattr(text, "value", line))

    def start() -> None:
        pair = [_checked(one, text) for one in (scan, result)]
        if pair[0] is None or pair[1] is None:
            return
        exemplar, image = pair[0], pair[1]
        place, depth = str(page.value or ""), level.value

        def work() -> str:
            verdict = tb.verify(exemplar, image, names=[result.value.name], level=depth)
            if place.endswith(".html"):
                verdict.to_html(place)
            return summary(verdict) + (f"\nwritten: {place}" if place.endswith(".html") else "")

        task.start(work, lambda words: _show(text, words))

    button.changed.connect(start)
    return _panel([scan, result, level, page, button, bar, text], task)


def _widgets() -> Any:
    return need("magicgui.widgets", extra="napari", purpose="a panel of napari")


def _current_viewer() -> Any:
    """Return the viewer in front: napari passes one to classes alone, not to functions."""
    return need("napari", extra="napari", purpose="a panel of napari").current_viewer()


def _layer_choice(label: str) -> Any:
    """Return a choice among the layers of the viewer."""
    need("napari.layers", extra="napari", purpose="a panel of napari")
    return _widgets().create_widget(label=label, annotation="napari.layers.Layer")


def _text() -> Any:
    found = _widgets().TextEdit(value="", label="")
    found.native.setReadOnly(True)
    found.native.setStyleSheet("font-family: monospace; font-size: 9pt;")
    found.native.setLineWrapMode(found.native.LineWrapMode.NoWrap)
    return found


def _show(text: Any, words: str) -> None:
    text.value = words


def _panel(parts: list[Any], task: PanelTask) -> Any:
    panel = _widgets().Container(widgets=parts, labels=True)
    panel.task = task  # so that it lives as long as the panel
    return panel


def _checked(choice: Any, text: Any) -> Image | None:
    """Return the image of the chosen layer; None, and the reason as text, where there is none."""
    if choice.value is None:
        _show(text, "no layer: open a file, or a sample of File > Open Sample")
        return None
    try:
        return layer_image(choice.value)
    except InputError as error:
        _show(text, str(error))
        return None


def _method_names() -> list[str]:
    return [name for name, known in methods().items() if known.exemplar]


def _method_for(image: Image, name: str) -> tuple[Any, str]:
    """Return a method by name, or the one that is recommended, and a line that says so."""
    if name != RECOMMENDED:
        return method(name), f"method {name}"
    found = recommend(crop_margins(image))
    if found.method is None:
        raise InputError(f"no method fits this exemplar: {found.reason}")
    chosen = method(found.method, preset=found.preset, **dict(found.settings))
    return chosen, f"method {found.method} (recommended: {found.reason})"
