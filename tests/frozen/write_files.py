"""Write the model and result files of `tests/frozen/files`, once.

    python tests/frozen/write_files.py

A file that is there is left alone: the files stand for what version 0.1 wrote, and later versions
must read them and repeat them. Paths in recipes are names of files beside the result, and samples.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import trabecula as tb
from frozen.cases import (
    FILES,
    HONOURS,
    QUICK,
    ball,
    bone,
    colour,
    command,
    grey,
    model,
    options_of,
    picture,
    ramp,
)

SIZE = ("--shape", "16", "18", "20", "--seed", "3")


def write(name: str, make: Callable[[str], object]) -> None:
    """Write a file unless it is there."""
    if not Path(name).exists():
        make(name)


def generate(
    name: str, *words: str, method: str | None = None, size: tuple[str, ...] = SIZE
) -> None:
    """Generate a file by the command line unless it is there."""
    settings = [] if method is None else ["--method", method, *options_of(QUICK[method])]
    write(name, lambda out: command("generate", *words, *settings, *size, "--out", out))


def write_inputs() -> None:
    """Write exemplars, masks, fields and measured parts."""
    slab = tb.sample("bone")[36:60, 36:60, 48]
    write("slice.png", lambda out: tb.write(slab, out))
    write("across.png", lambda out: tb.write(tb.sample("bone")[36:60, 48, 36:60], out))
    write("grey.nrrd", lambda out: tb.write(grey(20), out))
    write("grey.png", lambda out: tb.write(picture(grey(28)), out))
    write("colour.png", lambda out: tb.write(picture(colour(28)), out))
    write("scan.npy", lambda out: np.save(out, bone(24).values[:8]))
    form = tb.Image(ball((14, 14, 14)).astype(np.uint8), "labels", (0.04,) * 3, "mm")
    write("form.stl", lambda out: tb.export(form, out, phase=1))
    write("form.3mf", lambda out: tb.export(form, out, phase=1))
    mask = tb.Image(ball().astype(np.uint8), "labels", (40.0,) * 3, "um", ("void", "solid"))
    write("mask.nrrd", lambda out: tb.write(mask, out))
    write("known.nrrd", lambda out: tb.write(mask, out))
    values = np.pad(bone(24).values[:12, :18, :20], ((0, 4), (0, 0), (0, 0)))
    write(
        "fixed.nrrd",
        lambda out: tb.write(tb.Image(values, "labels", (40.0,) * 3, "um", ("void", "solid")), out),
    )
    write("field.npy", lambda out: np.save(out, ramp(0.12, 0.3)))


def write_models() -> None:
    """Write a model of every method."""
    for method in HONOURS:
        write(f"{method}.model", lambda out, method=method: model(method).save(out))
    alone = tb.method("bubbles", preset="bread", distance=8.0)
    write("bubbles-alone.model", lambda out: alone.fit(spacing=2.0, unit="um").save(out))
    two = tb.method("kopf", **QUICK["kopf"], views=("yx", "zx"))
    pictures = [picture(bone(32)), picture(bone(32), 1)]
    write("kopf-views.model", lambda out: two.fit(pictures).save(out))
    write(
        "mrf-colour.model",
        lambda out: tb.method("mrf", **QUICK["mrf"]).fit(picture(colour(28))).save(out),
    )
    write(
        "texture-grey.model",
        lambda out: tb.method("texture", **QUICK["texture"]).fit(grey(20)).save(out),
    )


def write_generated() -> None:
    """Write results of every method, part of a request and kind of run."""
    sample = ("sample:bone", "--crop", "24")
    for method in ("texture", "quilt", "noise", "bubbles"):
        generate(f"{method}.nrrd", *sample, method=method)
    for method in ("mrf", "kopf", "chen", "sliced"):
        generate(f"{method}.nrrd", "slice.png", method=method)
    for method in ("kopf", "quilt", "texture"):
        exemplars = (
            ("slice.png", "across.png")
            if method == "kopf"
            else ("sample:bone", "sample:bone", "--crop", "20")
        )
        generate(f"{method}-several.nrrd", *exemplars, method=method)
    generate("texture-grey.npy", "grey.nrrd", "--threshold", "none", method="texture")
    generate("texture-segmented.nrrd", "grey.nrrd", "--threshold", "otsu", method="texture")
    generate("mrf-grey.nrrd", "grey.png", "--threshold", "none", method="mrf")
    generate("chen-colour.nrrd", "colour.png", method="chen")
    generate("mrf-colour.tif", "colour.png", method="mrf")
    generate(
        "bubbles-preset.tif",
        "--preset",
        "stone",
        "--spacing",
        "2",
        "--unit",
        "um",
        "--method",
        "bubbles",
    )
    generate(
        "noise-alone.mha", "--method", "noise", "--set", "kind=voronoi", "--set", "porosity=0.6"
    )
    generate(
        "quilt-flat.png", "slice.png", method="quilt", size=("--shape", "40", "44", "--seed", "3")
    )
    generate("texture-preset.nii.gz", *sample, "--preset", "fast", "--method", "texture")

    generate("texture-periodic.nrrd", *sample, "--periodic", "z", "x", method="texture")
    generate("texture-mask.nrrd", *sample, "--mask", "mask.nrrd", method="texture")
    generate("bubbles-mesh.nrrd", *sample, "--mask", "form.stl", method="bubbles")
    generate(
        "noise-mesh-unit.nrrd", *sample, "--mask", "form.3mf", method="noise", size=("--seed", "3")
    )
    generate(
        "bubbles-mesh-scale.nrrd",
        *sample,
        "--mask",
        "form.stl",
        "--mask-scale",
        "1.5",
        method="bubbles",
        size=("--seed", "3"),
    )
    generate("texture-target.nrrd", *sample, "--target", "porosity=0.8", method="texture")
    generate(
        "quilt-target-field.nrrd", *sample, "--target", "volume_fraction=field.npy", method="quilt"
    )
    generate(
        "texture-fixed-at.nrrd",
        *sample,
        "--fixed",
        "scan.npy",
        "--at",
        "0",
        "0",
        "0",
        method="texture",
        size=("--shape", "16", "24", "24", "--seed", "3"),
    )
    generate(
        "quilt-fixed-known.nrrd",
        *sample,
        "--fixed",
        "fixed.nrrd",
        "--known",
        "known.nrrd",
        method="quilt",
    )
    generate(
        "kopf-fixed-slice.nrrd",
        "slice.png",
        "--fixed",
        "slice.png",
        "--at",
        "8",
        "0",
        "0",
        "--view",
        "yx",
        method="kopf",
        size=("--shape", "16", "24", "24", "--seed", "3"),
    )

    generate("noise-from-model.nrrd", "--model", "noise.model")
    generate("texture-from-model.nrrd", "--model", "texture.model")
    blocks = ("--shape", "18", "20", "34", "--seed", "3", "--chunks", "16")
    generate("noise-streamed.zarr", *sample, method="noise", size=blocks)
    generate("texture-streamed.zarr", *sample, method="texture", size=blocks)


def write_others() -> None:
    """Write results of the other steps of a recipe."""
    sample = tb.sample("bone")
    write("crop.nrrd", lambda out: tb.write(tb.crop(sample, 16, corner=(1, 2, 3)), out))
    write("slice-step.nrrd", lambda out: tb.write(sample[10:50:3, ::6, 20:40], out))
    read = tb.read("grey.nrrd", spacing=3.0, unit="um")
    write("segment.nrrd", lambda out: tb.write(tb.segment(read, "dual"), out))
    write(
        "segment-pair.nrrd",
        lambda out: tb.write(tb.segment(read, (40, 120), phases=("pore", "grain")), out),
    )
    form = tb.voxelise(tb.read_mesh("form.stl", unit="mm"), spacing=0.05)
    write("voxelised.nrrd", lambda out: tb.write(form, out))
    rough = tb.crop(sample, 24)
    steps = {
        "connect": tb.finish.connect(rough, reach=6),
        "prune": tb.finish.prune(rough, exemplar=tb.crop(sample, 32)),
        "smooth": tb.finish.smooth(rough, sigma=40.0),
        "thicken": tb.finish.thicken(rough, thickness=120.0),
        "remove_floaters": tb.finish.remove_floaters(rough),
        "fill_trapped": tb.finish.fill_trapped(rough),
    }
    for name, image in steps.items():
        write(f"finish-{name}.nrrd", lambda out, image=image: tb.write(image, out))
    command_steps = ("--prune", "--connect", "--thicken", "100", "--fill")
    write(
        "finish-command.nrrd",
        lambda out: command("finish", "texture-mask.nrrd", *command_steps, "--out", out),
    )
    fields = {
        "ramp": tb.fields.ramp((9, 8, 7), start=0.1, end=0.4),
        "radial": tb.fields.radial((9, 8, 7), inside=0.4, outside=0.1),
        "formula": tb.fields.formula((9, 8, 7), "0.3 + 0.2 * x / X"),
        "interpolate": tb.fields.interpolate((9, 8, 7), [(0, 0, 0), (8, 7, 6)], [0.1, 0.4]),
        "simp": tb.fields.simp("cantilever", (8, 4, 15), rounds=10),
        "picture": tb.fields.picture(tb.read("grey.png"), (5, 12, 14), low=0.1, high=0.5),
        "measure": tb.fields.measure(rough, "volume_fraction", size=7),
        "resample": tb.fields.resample(tb.fields.ramp(6, start=0.1, end=0.4), (11, 9, 7)),
        "rescale": tb.fields.rescale(tb.fields.ramp(6, start=0.1, end=0.4), low=0.2, high=0.3),
    }
    for name, image in fields.items():
        write(f"field-{name}.nrrd", lambda out, image=image: tb.write(image, out))
    Path("array").mkdir(exist_ok=True)
    plain = tb.Image(bone(20).values, "labels")
    write("array/exemplar.npy", lambda out: np.save(out, plain.values))
    learned = tb.method("texture", **QUICK["texture"])
    write("array/texture.nrrd", lambda out: tb.write(learned.fit(plain).generate(16, seed=3), out))
    write("render.png", lambda out: tb.render(tb.read("texture.nrrd"), out, size=(64, 48)))


if __name__ == "__main__":
    FILES.mkdir(exist_ok=True)
    with chdir(FILES):
        write_inputs()
        write_models()
        write_generated()
        write_others()
