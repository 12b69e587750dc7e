"""`gan`: the models that come with the package, seconds, and the paper's recipe as far as a
processor gets.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np

import ensembles
import trabecula as tb
from by_example import figures
from common import SCANS, asked, busy, pictures, table, tell
from descriptors import GREY, LABELS, scans
from image_truth import curves, figures_heads, relative
from image_truth import figures as volume_figures
from sections import section
from trabecula.exemplar.views import PLANES, take_slices
from trabecula.models import shipped_models
from trabecula.view.slices import montage

SAMPLES = 10
SIDE = 120
BOX = 64
"""Permeability is solved in a centre box of so many voxels a side, of a few samples."""

LEARNT_FROM = {
    "bone": "bone a",
    "bone_wide": "bone a",
    "berea": "Berea",
    "nmc": "NMC",
    "cement": "cement",
    "electrode": "electrode, 3 phases",
}
PICTURED = ("soil, Otsu", "NMC", "Berea", "cement, Otsu", "bone a", "polymer fibres, Otsu")
PICTURED_SIDE = 96
NARROW = {"width": 4, "batch": 4, "latent": 16}
"""Of the paper's networks, for a processor; the paper's: 64, 100, 100."""


def exemplar(name: str) -> tb.Image | None:
    """Return the scan of a shipped model without its blank margins, where it is here."""
    scan = LEARNT_FROM.get(name, "")
    file, edge, unit = {**LABELS, **GREY}.get(scan, ("", 1.0, "voxel"))
    return (
        tb.crop_margins(tb.read(SCANS / file, spacing=edge, unit=unit))
        if file and SCANS.is_dir()
        else None
    )


def _chosen() -> Iterator[tuple[str, tb.Image, Any]]:
    """Yield name, scan and model of the shipped models, or of TRABECULA_BENCH_MODELS, whose scans
    are here.
    """
    for name in os.environ.get("TRABECULA_BENCH_MODELS", "").split() or shipped_models():
        if (scan := exemplar(name)) is not None:
            yield name, scan, tb.load_model(name)


def models() -> None:
    """Shipped models (or TRABECULA_BENCH_MODELS), 10 samples of 120^3 each: figures and band,
    diversity, permeability.
    """
    for name, scan, model in _chosen():
        model.generate(SIDE, seed=0)
        seconds, samples = busy(
            lambda m=model: [m.generate(SIDE, seed=seed) for seed in range(SAMPLES)]
        )
        tell(f"\n{name}", f"{SAMPLES} samples of {SIDE}^3", f"{seconds / SAMPLES:.2f} s each")
        _certified(name, scan, samples)
        if scan.kind == "labels":
            _diverse(name, samples)
            corners = product(*((0, side - SIDE) for side in scan.shape))
            apart = {
                "the scan's corners": [tb.crop(scan, SIDE, corner=corner) for corner in corners],
                "the samples": samples,
                "samples at the scan's porosity": _at_its_porosity(model, scan),
            }
            for words, volumes in apart.items():
                found = [figures(scan, volume).distance for volume in volumes]
                tell(f"D2 of {words}", *(f"{f(found):.1f}" for f in (np.mean, min, max) if found))
            row = table(f"permeability of {name}", *"zyx")
            for what, image in (
                ("exemplar", scan),
                *((f"seed {i}", sample) for i, sample in enumerate(samples[:3])),
            ):
                physics = tb.measure.describe_physics(image, box=BOX)
                row(what, *(f"{physics['permeability'][axis]:.4g}" for axis in "zyx"))
        _drawn(name, scan, samples)


def shipped() -> None:
    """Table 1 of 2021 for the shipped models of bone and of Berea: 10 samples of 120^3 against the
    whole scan, the quick certificate; as many that are asked for the scan's porosity; how far four
    samples are from one another.
    """
    for name in ("bone", "berea"):
        scan = exemplar(name)
        if scan is None:
            continue
        model = tb.load_model(name)
        samples = [model.generate(SIDE, seed=seed) for seed in range(SAMPLES)]
        _certified(name, scan, samples, level="quick")
        _certified(f"{name} asked for", scan, _at_its_porosity(model, scan), level="quick")
        _diverse(name, samples)
        _drawn(name, scan, samples)


def _at_its_porosity(model: Any, scan: tb.Image) -> list[tb.Image]:
    """Samples that are asked for the scan's porosity, none of a model that takes none."""
    if model.porosities() is None:
        return []
    target = {"porosity": tb.measure.porosity(scan)}
    return [model.generate(SIDE, seed=seed, target=target) for seed in range(SAMPLES)]


