"""The runs behind "The five papers, reproduced": each is one or several cases that stand."""

from __future__ import annotations

from collections.abc import Callable

import bubbles
import graded
import image_paper
import texture

RUNS: dict[str, Callable[[], None]] = {
    "repeat": texture.repeat,
    "lattice": graded.graded_lattice,
    "cells": graded.graded_cells,
    "section": graded.graded_section,
    "heuristics": image_paper.image_paper,
    "bubbles": bubbles.bubbles_table,
}
"""Name of a run to what it prints; the name of its file, and a word for `--run`."""
