"""The tables: `make bench`, or `python benchmarks/run.py [CASE ...]`.

Cases are frozen: exemplar, crop, shape and seeds stay as they are, so that figures can be compared over time. Seconds are
of one thread with kernels compiled, and stand beside the time of a fixed NumPy job in the same run (`unit`), so that
machines can be compared too. Quality comes from `trabecula.measure` and `verify` alone.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable

import trabecula as tb
from common import SCANS, tell, timed, unit
from descriptors import certificate, descriptors, large
from trabecula.measure.distance import distance_transform


def exemplars() -> dict[str, tb.Image]:
    """Name -> exemplar of 60^3 (100^3 where structures are wide); scans where they are, else the samples."""
    found = {"sample bone": tb.crop(tb.sample("bone"), 60), "sample foam": tb.crop(tb.sample("foam"), 60)}
    if SCANS.is_dir():
        found["bone a"] = tb.crop(tb.read(SCANS / "trabecular_bone_a.tif"), 60)
        found["bone b"] = tb.crop(tb.read(SCANS / "trabecular_bone_b.tif"), 100)
        found["Berea"] = tb.crop(tb.read(SCANS / "berea_sandstone_a.tif"), 100)
        found["NMC"] = tb.crop(tb.read(SCANS / "nmc_electrode_a.tif"), 100)
        names = ("void", "active", "binder")
        found["electrode, 3 phases"] = tb.crop(tb.read(SCANS / "electrode_3phase_a.tif", phases=names), 100)
        grey = tb.segment(tb.read(SCANS / "trabecular_bone_grey_lhdl.tif"))
        found["grey bone, Otsu"] = tb.crop(grey, 100)
    return found


def texture() -> None:
    """120^3 from every exemplar, three seeds: seconds, and fidelity beside the real band."""
    tell(
        "exemplar",
        "seed",
        "fit s",
        "make s",
        "/ unit",
        "S2 rel",
        "band",
        "S2 raw",
        "coherence(4)",
        "largest",
        "parts",
        "expected",
        "after connect",
    )
    base = unit()
    for name, exemplar in exemplars().items():
        tb.method("texture").fit(exemplar).generate(16)
        for seed in (0, 1, 2):
            fit, model = timed(lambda e=exemplar: tb.method("texture").fit(e))
            make, material = timed(lambda m=model, s=seed: m.generate(120, seed=s))
            metrics = tb.verify(exemplar, material, level="quick").metrics
            copied = tb.measure.coherence(exemplar, material, k=(4,), samples=500)[4]
            band = metrics["two_point_relative"].real_band
            tell(
                name,
                seed,
                f"{fit:.2f}",
                f"{make:.2f}",
                f"{(fit + make) / base:.0f}",
                f"{metrics['two_point_relative'].value:.4f}",
                f"{band[1]:.3f}" if band else "-",
                f"{metrics['two_point_distance'].value:.4f}",
                f"{copied:.2f}",
                f"{metrics['largest_fraction'].value:.4f}",
                metrics["components"].value,
                f"{metrics['components'].exemplar:.0f}",
                tb.measure.components(tb.finish.connect(material)),
            )


def sizes() -> None:
    """Cost against size: seconds and nanoseconds a voxel, and the process's peak memory beside the forecast."""
    tell("shape", "make s", "ns/voxel", "forecast MiB", "peak MiB")
    exemplar = next(iter(exemplars().values()))
    model = tb.method("texture").fit(exemplar)
    model.generate(16)
    for side in (60, 120, 180, 240):
        request = tb.Request(side, seed=0)
        seconds, _ = timed(lambda r=request: model.generate(r))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        tell(
            f"{side}^3",
            f"{seconds:.2f}",
            f"{seconds / side**3 * 1e9:.0f}",
            f"{model.plan(request).peak / 2**20:.0f}",
            f"{peak:.0f}",
        )


def measures() -> None:
    """Seconds of every descriptor of a volume of 160^3, beside the fixed job."""
    volume = tb.method("texture").fit(tb.crop(tb.sample("bone"), 60)).generate(160, seed=0)
    base = unit()
    jobs: dict[str, Callable[[], object]] = {
        "two_point, r = 50": lambda: tb.measure.two_point(volume, r_max=50),
        "lineal_path, r = 50": lambda: tb.measure.lineal_path(volume, r_max=50),
        "components": lambda: tb.measure.components(volume),
        "minkowski": lambda: tb.measure.minkowski(volume),
        "distance_transform": lambda: distance_transform(volume.values > 0),
        "thickness": lambda: tb.measure.thickness(volume),
        "pore_size": lambda: tb.measure.pore_size(volume),
        "describe": lambda: tb.describe(volume),
        "connect": lambda: tb.finish.connect(volume),
        "mesh": lambda: tb.mesh(volume),
        "render 800 x 600": lambda: tb.render(volume),
    }
    tell("job at 160^3", "s", "/ unit")
    for name, job in jobs.items():
        job()
        seconds = min(timed(job)[0] for _ in range(3))
        tell(name, f"{seconds:.3f}", f"{seconds / base:.1f}")


CASES = {
    "texture": texture,
    "sizes": sizes,
    "measures": measures,
    "large": large,
    "descriptors": descriptors,
    "certificate": certificate,
}


def main(names: list[str]) -> int:
    unknown = [name for name in names if name not in CASES]
    if unknown:
        print(f"unknown case {unknown[0]!r}: known are {', '.join(CASES)}", file=sys.stderr)
        return 2
    with tb.threads(1):
        for name in names or list(CASES):
            print(f"\n## {name}: {CASES[name].__doc__}")
            CASES[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
