"""What a run holds beside its voxels."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trabecula.engine.parallel import thread_count
from trabecula.synth.bubbles.growth import CUBE, MARGIN, flow_step
from trabecula.synth.bubbles.growth_law import Law
from trabecula.synth.bubbles.kernels import BLOCK, MOST
from trabecula.synth.bubbles.porosity_level import bytes_counted

_DRAWN = 124  # bytes for each bubble, while places are found
_HELD = 60  # and later
_SEARCH = 48  # and in every thread, beside what a block needs
_FORMS = MOST * (64 + 3) * 4
_LEAST = 200_000  # tables, the recipe


def bytes_of_box(law: Law, shape: Sequence[int], *, flows: bool) -> int:
    """Of the bubbles in reach of a box (Z, Y, X), of its nodes, and of the search in every thread."""
    around = 2 * (law.reach + MARGIN * law.apart)
    wide = [side for side in shape if law.ndim == 3] or list(shape[1:])
    bubbles = math.prod((side + CUBE + around) / law.apart + 1 for side in wide)
    nodes = math.prod((side + CUBE) / BLOCK + 1 for side in wide) if law.shift else 0.0
    flow = 0.0
    if flows:
        flow = 2 * math.prod((side + CUBE + 2 * law.reach) / flow_step(law) + 3 for side in wide)
        flow += math.prod((side + CUBE) / BLOCK + 1 for side in wide)
    searched = (_HELD + 80 * flows) * bubbles + thread_count() * (_SEARCH * bubbles + _FORMS)
    return int(max(_DRAWN * bubbles, searched) + 12 * nodes + 3 * flow) + _LEAST


def bytes_of_level(law: Law, shape: Sequence[int], *, flows: bool) -> tuple[int, int]:
    """Of what is known of the arrivals in a request, and of finding it."""
    kept, held, part = bytes_counted(law, shape)
    return kept, max(
        held, kept + bytes_of_box(law, [min(part, side) for side in shape], flows=flows)
    )
