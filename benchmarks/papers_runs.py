"""The runs behind "The five papers, reproduced": each is one or several cases that stand."""

from __future__ import annotations

import os
from collections.abc import Callable

import bubbles
import bubbles_figures
import by_example
import gan
import gan_ablation
import gan_paper
import graded
import image
import image_figures
import image_paper
import papers_pictures
import texture
import texture_figures

PICTURES = "sandstone;ceramics;copolymer;composite;sofc;gravel;brick"


def _part(case: Callable[[], None], **options: str) -> Callable[[], None]:
    """A case with options of `trabecula bench` that choose a part of it."""

    def run() -> None:
        named = {f"TRABECULA_BENCH_{name}": value for name, value in options.items()}
        before = {name: os.environ.get(name) for name in named}
        os.environ.update(named)
        try:
            case()
        finally:
            for name, value in before.items():
                os.environ.pop(name)
                if value is not None:
                    os.environ[name] = value

    return run


RUNS: dict[str, Callable[[], None]] = {
    "by_example_2017": by_example.by_example_2017,
    "weights": texture_figures.texture_weights,
    "iso_value": texture_figures.texture_iso_value,
    "repeat": texture.repeat,
    "repeat_paper": texture.repeat_paper,
    "stills": papers_pictures.stills,
    "histogram": texture_figures.texture_histogram,
    "by_example_2021": by_example.by_example_2021,
    "gan_shipped": gan.shipped,
    "gan_speed": gan.speed,
    "gan_losses": gan_ablation.materials,
    "gan_paper": _part(gan_paper.gan_paper, DEVICE="cuda", MINUTES="9", BATCH="16"),
    "heuristics": _part(image_paper.image_paper, ONLY="ceramics;composite;gravel"),
    "cooling": image_figures.image_cooling,
    "upsampling": image_figures.image_upsampling,
    "relaxations": image_figures.image_relaxations,
    "colour": image_figures.image_colour,
    "indicators": _part(image.image_likeness, ONLY=PICTURES, METHODS="mrf;kopf", SIDE="32"),
    "views": image_figures.image_views,
    "section": graded.graded_section,
    "lattice": graded.graded_lattice,
    "cells": graded.graded_cells,
    "bubbles": bubbles.bubbles_table,
    "bubble_figures": bubbles_figures.bubbles_figures,
    "bubble_stills": papers_pictures.bubble_stills,
}
"""Name of a run to what it prints; the name of its file, and a word for `--run`."""
