"""A method under test: `MethodCase`, with a small exemplar, a model and material of it."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.engine.parallel import threads
from trabecula.exemplar.crop import crop
from trabecula.exemplar.samples import sample
from trabecula.io.files import read, write
from trabecula.synth.api.capabilities import Capabilities
from trabecula.synth.api.method import Method, Model
from trabecula.synth.api.registry import method_class, methods

SHAPE = (26, 14, 37)
"""Odd and even sides, no multiple of a step, of a level or of a block."""

SEED = 5

FORM = np.hypot.outer(np.arange(-13, 13), np.hypot.outer(np.arange(-7, 7), np.arange(-18, 19))) < 14
"""A ball of the shape, cut off."""

VOXEL = (0.5, "mm")
"""Spacing and unit of material that is made from settings alone."""


class Inapplicable(Exception):  # noqa: N818  (no error: the check says nothing of this method)
    """A check that does not apply to a method, with the reason."""


class MethodCase:
    """A method under test.

    Parameters
    ----------
    method : str or type of Method
        The name of a registered method, or a class.
    exemplar : Image, optional
        Default: a part of the method's sample, of a size that the method learns from in seconds.
    small : Image, optional
        A smaller one for presets. Default: a part of the exemplar.
    """

    def __init__(
        self,
        method: str | type[Method],
        *,
        exemplar: Image | None = None,
        small: Image | None = None,
    ) -> None:
        self.cls = method_class(methods()[method]) if isinstance(method, str) else method
        self._folder = tempfile.TemporaryDirectory(prefix="trabecula-check-")
        self._count = 0
        self._given, self._small = exemplar, small

    @property
    def capabilities(self) -> Capabilities:
        """Return what the method says of itself."""
        return self.cls.capabilities

    @property
    def trains(self) -> bool:
        """Tell whether learning is expensive, and the file of a model holds what it learned."""
        return not self.capabilities.stores_exemplar

    def folder(self) -> Path:
        """Make a new empty folder, which lasts as long as the case."""
        self._count += 1
        path = Path(self._folder.name) / str(self._count)
        path.mkdir()
        return path

    @cached_property
    def exemplar(self) -> Image | None:
        """Return the exemplar; None for a method that learns from settings alone. It comes from a
        sample or a file, since a recipe cannot find an array in memory again.
        """
        if self._given is not None:
            return read(write(self._given, self.folder() / "exemplar.tif"))
        if self.capabilities.exemplar is None:
            return None
        volume = crop(sample(self.capabilities.sample), 64 if self.trains else 40)
        if self.capabilities.exemplar == "2d":
            middle = volume.values[len(volume.values) // 2]
            voxel = (volume.spacing[1:], volume.unit, volume.phases)
            volume = Image(middle, "labels", *voxel)
        if "labels" not in self.capabilities.kinds:
            volume = _of_kind(volume, self.capabilities.kinds[0])
        if self.capabilities.exemplar == "3d" and volume.kind == "labels":
            return volume
        return read(write(volume, self.folder() / "exemplar.tif"))

    @cached_property
    def relative(self) -> Image:
        """Return a volume of the material that the default exemplar is a slice of."""
        return crop(sample("bone"), 40)

    @cached_property
    def small(self) -> Image | None:
        """Return a smaller exemplar for presets; the same where learning is expensive."""
        if self._small is not None or self.exemplar is None or self.trains:
            return self._small or self.exemplar
        return crop(self.exemplar, 24)

    def need_exemplar(self) -> Image:
        """Return the exemplar, or say that the check does not apply."""
        if self.exemplar is None:
            raise Inapplicable(f"{self.capabilities.name} learns from settings alone")
        return self.exemplar

    def method(self, preset: str | None = None, **settings: Any) -> Method:
        """Return the method with its trial settings."""
        return self.cls.configure(preset=preset, **{**self.capabilities.trial, **settings})

    def fit(
        self,
        exemplar: Image | np.ndarray | None = None,
        *,
        preset: str | None = None,
        count: int = 1,
    ) -> Model:
        """Learn from the exemplar, or another, with `count` threads (training: always with one)."""
        chosen = self.exemplar if exemplar is None else exemplar
        with threads(1 if self.trains else count):
            if chosen is None:
                return self.method(preset).fit(spacing=VOXEL[0], unit=VOXEL[1])
            return self.method(preset).fit(chosen)

    @cached_property
    def model(self) -> Model:
        """Return a model of the exemplar."""
        return self.fit()

    @cached_property
    def fast_model(self) -> Model:
        """Return a model by the preset "fast", where there is one."""
        return self.fit(preset="fast") if "fast" in self.capabilities.presets else self.model

    @cached_property
    def material(self) -> Image:
        """Return a result of the model."""
        return self.model.generate(SHAPE, seed=SEED)

    def again(self, count: int = 1) -> Model:
        """Return a model that has learned once more; the same where learning is expensive."""
        return self.model if self.trains else self.fit(count=count)

    def request(self, **parts: Any) -> Request:
        """Return the request of `material`, with other parts."""
        return Request(SHAPE, seed=SEED, **parts)


def _of_kind(image: Image, kind: str) -> Image:
    """Return an image of labels as one of grey values or colours: blurred, so that it has many."""
    solid = (image.values == image.values.max()).astype(np.float32)
    for axis in range(image.ndim):
        solid = (np.roll(solid, 1, axis) + 2 * solid + np.roll(solid, -1, axis)) / 4
    grey = np.rint(40 + 170 * solid).astype(np.uint8)
    values = grey if kind == "grey" else np.stack([grey, 255 - grey, grey // 2], axis=-1)
    return Image(values, kind, image.spacing, image.unit)


@contextmanager
def raises(kind: type[BaseException], pattern: str, message: str) -> Iterator[None]:
    """Check that the block raises an error whose text matches a pattern."""
    try:
        yield
    except kind as error:
        assert re.search(pattern, str(error)), f"{message}: its message is {str(error)!r}"
        return
    raise AssertionError(message)


def same(found: np.ndarray, expected: np.ndarray, message: str) -> None:
    """Check that two arrays hold the same values."""
    if found.shape != expected.shape:
        raise AssertionError(f"{message}: the shapes are {found.shape} and {expected.shape}")
    differing = int(np.count_nonzero(found != expected))
    assert not differing, f"{message}: {differing} of {expected.size} voxels differ"


Check = Callable[[MethodCase], None]
