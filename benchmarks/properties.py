"""`properties`: material made to have a permeability, a stiffness, a surface or a size."""

from __future__ import annotations

from typing import Any

import numpy as np

import trabecula as tb
from common import asked, busy, table
from descriptors import scans
from graded import LIKE, show
from graded_lattice import gentle
from trabecula import fields
from trabecula.core.errors import RequestError
from trabecula.fields.property_law import fit_law
from trabecula.measure.properties import measure_property
from trabecula.pipeline.property_target import match_property

SIDE = 96
MATERIALS = ("bone a", "Berea", "NMC", "sample foam")
TARGETS = {
    "diffusivity": 1.15,
    "permeability": 0.6,
    "stiffness": 0.7,
    "specific_surface": 1.1,
    "pore_size": 1.1,
}
"""What is asked for, over the scan's own."""


def properties() -> None:
    """Twenty targets, 96^3 by the default of `texture`, seed 0: five properties of four materials,
    each off the scan's own value: results made, and moves of the surface of the nearest. Seconds
    are of the processor, trials and solvers included.
    """
    known = {"sample foam": tb.sample("foam"), **scans()}
    row = table("target", "scan's own", "asked", "found", "off", "results", "moves", "s", wide=32)
    within = done = 0
    for name in MATERIALS:
        scan = known.get(name)
        if scan is None:
            continue
        centre = tb.crop(scan, min(128, *scan.shape))
        model = tb.method("texture").fit(centre)
        for what, factor in TARGETS.items():
            own = measure_property(centre, what)
            words = f"{name}, {what}"
            done += 1
            try:
                seconds, found = busy(
                    lambda w=what, a=factor * own, m=model: match_property(m, SIDE, {w: a})
                )
            except RequestError as error:
                row(words, f"{own:.4g}", f"{factor * own:.4g}", "refused", "", "", "", "")
                print(f"  {error}")
                continue
            within += abs(found.error) <= 0.05
            row(
                words,
                f"{own:.4g}",
                f"{found.asked:.4g}",
                f"{found.value:.4g}",
                f"{found.error:+.1%}",
                len(found.made),
                len(found.moved),
                f"{seconds:.0f}",
            )
    print(f"\nwithin 5 %: {within} of {done}")


LAWS = (
    ("sample bone", "conductivity"),
    ("sample bone", "stiffness"),
    ("bone a", "stiffness"),
    ("Berea", "permeability"),
)
SHAPE = (128, 64, 64)


