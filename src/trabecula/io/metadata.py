"""The fields of an Image beside its voxels, as JSON that every format stores in its own way."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.image import KINDS, Image, describe_fields

KEY = "trabecula"
"""Name of the field, tag or attribute that holds the JSON."""


@dataclass(frozen=True)
class FileContent:
    """What a reader found in a file, before anyone says what it means.

    Parameters
    ----------
    values : array, (Z, Y, X) or (Y, X), colour last
    colour : bool
        The file itself says that the last axis is red, green, blue.
    spacing, unit :
        As the file's format states them; None where it does not.
    fields : dict, optional
        Our own JSON, where this package wrote the file.
    lossy : bool
        The format changes voxels, so that a recipe in it does not describe them.
    origin : str
        Where in the file the spacing comes from, as words; empty where the format has one place for
        it.
    ignored : str
        What else the file says of a voxel's size that was left aside, and why.
    """

    values: np.ndarray
    colour: bool = False
    spacing: tuple[float, ...] | None = None
    unit: str | None = None
    fields: dict[str, Any] | None = None
    lossy: bool = False
    origin: str = ""
    ignored: str = ""


def encode(image: Image, **more: Any) -> str:
    """Return the fields of an image as one line of ASCII JSON."""
    return json.dumps({KEY: {**describe_fields(image), **more}})


def decode(text: str | bytes | None) -> dict[str, Any] | None:
    """Return the fields that `encode` wrote; None where the text is another program's.

    Raises
    ------
    ValueError
        The text starts as ours and is damaged.
    """
    if text is None:
        return None
    if isinstance(text, bytes):
        text = text.decode("utf-8", "replace")
    text = text.strip("\0 \r\n\t")
    if not text.startswith(f'{{"{KEY}"'):
        return None
    return check_fields(json.loads(text)[KEY])


def check_fields(fields: Any) -> dict[str, Any]:
    """Return the fields; ValueError where they are not what `encode` wrote."""
    types = {"kind": str, "spacing": list, "unit": str, "phases": list, "recipe": list}
    if not isinstance(fields, dict) or not all(
        isinstance(fields.get(name), kind) for name, kind in types.items()
    ):
        raise ValueError("its metadata are damaged")
    if fields["kind"] not in KINDS or not all(
        isinstance(step, dict) and "verb" in step for step in fields["recipe"]
    ):
        raise ValueError("its metadata are damaged")
    if not all(isinstance(name, str) for name in fields["phases"]):
        raise ValueError("its metadata are damaged")
    if not all(type(edge) in (int, float) for edge in fields["spacing"]):
        raise ValueError("its metadata are damaged")
    if not _whole_numbers(fields.get("levels", [])) or not _whole_numbers(fields.get("shape", [])):
        raise ValueError("its metadata are damaged")
    return fields


def _whole_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(type(number) is int and number >= 0 for number in value)


def greys_of_labels(image: Image) -> tuple[np.ndarray, list[int] | None]:
    """Map labels to greys from black to white, so that pictures show them; return the greys and the
    grey of each label. Other kinds stay as they are.
    """
    if image.kind != "labels":
        return image.values, None
    count = len(image.phases)
    levels = [255 * label // (count - 1) for label in range(count)]
    return np.array(levels, np.uint8)[image.values], levels


def labels_of_greys(values: np.ndarray, fields: dict[str, Any] | None) -> np.ndarray:
    """Return the labels behind the greys of `greys_of_labels`; values without such a record as they
    are.

    Raises
    ------
    ValueError
        A grey that is none of the recorded ones: another program changed the picture.
    """
    levels = (fields or {}).get("levels")
    if levels is None:
        return values
    table = np.full(256, 255, np.uint8)
    table[levels] = np.arange(len(levels))
    found = table[values]
    if found.max() >= len(levels):
        raise ValueError(
            f"it holds greys besides its labels' {levels}, so another program changed it"
        )
    return found
