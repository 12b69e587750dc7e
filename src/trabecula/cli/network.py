"""`trabecula network FILE [--phase NAME] [--direct] [--out FILE] [--json]`."""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.csv_tables import add_csv, check_csv, write_figures
from trabecula.cli.cutting import add_cutting, cutting_of, write_if_named


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file and the options."""
    parser.add_argument("file", metavar="FILE", help="volume, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    add_csv(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        help=".npz, .csv or .json for OpenPNM and PoreSpy, .vtp for ParaView, .dat for Statoil's "
        "four files",
    )
    parser.add_argument(
        "--direct",
        action="store_true",
        help="solve permeability and diffusivity of the voxels as well (minutes from 200 voxels a "
        "side on)",
    )
    add_cutting(parser, default="void")
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print the figures; write the network where a file is named."""
    from trabecula.measure import network

    check_csv(options.csv)
    image = shared.load_exemplar(options.file, options)
    net = network(image, phase=options.phase, **cutting_of(options))
    found = {"shape": list(image.shape), "spacing": list(image.spacing), "unit": image.unit}
    found |= net.summary()
    for name, solve in (("permeability", net.permeability), ("diffusivity", net.diffusivity)):
        found[name] = {axis: _plain(solve(k)) for k, axis in enumerate("zyx")}
    if options.direct:
        from trabecula.measure import diffusivity, permeability

        for name, direct in (("permeability", permeability), ("diffusivity", diffusivity)):
            found[f"direct_{name}"] = {
                axis: _plain(direct(image, axis=k, phase=options.phase))
                for k, axis in enumerate("zyx")
            }
    found["out"] = write_if_named(net, options)
    write_figures(options.csv, found)
    if options.json:
        terminal.show_json(found)
    else:
        terminal.show_mapping(found)
    return 0


def _plain(effective: Any) -> float | str | None:
    """Return a coefficient, or a word where there is none to rely on."""
    if effective.value == 0.0:
        return "does not percolate"
    return float(effective.value) if effective.converged else "not converged"
