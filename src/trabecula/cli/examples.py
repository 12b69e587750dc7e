"""Examples at the end of every verb's help: one after another, they work with `sample:bone`."""

from __future__ import annotations

import argparse

EXAMPLES = {
    "demo": ("trabecula demo", "trabecula demo --out first --json"),
    "methods": ("trabecula methods", "trabecula methods texture"),
    "samples": ("trabecula samples", "trabecula samples --json"),
    "models": ("trabecula models", "trabecula models --json"),
    "inspect": (
        "trabecula inspect sample:bone",
        "trabecula inspect sample:bone --crop 64 --json",
    ),
    "fit": (
        "trabecula fit sample:bone --out bone.model",
        "trabecula fit sample:bone --method noise --set reach=20 --out noise.model",
    ),
    "generate": (
        "trabecula generate sample:bone --shape 64 --seed 1 --out bone.zarr",
        "trabecula generate --model noise.model --shape 48 64 80 --out more.tif",
    ),
    "plan": (
        "trabecula plan sample:bone --shape 256 --out large.zarr",
        "trabecula plan --model noise.model --shape 1000 --json",
    ),
    "measure": (
        "trabecula measure bone.zarr --quick",
        "trabecula measure sample:bone --crop 48 --full --box 16 --json",
    ),
    "network": (
        "trabecula network sample:bone --crop 48",
        "trabecula network part.zarr --out pores.npz --json",
    ),
    "bodies": (
        "trabecula bodies sample:bone --crop 48",
        "trabecula bodies part.zarr --phase void --out cells.csv --json",
    ),
    "verify": (
        "trabecula verify sample:bone bone.zarr",
        "trabecula verify sample:bone bone.zarr --quick --report report.html",
    ),
    "field": (
        "trabecula field ramp --shape 48 --from 0.12 --to 0.32 --out ramp.npy",
        "trabecula field density sample:bone --shape 48 64 64 --seed 3 --out density.npy",
    ),
    "finish": (
        "trabecula finish bone.zarr --connect --out part.zarr",
        "trabecula finish bone.zarr --floaters --fill --scale 10 --out large.zarr",
    ),
    "check": (
        "trabecula check part.zarr --printer sla",
        "trabecula check part.zarr --scale 10 --set wall=0.3 --json",
    ),
    "export": (
        "trabecula export part.zarr --out part.stl",
        "trabecula export part.zarr --tolerance 0.5 --out part.3mf",
    ),
    "layers": (
        "trabecula layers part.zarr --form dlp --scale 10 --dry-run",
        "trabecula layers part.zarr --form svg --out contours",
    ),
    "view": (
        "trabecula view sample:bone part.zarr",
        "trabecula view part.zarr --html part.html",
    ),
    "render": (
        "trabecula render part.zarr --out part.png --size 400 300",
        "trabecula render part.zarr --turntable 24 --out part.gif",
    ),
    "rerun": (
        "trabecula rerun bone.zarr",
        "trabecula rerun more.tif --model noise.model",
    ),
    "bench": ("trabecula bench --list", "trabecula bench texture_speed"),
    "doctor": ("trabecula doctor", "trabecula doctor --json"),
    "completion": (
        "trabecula completion bash >> ~/.bashrc",
        "trabecula completion fish > ~/.config/fish/completions/trabecula.fish",
    ),
}
"""Two commands of every verb."""

_HEAD = "examples:\n"


class ExamplesFormatter(argparse.HelpFormatter):
    """A formatter that keeps the lines of the examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith(_HEAD) else super()._fill_text(text, width, indent)


def epilog(verb: str) -> str:
    """Return the examples of a verb as the end of its help."""
    return _HEAD + "\n".join(f"  {line}" for line in EXAMPLES[verb])
