"""Models as bytes, in files and for worker processes: a method's name and settings, with the
exemplars or with the state of training.

A file is laid out as safetensors (engine.tensors) and holds one word, "trabecula": plain JSON of

    format      1; a reader refuses what is newer
    method, settings
    exemplars   description of each; where the model stores them, their voxels are the arrays
                "exemplar.0" and so on
    learned     plain JSON of the state, of a model that does not store its exemplars
    found       plain JSON of the state, of one that does, where it has a state
    history     plain JSON of the course of the learning
    versions    of the package that wrote it

The arrays of a state are "learned.NAME". `Model.save` writes it; loading checks all of it, and
executes nothing.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trabecula import models
from trabecula.core.checks import as_path_text, check_name
from trabecula.core.errors import FileError, InputError, MissingExtraError
from trabecula.core.image import Image
from trabecula.core.recipe import versions
from trabecula.core.request import Request
from trabecula.engine import tensors
from trabecula.engine.blocks import Box
from trabecula.engine.memory import available_memory, format_bytes
from trabecula.engine.parts import parts_of, whole_name
from trabecula.io.guard import check_there, report_damage
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method
from trabecula.synth.api.model import FORMAT, KEY, STATE, VOXELS, Model, ModelState
from trabecula.synth.api.registry import methods, recorded_method
from trabecula.synth.api.windows import WindowModel, makes_boxes


def load_model(source: str | os.PathLike[str]) -> Model:
    """Load a model from a file, or one that comes with the package by its name.

    Parameters
    ----------
    source : path or str
        A model that was saved in parts is named as the whole, or by any part.

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
    ...     model = tb.method("noise", reach=8).fit(tb.crop(tb.sample("bone"), 24))
    ...     tb.load_model(model.save(f"{folder}/bone.model")).generate(30, seed=1)
    <Image 30x30x30 labels, voxel 40x40x40 um, phases void/solid>
    """
    path = place_of(source)
    files = parts_of(path)
    size = sum(file.stat().st_size for file in files)
    if 2 * size > available_memory():
        raise FileError(
            f"cannot read {path} as a model: it has {format_bytes(size)}, more than fits into "
            "memory twice"
        )
    with report_damage(path, "a model", checked=False):
        model = decode_model(b"".join(file.read_bytes() for file in files), path)
    model.name = path.stem if path == models.shipped_models().get(path.stem) else path.name
    return model


def place_of(source: str | os.PathLike[str]) -> Path:
    """Return the file of a model: the path itself, or that of a shipped model of that name."""
    path, known = whole_name(Path(as_path_text(source))), models.shipped_models()
    if parts_of(path) not in ([], [path]):
        return path
    if path.is_dir():
        raise FileError(f"cannot read {path} as a model: it is a folder")
    if not path.exists() and os.fspath(source) in known:
        return known[os.fspath(source)]
    if not path.exists() and not path.suffix and path.parent == Path():
        check_name(os.fspath(source), known, name="model (and there is no such file)")
    check_there(path)
    return path


def decode_model(data: bytes, path: Path) -> Model:
    """Build the model of a file's bytes (`Model.to_bytes` with history and versions).

    Parameters
    ----------
    data : bytes
    path : Path
        Name for messages.

    Raises
    ------
    FileError, ValueError, TypeError, LookupError
        Other bytes.
    """
    arrays, words = tensors.decode(data)
    return _build(path, arrays, _about(path, words))


def _about(path: Path, words: Mapping[str, str]) -> dict[str, Any]:
    """Return the plain JSON of a file, its format checked."""
    if KEY not in words:
        raise FileError(
            f"cannot read {path} as a model: it holds arrays, but none that this package wrote"
        )
    about = json.loads(words[KEY])
    if not isinstance(about, dict) or type(about.get("format")) is not int:
        raise ValueError("what it says of itself is damaged")
    if about["format"] > FORMAT:
        wrote = dict(about.get("versions") or {}).get("trabecula", "unknown")
        raise FileError(
            f"cannot read {path} as a model: trabecula {wrote} wrote it, in format "
            f"{about['format']}; this one reads up to {FORMAT}: install a newer trabecula"
        )
    return about


def _build(path: Path, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Model:
    """Build a model from the parts of its file."""
    known, name = methods(), about["method"]
    if name not in known:
        raise FileError(
            f"cannot read {path} as a model: its method {name!r} is not in this trabecula; update "
            "it, or install the package that has it"
        )
    try:
        exemplars = [ExemplarInfo.from_json(plain) for plain in about["exemplars"]]
        if not exemplars:
            raise ValueError("it names no exemplar")
        _check_finite(arrays)
        chosen = recorded_method(name, about["settings"])
        stores = known[name].stores_exemplar
        _check_prefixes(arrays, (VOXELS, STATE) if stores else (STATE,))
        voxels, state = _take(arrays, VOXELS), _take(arrays, STATE)
        if not stores:
            history = dict(about["history"])
            return chosen.from_state(exemplars, ModelState(state, about["learned"], history))
        history = dict(about.get("history") or {})
        found = ModelState(state, about.get("found") or {}, history)
        return _restore(chosen, exemplars, voxels, found)
    except MissingExtraError:
        raise
    except InputError as error:
        raise FileError(f"cannot read {path} as a model: {error}") from error


def _restore(
    chosen: Method,
    exemplars: Sequence[ExemplarInfo],
    voxels: Mapping[str, np.ndarray],
    state: ModelState,
) -> Model:
    """Restore a model that stores its exemplars, or fit it anew where it has no state."""
    stateless = not state.plain and not state.arrays
    if len(exemplars) == 1 and exemplars[0].blank:
        if not stateless:
            return chosen.restore(exemplars, state)
        return chosen.fit(spacing=exemplars[0].spacing[0], unit=exemplars[0].unit)
    if sorted(voxels) != sorted(str(number) for number in range(len(exemplars))):
        raise ValueError(
            f"it holds the voxels of {len(voxels)} exemplars and describes {len(exemplars)}"
        )
    images = [
        Image(voxels[str(number)], one.kind, one.spacing, one.unit, one.phases, one.recipe)
        for number, one in enumerate(exemplars)
    ]
    return chosen.fit(images) if stateless else chosen.restore(images, state)


def _take(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays of a prefix by their names without it."""
    return {
        name.removeprefix(prefix): array
        for name, array in arrays.items()
        if name.startswith(prefix)
    }


def _check_prefixes(arrays: Mapping[str, np.ndarray], prefixes: tuple[str, ...]) -> None:
    strange = [name for name in arrays if not name.startswith(prefixes)]
    if strange:
        raise ValueError(f"it holds {strange[0]!r}, which has no place in it")


def _check_finite(arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name!r} holds NaN or infinite numbers")


class WorkerPayload:
    """A model and a request that can be pickled; called with a box it gives the box's values.

    The model travels as the bytes of its file; a worker opens them at its first box.
    """

    def __init__(self, model: WindowModel, request: Request) -> None:
        self.data = model.to_bytes(history=dict(model.history), versions=versions())
        self.request = request
        self.__setstate__(self.__getstate__())

    def __getstate__(self) -> dict[str, Any]:
        return {"data": self.data, "request": self.request}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._model: Model | None = None
        self._lock = threading.Lock()

    def __call__(self, box: Box) -> np.ndarray:
        """Return the values of a box."""
        with self._lock:  # a worker may make several boxes at once
            if self._model is None:
                self._model = decode_model(self.data, Path("the model that was sent"))
        if not makes_boxes(self._model):
            raise TypeError("a model that makes no boxes was sent")
        return self._model.values_of(self.request, box)
