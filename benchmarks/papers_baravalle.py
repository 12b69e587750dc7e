"""The table and the figures of Baravalle et al. (2016), `bubbles`."""

from __future__ import annotations

from collections.abc import Iterator

from papers_rows import LESS, Row, Section
from papers_saved import load

TABLE = {
    "128^3": ("14.69", "34.61", "49.3", "150"),
    "256^3": ("38.83", "155.99", "194.82", "400"),
    "384^3": ("85.82", "356.35", "442.17", "1800"),
}
"""Table 1: seconds of loading, of growing, in all; MB of the process."""


def sections() -> Iterator[Section]:
    """Give the sections of the page."""
    saved, rows = load("bubbles"), []
    for cube, (loading, growing, total, memory) in TABLE.items():
        load_s, flow_s = (saved.cell(cube, head) for head in ("load s", "flow s"))
        held = float(saved.cell(cube, "bytes")) * int(cube.removesuffix("^3")) ** 3 / 1e6
        rows += [
            Row(f"{cube}: load and voxelise, s", loading, load_s, wanted=LESS),
            Row(
                f"{cube}: grow, s",
                growing,
                flow_s,
                f"without a flow {saved.cell(cube, 'grow s')}; to a porosity "
                f"{saved.cell(cube, 'porosity s')}",
                wanted=LESS,
            ),
            Row(f"{cube}: in all, s", total, f"{float(load_s) + float(flow_s):.2f}", wanted=LESS),
            Row(f"{cube}: memory, MB", memory, f"{held:.0f}"),
        ]
    yield Section("baravalle table 1", ["bubbles"], rows)
    yield Section("baravalle figures 1 to 7", ["bubble_figures"])
    yield Section("baravalle figures 9 to 14", ["bubble_stills"])