def _diverse(name: str, samples: Sequence[tb.Image]) -> None:
    found, apart = tb.measure.diversity(samples[:4]), ~np.eye(4, dtype=bool)
    row = table(f"diversity of {name}", "least distance", "most copied")
    row(
        "four samples",
        f"{found.distance[apart].min():.3f}",
        f"{found.coherence[apart].max():.3f}",
    )


def populations() -> None:
    """Shipped models of labels as ensembles: 24 samples of 64^3 against the parts of their scans:
    ratio of standard deviations, shift of the mean in real standard deviations, and the verdict.
    """
    for name, scan, model in _chosen():
        if scan.kind != "labels":
            continue
        members = [model.generate(ensembles.SIDE, seed=seed) for seed in range(ensembles.COUNT)]
        ensembles.show(name, tb.verify_ensemble(scan, members))


def from_pictures() -> None:
    """Generators that learnt from the middle slice of a scan (TRABECULA_BENCH_ONLY), 3,000
    iterations (TRABECULA_BENCH_ITERATIONS): three samples of 96^3 beside the scan's middle and its
    last, and two that are asked for its porosity; figures as of `image_truth`, surface per voxel.
    Before them the spread of fractions around cells that the picture implies, and the scan's.
    TRABECULA_BENCH_GAP=3 adds a second section so many voxels from the first, or more of them
    (TRABECULA_BENCH_SECTIONS=6), TRABECULA_BENCH_PICTURES=3 (without a gap) takes the middle slices
    across all axes. TRABECULA_BENCH_PLACE=.25 takes slices a quarter up the scan instead of the
    middle ones, TRABECULA_BENCH_SEED=1 another seed of the training. Pictures and models are kept
    with --out.
    """
    iterations, every = int((asked("ITERATIONS") or ["3000"])[0]), scans()
    gap, folder = int((asked("GAP") or ["0"])[0]), pictures()
    place, seed = float((asked("PLACE") or [".5"])[0]), int((asked("SEED") or ["0"])[0])
    names = [name for name in asked("ONLY") or PICTURED if name in every]
    for name in names or list(every)[:1]:
        scan = every[name]
        plain = tb.Image(scan.values, "labels", phases=scan.phases)
        sides = [min(PICTURED_SIDE, have) for have in plain.shape]
        if asked("PICTURES") == ["3"] and not gap:
            learnt = [take_slices(plain, plane, 1)[0] for plane in PLANES]
        else:
            count = int((asked("SECTIONS") or ["2"])[0]) if gap else 1
            first = int(place * plain.shape[0])
            learnt = [section(plain, first + gap * n) for n in range(count)]
        settings = {"iterations": iterations, "minutes": 0, "gap": gap, "seed": seed}
        model = tb.method("gan", **settings).fit(learnt)
        if gap:
            by_sections = tb.measure.disector_euler_density(learnt, gap=gap)
            print(f"{name}: Euler number by the sections {1e6 * by_sections:.0f}")
        far = [have - side for have, side in zip(plain.shape, sides, strict=True)]
        found = {"middle": tb.crop(plain, sides), "last": tb.crop(plain, sides, corner=far)}
        found |= {f"seed {one}": model.generate(PICTURED_SIDE, seed=one) for one in (1, 2, 3)}
        porosity, takes = tb.measure.porosity(plain), model.porosities()
        if takes is not None and takes[0] < porosity < takes[1]:
            for one in (1, 2):
                target = {"porosity": porosity}
                made = model.generate(PICTURED_SIDE, seed=one, target=target)
                found[f"asked {porosity:.3f}, seed {one}"] = made
        # The default install has no PyTorch.
        from trabecula.synth.gan.crops import exemplar_fields

        in_space = exemplar_fields(plain, model.config).local
        if model.local is not None and in_space is not None:
            spreads = [float(local.deviation[0]) for local in (model.local, in_space)]
            print("{}: spread around cells {:.3f}, of the scan {:.3f}".format(name, *spreads))
        truth = curves(plain)["radial"]
        row = table("scan, volume", "S2 radial", "surface", *figures_heads(), wide=34)
        for words, volume in found.items():
            error = relative(curves(volume)["radial"], truth)
            told = [error, tb.measure.specific_surface(volume), *volume_figures(volume).values()]
            row(f"{name}: {words}", *(f"{value:.4g}" for value in told))
        if folder is not None:
            word = "".join(letter for letter in name if letter.isalnum()) + f"-{len(learnt)}"
            model.save(folder / f"{word}.model")
            montage([found["middle"], found["seed 1"]], ["scan", "seed 1"], folder / f"{word}.png")


