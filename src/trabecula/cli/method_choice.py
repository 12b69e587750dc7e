"""The method of an exemplar where none is named, and the error where a named one cannot learn from
it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from math import prod
from typing import Any

from trabecula.cli import options as shared
from trabecula.core.errors import InputError

_VOXEL = 20  # bytes of a voxel of a method that makes its results in memory

_FOR_TWO_PHASES = ("texture", "packing", "fibres")
"""Methods that an effort tries for a volume of two phases where none is named."""


def method_for(
    exemplars: list[Any], options: argparse.Namespace, shape: Sequence[int] | None = None
) -> tuple[Any, str]:
    """Return the method that `inspect` recommends, and a line that reports it, empty where there is
    nothing to report; `texture` where that one cannot make the volume of the request.

    Its preset is taken where neither a preset nor settings are given. With these a volume is learnt
    by `texture`: so they were meant before there was a choice.

    Raises
    ------
    InputError
        No method can learn from the exemplar.
    """
    from trabecula.exemplar.margins import crop_margins
    from trabecula.report.recommend import recommend
    from trabecula.synth.api.registry import method

    preset, settings = shared.preset_and_settings(options)
    plain = preset is None and not settings
    if not plain and exemplars[0].ndim == 3:
        return method("texture", preset=preset, **settings), ""
    graded = _graded(options)
    found = recommend(crop_margins(exemplars[0]), graded=graded, alone=len(exemplars) == 1)
    if found.method is None:
        raise InputError(f"no method was named, and none fits: {found.reason}")
    name = found.method
    several = len(exemplars) > 1
    hindrance = _hindrance(name, options, shape, several=several) if exemplars[0].ndim == 3 else ""
    if hindrance:
        name = "texture"
        found = replace(
            found,
            method=name,
            preset=None,
            settings={},
            reason=f"{found.method} would be taken, and {hindrance}",
        )
    chosen = ""
    if plain:
        preset, settings, chosen = found.preset, dict(found.settings), found.words
    line = f"method {name}{chosen} (recommended: {found.reason})"
    return method(name, preset=preset, **settings), line


def _hindrance(
    name: str,
    options: argparse.Namespace,
    shape: Sequence[int] | None,
    *,
    several: bool = False,
) -> str:
    """Return why a method cannot make the request of a volume or of several; empty where it can."""
    from trabecula.engine.memory import available_memory
    from trabecula.synth.api.registry import methods

    known = methods()[name]
    if getattr(options, "fixed", None) is not None and "fixed" not in known.honours:
        return "makes nothing beside known voxels"
    if several and "volumes" not in known.learns_from:
        return "learns from one scan"
    budget = available_memory() if options.memory is None else options.memory
    if known.large == "memory" and _VOXEL * prod(shape or (0,)) > budget:
        return "the result is too large for it to be made in memory"
    return ""


def _graded(options: argparse.Namespace) -> list[str]:
    """List the names of the targets that are files of fields."""
    pairs = (pair.partition("=") for pair in getattr(options, "target", None) or ())
    return [name for name, _, value in pairs if not _is_number(value)]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def check_fits(method: Any, exemplars: list[Any]) -> None:
    """Raise where a method that was named cannot learn from an exemplar, and name one that can."""
    from trabecula.report.recommend import misfit

    known = method.capabilities
    for image in exemplars:
        flat = "picture" in known.makes or (known.accepts(2) and image.kind in known.kinds)
        why = misfit(image, known.name, known.exemplar, flat=flat)
        if why is not None:
            raise InputError(why)


def tried(
    method: Any,
    exemplars: list[Any] | None,
    options: argparse.Namespace,
    shape: Sequence[int] | None = None,
) -> Any:
    """Return the method with the settings that the trials of --effort choose, or another one where
    none was named, and tell what each gave.
    """
    from trabecula.cli.terminal import note
    from trabecula.pipeline.trials import choose_settings

    effort = shared.integer(options.effort, name="--effort")
    if exemplars is None or len(exemplars) != 1:
        raise InputError(
            f"--effort {effort}: trials are held against one exemplar, got {len(exemplars or ())}"
        )
    others = _others(method, exemplars[0], options, shape) if options.method is None else []
    chosen, trials = choose_settings(
        method, exemplars[0], others=others, effort=effort, memory=options.memory
    )
    for trial in trials:
        note(str(trial))
    if trials:
        note(f"taken: {min(trials, key=lambda trial: trial.rank).named}")
    return chosen


def _others(
    chosen: Any, exemplar: Any, options: argparse.Namespace, shape: Sequence[int] | None
) -> list[Any]:
    """Return the methods that may suit a volume of two phases as well as the one that is
    recommended, and can make the request; none beside a target, which that one was chosen for.
    """
    import numpy as np

    from trabecula.synth.api.registry import method

    two = exemplar.kind == "labels" and exemplar.ndim == 3 and len(np.unique(exemplar.values)) == 2
    if not two or getattr(options, "target", None):
        return []
    left = [name for name in _FOR_TWO_PHASES if name != chosen.capabilities.name]
    return [method(name) for name in left if not _hindrance(name, options, shape)]
