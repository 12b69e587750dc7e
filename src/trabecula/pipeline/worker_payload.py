"""A window model and a request as a worker process receives them."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.recipe import versions
from trabecula.core.request import Request
from trabecula.engine.blocks import Box
from trabecula.synth.api.method import Model
from trabecula.synth.api.serialize import decode_model
from trabecula.synth.api.windows import WindowModel, makes_boxes


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
