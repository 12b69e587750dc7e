"""Models in files: a method's name and settings, with the exemplars or with what was learned of
them.

A file is laid out as safetensors (engine.tensors) and holds one word, "trabecula": plain JSON of

    format      1; a reader refuses what is newer
    method, settings
    exemplars   facts of each; its voxels are the array "exemplar.0" and so on, of a method that
    does not learn learned     plain JSON of a method that does; its arrays are "learned.NAME"
    found       plain JSON of what one that does not took long to find in its exemplars
    history     plain JSON of how the learning went
    versions    of what wrote it

Loading checks all of it, and executes nothing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from trabecula import models
from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, InputError, MissingExtraError
from trabecula.core.image import Image
from trabecula.core.recipe import versions
from trabecula.engine import tensors
from trabecula.engine.files import replacing
from trabecula.engine.memory import available_memory, format_bytes
from trabecula.io.guard import check_there, damaged
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method, Model
from trabecula.synth.api.registry import method, methods

FORMAT = 1
_KEY = "trabecula"
_VOXELS, _LEARNED = "exemplar.", "learned."


def load_model(source: str | os.PathLike[str]) -> Model:
    """A model from a file, or one that comes with the package by its name.

    Parameters
    ----------
    source : path or str

    Raises
    ------
    FileError
        No such file; one that is damaged, cut off, no model, or made by a newer version.
    UnknownNameError
        Neither a file nor a shipped model.
    MissingExtraError
        The model's method needs a package that is not installed.

    Examples
    --------
    >>> import tempfile, trabecula as tb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tb.method("noise", reach=8).fit(tb.crop(tb.sample("bone"), 24)).save(f"{folder}/bone.model")
    ...     tb.load_model(path).generate(30, seed=1)
    <Image 30x30x30 labels, voxel 40x40x40 um, phases void/solid>
    """
    path = place_of(source)
    size = path.stat().st_size
    if 2 * size > available_memory():
        raise FileError(
            f"cannot read {path} as a model: it has {format_bytes(size)}, more than fits into memory twice"
        )
    with damaged(path, "a model", checked=False):
        model = decoded(path.read_bytes(), path)
    model.name = path.stem if path == models.shipped().get(path.stem) else path.name
    return model


def place_of(source: str | os.PathLike[str]) -> Path:
    """The file of a model: the path itself, or that of a shipped model of that name."""
    path, known = Path(source), models.shipped()
    if path.is_dir():
        raise FileError(f"cannot read {path} as a model: it is a folder")
    if not path.exists() and os.fspath(source) in known:
        return known[os.fspath(source)]
    if not path.exists() and not path.suffix and path.parent == Path():
        check_name(os.fspath(source), known, name="model (and there is no such file)")
    check_there(path)
    return path


def save_model(model: Model, path: str | os.PathLike[str]) -> Path:
    """Write a model (see `Model.save`)."""
    place = Path(path)
    data = encoded(model, history=dict(model.history), versions=versions())
    with replacing(place) as temporary:
        temporary.write_bytes(data)
    model.name = place.name
    return place


def encoded(model: Model, **more: Any) -> bytes:
    """The bytes of a model's file; `more` is said in it as well."""
    about: dict[str, Any] = {
        "format": FORMAT,
        "method": model.capabilities.name,
        "settings": asdict(model.config),
        "exemplars": [facts.to_json() for facts in model.facts],
    }
    if model.capabilities.learns:
        arrays, plain = model.state()
        about["learned"] = dict(plain)
        named = {f"{_LEARNED}{name}": array for name, array in arrays.items()}
    else:
        named = {f"{_VOXELS}{number}": image.values for number, image in enumerate(model.exemplars)}
        found = dict(model.looked_up())
        about.update({"found": found} if found else {})
    return tensors.encode(
        named, {_KEY: json.dumps({**about, **more}, sort_keys=True, allow_nan=False)}
    )


def decoded(data: bytes, path: Path) -> Model:
    """The model that `encoded` gave the bytes of, history and versions among it; `path` is what
    messages call it.

    Raises
    ------
    FileError, ValueError, TypeError, LookupError
        Other bytes.
    """
    arrays, words = tensors.decode(data)
    return _opened(path, arrays, _about(path, words))


def _about(path: Path, words: Mapping[str, str]) -> dict[str, Any]:
    if _KEY not in words:
        raise FileError(
            f"cannot read {path} as a model: it holds arrays, but none that this package wrote"
        )
    about = json.loads(words[_KEY])
    if not isinstance(about, dict) or type(about.get("format")) is not int:
        raise ValueError("what it says of itself is damaged")
    if about["format"] > FORMAT:
        made = dict(about.get("versions") or {}).get("trabecula", "unknown")
        raise FileError(
            f"cannot read {path} as a model: trabecula {made} wrote it, in format {about['format']}; this one reads up "
            f"to {FORMAT}: install a newer trabecula"
        )
    return about


def _opened(path: Path, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Model:
    known, name = methods(), about["method"]
    if name not in known:
        raise FileError(
            f"cannot read {path} as a model: its method {name!r} is not in this trabecula; update it"
        )
    try:
        facts = [ExemplarInfo.from_json(plain) for plain in about["exemplars"]]
        if not facts:
            raise ValueError("it names no exemplar")
        _check_finite(arrays)
        chosen = method(name, **about["settings"])
        if known[name].learns:
            return chosen.from_state(
                facts, _named(arrays, _LEARNED), about["learned"], history=dict(about["history"])
            )
        return _fitted(chosen, facts, _named(arrays, _VOXELS), about.get("found"))
    except MissingExtraError:
        raise
    except InputError as error:
        raise FileError(f"cannot read {path} as a model: {error}") from error


def _fitted(
    chosen: Method,
    facts: Sequence[ExemplarInfo],
    voxels: Mapping[str, np.ndarray],
    found: Mapping[str, Any] | None,
) -> Model:
    if len(facts) == 1 and facts[0].blank:
        return chosen.fit(spacing=facts[0].spacing[0], unit=facts[0].unit)
    if sorted(voxels) != sorted(str(number) for number in range(len(facts))):
        raise ValueError(
            f"it holds the voxels of {len(voxels)} exemplars and describes {len(facts)}"
        )
    exemplars = [
        Image(voxels[str(number)], one.kind, one.spacing, one.unit, one.phases, one.recipe)
        for number, one in enumerate(facts)
    ]
    return chosen.fit(exemplars) if found is None else chosen.fit_again(exemplars, found)


def _named(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    strange = [name for name in arrays if not name.startswith(prefix)]
    if strange:
        raise ValueError(f"it holds {strange[0]!r}, which has no place in it")
    return {name.removeprefix(prefix): array for name, array in arrays.items()}


def _check_finite(arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name!r} holds NaN or infinite numbers")
