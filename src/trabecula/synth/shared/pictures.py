"""The common part of methods from pictures: views of one to three pictures, and their checks."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.exemplar.sections import gap_contradiction
from trabecula.exemplar.views import View, spacing_of, views_of
from trabecula.measure.disector import check_sections
from trabecula.synth.api.method import Method, Model
from trabecula.synth.shared.content.fields import phases_present

ROOM = 4
"""Positions that a neighbourhood needs along an axis of a picture, at least."""

_ENOUGH = 4  # parallel sections


def check_pictures_agree(images: Sequence[Image]) -> None:
    """Raise where pictures of one material differ in kind, phases or unit."""
    first = images[0]
    for image in images[1:]:
        for name in ("kind", "phases", "unit"):
            if getattr(image, name) != getattr(first, name):
                raise InputError(
                    f"pictures of one material agree in {name}: got {getattr(first, name)} "
                    f"and {getattr(image, name)}; convert or rename them first"
                )


def check_gap(images: Sequence[Image], gap: int) -> None:
    """Raise where pictures are no parallel sections so far apart; where they hardly can be, say
    so.
    """
    sections, gap = check_sections(images, gap)
    if found := gap_contradiction(sections, gap):
        notify(found)


def _check_sections(images: Sequence[Image], gap: int) -> None:
    """Raise where parallel sections do not say how labels are joined; where few do, say so."""
    if images[0].kind != "labels":
        raise InputError(
            f"parallel sections say how labels are joined, got {images[0].kind}: segment them "
            "(--threshold), or leave out the gap"
        )
    first, every = phases_present(images[:1]), phases_present(images)
    if first != every:
        raise InputError(
            f"the first section has the labels {list(first)}, all of them {list(every)}: give one "
            "first that shows every phase"
        )
    check_gap(images, gap)
    if len(images) < _ENOUGH:
        notify(
            f"the Euler number that {len(images)} sections say scatters, in scans by a tenth to "
            "nine tenths of it: give five, where there are more"
        )


class PictureModel(Model):
    """A model of a material seen in some views; `sections` are the parallel ones that it learnt
    from.
    """

    def __init__(self, config: Any, exemplars: Sequence[Image], views: Sequence[View]) -> None:
        super().__init__(config, exemplars)
        self.views = tuple(views)
        self.sections = tuple(exemplars) if _gap_of(config) else ()

    def _result_fields(self) -> dict[str, Any]:
        return {**super()._result_fields(), "spacing": spacing_of(self.views)}


class PictureMethod(Method):
    """A method that learns from pictures; its config has a field `views`, and where it learns from
    parallel sections a field `gap`.
    """

    def _check_exemplars(self, images: Sequence[Image]) -> None:
        for image in images:
            self._check_exemplar(image)
            self._check_picture(image)
        check_pictures_agree(images)
        if gap := _gap_of(self.config):
            _check_sections(images, gap)

    def _check_picture(self, image: Image) -> None:
        least = self._width() + ROOM
        if min(image.shape) < least:
            raise InputError(
                f"the exemplar is {image.shape}, a neighbourhood of {self._width()} needs at "
                f"least {least} pixels along every "
                "side: give a larger picture, or a smaller neighbourhood"
            )
        if image.kind != "labels" and (image.values == image.values[0, 0]).all():
            raise InputError("the exemplar holds one value only: give one with structure")

    def learn(self, exemplars: Sequence[Image]) -> PictureModel:
        views = views_of(exemplars, self.config.views, gap=_gap_of(self.config))
        for view in views:  # a finer picture has fewer pixels at the others' magnification
            self._check_picture(view.image)
        return self._learn(exemplars, views)

    def _shown(self, exemplars: Sequence[Image]) -> Sequence[Image]:
        """Return the exemplars that planes are to look like: of parallel sections the first."""
        return exemplars[:1] if _gap_of(self.config) else exemplars

    @abstractmethod
    def _width(self) -> int:
        """Return the pixels a side of the largest neighbourhood."""

    @abstractmethod
    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> PictureModel: ...


def _gap_of(config: Any) -> int:
    """Return the pixels from one exemplar to the next, where they are parallel sections; else 0."""
    return int(getattr(config, "gap", 0))