def speed() -> None:
    """Return the processor seconds of a shipped model for 120^3, 200^3 and 420^3, one thread."""
    row = table("model, side", "s", "ns a voxel")
    for name in shipped_models():
        model = tb.load_model(name)
        model.generate(64, seed=0)
        for side in (SIDE, 200, 420):
            seconds, made = busy(lambda m=model, n=side: m.generate(n, seed=1))
            row(f"{name}, {side}^3", f"{seconds:.2f}", f"{1e9 * seconds / made.values.size:.0f}")


def smoke() -> None:
    """200 iterations of the paper's whole loss on networks of width 4: nothing is infinite; seconds
    each, figures.
    """
    scan = exemplar("bone") or tb.sample("bone")
    settings = {**NARROW, "iterations": 200, "looks": 1, "device": "cpu"}
    for reading in ("deconvolution", "deconvolution+conv"):
        method = tb.method("gan", preset="paper", generator=reading, **settings)
        seconds, model = busy(lambda m=method: m.fit(tb.crop(scan, 100)))
        tell(reading, f"{seconds / 200:.2f} s an iteration", model.history["figures"])


def _certified(
    name: str, scan: tb.Image, samples: Sequence[tb.Image], *, level: str = "default"
) -> None:
    certificates = tb.verify(scan, *samples, level=level)
    row = table(f"figure of {name}", "exemplar", "band", "mean", "least", "most", "passed", wide=22)
    for key, metric in certificates[0].metrics.items():
        values = [one.metrics[key].value for one in certificates]
        if not all(isinstance(value, (int, float, np.number)) for value in values):
            continue
        band = (
            ""
            if metric.real_band is None
            else f"{metric.real_band[0]:.4g} .. {metric.real_band[1]:.4g}"
        )
        passed = sum(bool(one.metrics[key].passed) for one in certificates)
        there = "" if metric.exemplar is None else f"{float(metric.exemplar):.4g}"
        row(
            key,
            there,
            band,
            *(f"{value:.4g}" for value in (np.mean(values), min(values), max(values))),
            passed,
        )


def _drawn(name: str, scan: tb.Image, samples: Sequence[tb.Image]) -> None:
    """The exemplar's middle slices below those of three samples."""
    folder = pictures()
    if folder is None:
        return
    titles = ["exemplar", *(f"seed {seed}" for seed in range(3))]
    montage([tb.crop(scan, SIDE), *samples[:3]], titles, folder / f"gan-{name}.png")