def property_fields() -> None:
    """Fields of a property (section 3.2 of the 2016 paper): the law of the scan's windows, 120^3,
    a third of a side each, and a ramp of the property along z between their tenths, 128 x 64 x 64,
    seed 1, by `asked("METHODS")` (texture and quilt): mean over windows of what the result has,
    over what was asked for, and at both ends; by the scan's law, and by that of what the method
    makes (*own*).
    """
    known = {"sample bone": tb.sample("bone"), **scans()}
    row = table("scan, property", "c", "n", "scatter", "method", "ratio", "first", "last", "s")
    for name, what in LAWS:
        if name not in known:
            continue
        exemplar = tb.crop(known[name], min(120, *known[name].shape))
        law = fields.property_law(exemplar, what)
        limits = np.quantile(law.fractions, [0.1, 0.9])
        low, high = (float(law.coefficient * one**law.exponent) for one in limits)
        wanted = fields.ramp(SHAPE, start=low, end=high)
        for method in asked("METHODS") or ["texture", "quilt"]:
            model = tb.method(method).fit(exemplar)
            own = fields.property_law(exemplar, what, model=model)
            for words, taken in ((method, law), (f"{method}, own", own)):
                target = {"volume_fraction": taken.fraction(wanted)}
                request = tb.Request(SHAPE, seed=1, target=target)
                seconds, made = busy(lambda m=model, r=request: m.generate(r))
                ratios = _ratios(made, wanted, what, side=min(exemplar.shape) // 3)
                row(
                    f"{name}, {what}",
                    f"{taken.coefficient:.3g}",
                    f"{taken.exponent:.2f}",
                    f"{taken.scatter:.2f}",
                    words,
                    *(f"{one:.2f}" for one in (ratios.mean(), ratios[0], ratios[-1])),
                    f"{seconds:.0f}",
                )


PATCH = 16
WINDOWS = (
    ("sample bone", "apparent_stiffness:z"),
    ("bone b", "apparent_stiffness:z"),
    ("bone a", "apparent_conductivity"),
    ("Berea", "apparent_diffusivity"),
    ("lattice", "apparent_stiffness"),
)


def window_properties() -> None:
    """Homogenised properties as descriptors of windows (section 3.2 of the 2016 paper): a ramp of
    one along z between the first and last tenth of a centre's windows (96^3, patches of 16, of the
    lattice of table 2 80^3 and cells), 96 x 64 x 64 by `quilt`, seed 1: by the property itself, by
    it at one volume fraction, and by the fraction alone, which the law of the same windows gives.
    Compared are the windows amid patches: the mean of the first layer of them and of the last,
    correlation of layers with what was asked, and the mean difference of windows over the range of
    all in the scan.
    """
    known = {"sample bone": tb.sample("bone"), "lattice": gentle(), **scans()}
    row = table(
        "scan, property", "asked", "found", "follows", "off", "fractions", "parts", "s", wide=40
    )
    words = asked("ONLY")
    for name, what in WINDOWS:
        if name not in known or (words and name not in words):
            continue
        exemplar = tb.crop(known[name], min(96, *known[name].shape))
        settings = LIKE | {"connected": "solid"} if name == "lattice" else {"patch": PATCH}
        model = tb.method("quilt", **settings).fit(exemplar)
        library = model.library
        fraction = library.describe_patches(0, "volume_fraction").astype(float)
        seconds, values = busy(lambda lib=library, w=what: lib.describe_patches(0, w).astype(float))
        row(f"{name}, its windows", "", "", "", "", "", "", f"{seconds:.0f}")
        low, high = np.quantile(values, [0.1, 0.9])
        ramp = fields.ramp((96, 64, 64), start=float(low), end=float(high)).values
        void = what.startswith("apparent_diffusivity")
        share = np.ravel(1 - fraction if void else fraction)
        order = np.argsort(share)[::97]
        law = fit_law(what.removeprefix("apparent_"), share[order], values.ravel()[order])
        carrying = ((ramp / law.coefficient) ** (1 / law.exponent)).clip(0, 1)
        ways = {
            "": {what: ramp},
            ", one fraction": {what: ramp, "volume_fraction": float(fraction.mean())},
            ", by the fraction": {"volume_fraction": 1 - carrying if void else carrying},
        }
        for way, target in ways.items():
            request = tb.Request((96, 64, 64), seed=1, target=target)
            seconds, made = busy(lambda m=model, r=request: m.generate(r))
            row(
                f"{name}, {what}{way}",
                *_follows(made, library, what, ramp, values),
                f"{seconds:.0f}",
            )
            show(made, f"windows-{name}-{what}{way}".replace(", ", "-").replace(" ", "-"))


def _follows(
    made: tb.Image, library: Any, what: str, ramp: np.ndarray, values: np.ndarray
) -> list[object]:
    """Return how a result's windows amid its patches follow a ramp: cells of a row."""
    size, step = library.descriptor_size, library.patch - library.overlap
    off = (library.patch - size) // 2
    found = fields.windowed(made, size=size, names=[what, "volume_fraction"])
    got, fraction = (one[off::step, off::step, off::step] for one in found.values())
    wanted = ramp[library.descriptor_centre :: step, 0, 0][: len(got)]
    layers, shares = got.mean(axis=(1, 2)), fraction.mean(axis=(1, 2))
    return [
        f"{wanted[0]:.3f} .. {wanted[-1]:.3f}",
        f"{layers[0]:.3f} .. {layers[-1]:.3f}",
        f"{np.corrcoef(layers, wanted)[0, 1]:.2f}",
        f"{np.abs(got - wanted[:, None, None]).mean() / np.ptp(values):.3f}",
        f"{shares[0]:.2f} .. {shares[-1]:.2f}",
        tb.measure.components(made),
    ]


def _ratios(made: tb.Image, wanted: tb.Image, what: str, *, side: int) -> np.ndarray:
    """Return the property of windows over what was asked for there, a mean for every layer."""
    found = []
    for z in range(0, made.shape[0] - side + 1, side // 2):
        values = [
            measure_property(tb.crop(made, side, corner=(z, y, x)), what)
            for y in (0, made.shape[1] - side)
            for x in (0, made.shape[2] - side)
        ]
        found.append(np.mean(values) / wanted.values[z : z + side].mean())
    return np.array(found)
