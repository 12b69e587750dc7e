"""A training's state in its folder: arrays and plain JSON in one file, nothing pickled."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.core.recipe import digest
from trabecula.engine.files import replacing
from trabecula.synth.gan.config import GanConfig

_FILE = "training.npz"
_ABOUT = "about"


@dataclass(frozen=True)
class Left:
    """What a run left: tensors by name, and plain JSON."""

    tensors: dict[str, Tensor]
    plain: dict[str, Any]


def kept(
    config: GanConfig, image: Image, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]
) -> None:
    """Write the state into the run's folder, where it has one."""
    if not config.run:
        return
    about = json.dumps({"identity": _identity(config, image), **plain}).encode()
    with replacing(Path(config.run) / _FILE) as temporary, temporary.open("wb") as stream:
        arrays = {f"state.{name}": tensor.cpu().numpy() for name, tensor in tensors.items()}
        np.savez(stream, **{_ABOUT: np.frombuffer(about, np.uint8)}, **arrays)  # type: ignore[arg-type]


def left(config: GanConfig, image: Image) -> Left | None:
    """What the same run left in its folder, or None: then it starts from nothing."""
    path = Path(config.run or ".") / _FILE
    if not config.run or not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            about = json.loads(bytes(stored[_ABOUT]))
            arrays = {
                name.removeprefix("state."): stored[name] for name in stored.files if name != _ABOUT
            }
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        notify(f"{path.name} is damaged ({error}): starting from the beginning")
        return None
    if about.pop("identity", None) != _identity(config, image):
        notify(f"{path.name} was left by another training: starting from the beginning")
        return None
    return Left({name: torch.from_numpy(array) for name, array in arrays.items()}, about)


def _identity(config: GanConfig, image: Image) -> str:
    """SHA-256 of all that the training depends on; how long it goes on may be changed."""
    settings = {
        name: value
        for name, value in asdict(config).items()
        if name not in ("run", "minutes", "looks", "patience")
    }
    parts = {
        "settings": settings,
        "exemplar": digest(image.values),
        "torch": str(torch.__version__),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
