"""`networks`: seconds of pores, throats and bodies, and networks beside direct solves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import trabecula as tb
from common import busy, table
from descriptors import scans
from drainage import sized
from trabecula.measure import bodies, network

SIDES = (128, 200, 256)


def networks() -> None:
    """Processor seconds by size (Berea, beyond its 200^3 mirrored), then figures of its network.

    Permeability and diffusivity along z, y and x of the first and the last corner of 100^3, by the
    network over the direct solve: the median and the range of six.
    """
    scan = scans()["Berea"]
    network(tb.crop(scan, 32)).permeability(0)  # compiles
    bodies(tb.crop(scan, 32))
    row = table("job, CPU s", *(f"{side}^3" for side in SIDES))
    volumes = {side: sized(scan, side) for side in SIDES}
    found = {side: busy(lambda side=side: network(volumes[side])) for side in SIDES}
    row("network", *(f"{found[side][0]:.1f}" for side in SIDES))
    solves = (busy(lambda side=side: found[side][1].permeability(0))[0] for side in SIDES)
    row("its permeability", *(f"{one:.2f}" for one in solves))
    row(
        "bodies of the solid",
        *(f"{busy(lambda side=side: bodies(volumes[side]))[0]:.1f}" for side in SIDES),
    )
    print()
    nets = [found[side][1] for side in SIDES]
    row = table("Berea", *(f"{side}^3" for side in SIDES))
    row("pores", *(len(net) for net in nets))
    row("throats", *(len(net.throats) for net in nets))
    for name in ("coordination", "pore_radius", "throat_radius", "throat_shape_factor"):
        row(name, *(f"{net.summary()[name]:.3g}" for net in nets))
    print()
    row = table("network / direct", "median", "least", "largest", "solves")
    for name, scan in scans().items():
        if name in ("Berea", "NMC", "bone a"):
            _against_direct(name, scan, row)


def _against_direct(name: str, scan: tb.Image, row: Callable[..., None]) -> None:
    ratios: dict[str, list[float]] = {"permeability": [], "diffusivity": []}
    for end in (0, 1):
        at = [end * max(0, side - 100) for side in scan.shape]
        part = tb.crop(scan, tuple(min(100, side) for side in scan.shape), corner=tuple(at))
        net = network(part)
        for axis in range(3):
            for what, own in ratios.items():
                direct = getattr(tb.measure, what)(part, axis=axis).value
                if direct > 0:
                    own.append(getattr(net, what)(axis).value / direct)
    for what, own in ratios.items():
        cells = (np.median(own), min(own), max(own))
        row(f"{name}, {what}", *(f"{one:.2f}" for one in cells), len(own))
