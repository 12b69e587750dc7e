"""Small cases of everything that the package does, whose results must not change.

A case is a function without arguments. What it returns is hashed: an Image by its kind, spacing,
unit, phases, type, shape and values, other results by what they hold (`digest`). A case's name
begins with its method or its room, so that `pytest -k texture` picks those of `texture`.

The modules below that are not public are the only ones that the cases name.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager, redirect_stdout
from dataclasses import asdict, is_dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import trabecula as tb
from trabecula.__main__ import main
from trabecula.core.progress import listen
from trabecula.engine import checkpoint, memmap
from trabecula.pipeline.generate import generate_to

FILES = Path(__file__).parent / "files"
SHAPE = (16, 18, 20)
DIGITS = 9

Case = Callable[[], Any]
CASES: dict[str, Case] = {}


def case(name: str) -> Callable[[Case], Case]:
    """Register a case by its name."""

    def register(function: Case) -> Case:
        if name in CASES:
            raise ValueError(f"two cases have the name {name}")
        CASES[name] = function
        return function

    return register


# Hashes


def digest(result: Any) -> str:
    """Return the SHA-256 of a result, as hexadecimal digits."""
    hashed = hashlib.sha256()
    for part in _parts(result):
        hashed.update(part)
    return hashed.hexdigest()


def _parts(result: Any) -> Iterator[bytes]:
    """Yield the bytes that stand for a result."""
    if isinstance(result, tb.Image):
        spacing = [_rounded(float(edge)) for edge in result.spacing]
        yield json.dumps([result.kind, spacing, result.unit, list(result.phases)]).encode()
        yield from _parts(result.values)
    elif isinstance(result, np.ndarray):
        little = np.ascontiguousarray(result, result.dtype.newbyteorder("<"))
        yield f"{result.dtype.kind}{result.dtype.itemsize}{result.shape}".encode()
        yield little.tobytes()
    elif isinstance(result, bytes):
        yield result
    elif isinstance(result, (tuple, list)):
        for part in result:
            yield from _parts(part)
    else:
        yield json.dumps(_rounded(result), sort_keys=True).encode()


def _rounded(result: Any) -> Any:
    """Return plain JSON, with numbers of `DIGITS` significant digits."""
    if is_dataclass(result) and not isinstance(result, type):
        return _rounded(asdict(result))
    if isinstance(result, Mapping):
        return {str(key): _rounded(value) for key, value in result.items()}
    if isinstance(result, (tuple, list, np.ndarray)):
        return [_rounded(value) for value in result]
    if isinstance(result, (bool, np.bool_)):
        return bool(result)
    if isinstance(result, (int, np.integer)):
        return int(result)
    if isinstance(result, (float, np.floating)):
        number = float(f"{float(result):.{DIGITS}g}")
        return 0.0 if number == 0 else number if math.isfinite(number) else repr(number)
    if isinstance(result, str) or result is None:
        return result
    raise TypeError(f"there is no digest of a {type(result).__name__}")


# Exemplars


@cache
def bone(size: int = 24) -> tb.Image:
    """Return a cube of the bone sample, labels."""
    return tb.crop(tb.sample("bone"), size)


@cache
def foam(size: int = 24) -> tb.Image:
    """Return a cube of the foam sample, labels."""
    return tb.crop(tb.sample("foam"), size)


@cache
def three_phase(size: int = 24) -> tb.Image:
    """Return a cube of three phases: bone, and foam in its void."""
    values = np.where(bone(size).values, 1, 2 * foam(size).values).astype(np.uint8)
    return tb.Image(values, "labels", (2.0,) * 3, "um", ("void", "active", "binder"))


@cache
def grey(size: int = 24) -> tb.Image:
    """Return a cube of grey values: bone summed over boxes of 5 voxels a side, foam, a slope."""
    total = 20 * foam(size).values.astype(np.uint8) + 2 * np.arange(size, dtype=np.uint8)
    padded = np.pad(bone(size).values, 2, mode="edge")
    for z, y, x in np.ndindex(5, 5, 5):
        total += padded[z : z + size, y : y + size, x : x + size]
    return tb.Image(total, "grey", (2.0,) * 3, "um")


@cache
def colour(size: int = 24) -> tb.Image:
    """Return a cube of colours: grey values along three directions."""
    values = grey(size).values
    channels = [values, values.transpose(2, 0, 1), values[::-1]]
    return tb.Image(np.stack(channels, axis=-1).copy(), "colour", (2.0,) * 3, "um")


def picture(volume: tb.Image, axis: int = 0) -> tb.Image:
    """Return the slice in the middle of a volume."""
    index: list[Any] = [slice(None)] * 3
    index[axis] = volume.shape[axis] // 2
    return volume[tuple(index)]


# Parts of a request


def ball(shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """Return the mask of a ball in the middle of a shape."""
    squares = [(2 * np.arange(side) + 1 - side) ** 2 for side in shape]
    total = np.add.outer(np.add.outer(*squares[:2]), squares[2]) if len(shape) == 3 else None
    return (np.add.outer(*squares) if total is None else total) < (min(shape) - 1) ** 2


def ramp(low: float, high: float, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """Return a field that rises along z."""
    along = (low + (high - low) * np.arange(shape[0]) / shape[0]).astype(np.float32)
    return np.broadcast_to(along[:, None, None], shape).copy()


def fixed(exemplar: tb.Image, shape: tuple[int, ...] = SHAPE) -> dict[str, Any]:
    """Return measured voxels in the first third along z, a chequered pattern."""
    pattern = np.add.outer(np.add.outer(*map(np.arange, shape[:2])) // 4, np.arange(shape[2]) // 4)
    values = (pattern % 2).astype(exemplar.values.dtype)
    if exemplar.kind != "labels":
        values *= 100
    if exemplar.kind == "colour":
        values = np.stack([values] * 3, axis=-1)
    spacing = (exemplar.spacing[0],) * 3
    image = tb.Image(values, exemplar.kind, spacing, exemplar.unit, exemplar.phases)
    known = np.zeros(shape, bool)
    known[: shape[0] // 3] = True
    return {"fixed": image, "known": known}


REQUESTS: dict[str, Callable[[tb.Image], dict[str, Any]]] = {
    "periodic": lambda exemplar: {"periodic": (True, False, True)},
    "mask": lambda exemplar: {"mask": ball()},
    "target": lambda exemplar: {"target": {"porosity": tb.measure.porosity(exemplar) - 0.03}},
    "fixed": fixed,
}
HONOURS = {
    "texture": ("periodic", "mask", "target", "fixed"),
    "mrf": ("periodic", "mask", "target", "fixed"),
    "kopf": ("periodic", "mask", "target", "fixed"),
    "chen": ("periodic", "mask", "target", "fixed"),
    "sliced": ("periodic", "mask", "target", "fixed"),
    "quilt": ("periodic", "mask", "target", "fixed"),
    "bubbles": ("periodic", "mask", "target"),
    "noise": ("periodic", "mask"),
}
PRESETS = {
    "texture": ("fast", "best", "paper"),
    "mrf": ("fast", "best", "paper"),
    "kopf": ("fast", "best", "paper"),
    "chen": ("fast", "best", "paper"),
    "sliced": ("fast", "best"),
    "quilt": ("fast", "paper"),
    "bubbles": ("bread", "baguette", "sponge", "cheese", "stone", "foam", "bone"),
    "noise": (),
}
FROM_PICTURES = ("mrf", "kopf", "chen", "sliced")
QUICK: dict[str, dict[str, Any]] = {
    "texture": {"first_rounds": 6, "rounds": (2, 3, 4), "sweeps": 1},
    "mrf": {"sweeps": (2, 3, 4), "candidates": 1024},
    "kopf": {"first_rounds": 6, "rounds": (2, 3, 4), "sweeps": (1, 1)},
    "chen": {"first_rounds": 6, "rounds": (2, 3, 4), "sweeps": (1, 1)},
    "sliced": {"layout_rounds": 8, "rounds": (2, 2), "sweeps": 1},
    "quilt": {"candidates": 500, "tries": 4},
    "bubbles": {"trials": 4, "distance": 8.0},
    "noise": {"reach": 8},
    "gan": {
        "iterations": 2,
        "minutes": 1000.0,
        "width": 2,
        "batch": 2,
        "crop": 64,
        "interface_rounds": 0,
    },
}
"""Settings with which a method takes about a second."""


def exemplar_of(method: str) -> tb.Image:
    """Return a small exemplar of labels for a method."""
    return picture(bone(32)) if method in FROM_PICTURES else bone(24)


@cache
def model(method: str, preset: str | None = None) -> Any:
    """Return a method's model of its small exemplar, with quick settings or a preset's."""
    settings = QUICK[method] if preset is None else {}
    if preset is not None and method == "bubbles":
        settings = {"distance": 8.0}
        return tb.method(method, preset=preset, **settings).fit()
    return tb.method(method, preset=preset, **settings).fit(exemplar_of(method))


# Methods: settings, presets, parts of a request


def _add_method(method: str) -> None:
    case(f"{method}-quick")(lambda: model(method).generate(SHAPE, seed=3))
    for preset in PRESETS[method]:
        shape = (24, 26, 28) if method == "bubbles" else (12, 13, 14) if preset == "best" else SHAPE
        case(f"{method}-preset-{preset}")(
            lambda p=preset, s=shape: model(method, p).generate(s, seed=3)
        )
    for part in HONOURS[method]:
        case(f"{method}-{part}")(
            lambda p=part: model(method).generate(SHAPE, seed=3, **REQUESTS[p](exemplar_of(method)))
        )


for _name in HONOURS:
    _add_method(_name)


def _exemplars(method: str, volume: tb.Image) -> tb.Image:
    return picture(volume) if method in FROM_PICTURES else volume


for _name in ("texture", "mrf", "kopf", "chen"):

    @case(f"{_name}-grey")
    def _grey(method: str = _name) -> tb.Image:
        exemplar = _exemplars(method, grey(28))
        return tb.method(method, **QUICK[method]).fit(exemplar).generate(SHAPE, seed=4)

    @case(f"{_name}-colour")
    def _colour(method: str = _name) -> tb.Image:
        exemplar = _exemplars(method, colour(28))
        return tb.method(method, **QUICK[method]).fit(exemplar).generate(SHAPE, seed=4)


for _name in ("texture", "mrf", "kopf", "chen", "sliced", "quilt", "noise"):

    @case(f"{_name}-three-phase")
    def _three_phase(method: str = _name) -> tb.Image:
        exemplar = _exemplars(method, three_phase(28))
        return tb.method(method, **QUICK[method]).fit(exemplar).generate(SHAPE, seed=4)


for _name in ("texture", "mrf", "kopf", "chen", "sliced", "quilt"):

    @case(f"{_name}-several")
    def _several(method: str = _name) -> tb.Image:
        if method in FROM_PICTURES:
            exemplars = [picture(bone(32)), picture(bone(32), 1)]
        else:
            whole = tb.sample("bone")
            exemplars = [tb.crop(whole, 24), tb.crop(whole, 24, corner=(0, 0, 0))]
        return tb.method(method, **QUICK[method]).fit(exemplars).generate(SHAPE, seed=5)


@case("texture-grey-fixed")
def _texture_grey_fixed() -> tb.Image:
    learned = tb.method("texture", **QUICK["texture"]).fit(grey(24))
    return learned.generate(SHAPE, seed=6, **fixed(grey(24)))


@case("texture-beside")
def _texture_beside(**settings: Any) -> tb.Image:
    shape = (48, 32, 33)
    known = np.zeros(shape, bool)
    known[:24] = True
    held = tb.crop(tb.sample("bone"), shape, corner=(0, 0, 0))
    learned = tb.method("texture", sweeps=1, tries=2, **settings).fit(bone(40))
    return learned.generate(shape, seed=6, fixed=held, known=known)


@case("tessellation-scan")
def _tessellation_scan() -> tb.Image:
    learned = tb.method("tessellation", volume_spread=0.25, lloyd_steps=1, rounding=0.2)
    model = learned.fit(tb.crop(tb.sample("cells"), 48))
    return model.generate(SHAPE, seed=4, target={"porosity": ramp(0.4, 0.55)})


@case("texture-graded")
def _texture_graded() -> tb.Image:
    return model("texture").generate(SHAPE, seed=6, target={"porosity": ramp(0.7, 0.9)})


@case("texture-graded-feedback")
def _texture_graded_feedback() -> tb.Image:
    learned = tb.method("texture", **QUICK["texture"], grading="feedback").fit(bone(24))
    return learned.generate(SHAPE, seed=6, target={"porosity": ramp(0.7, 0.9)})


@case("texture-graded-shift")
def _texture_graded_shift() -> tb.Image:
    settings = {**QUICK["texture"], "grading": "shift", "connected": "none"}
    learned = tb.method("texture", **settings).fit(bone(24))
    return learned.generate(SHAPE, seed=6, target={"porosity": ramp(0.7, 0.9)})


@case("texture-default")
def _texture_default() -> tb.Image:
    return tb.method("texture").fit(bone(24)).generate(SHAPE, seed=6)


@case("kopf-sections")
def _kopf_sections() -> tb.Image:
    volume = bone(64).values
    sections = [tb.Image(np.ascontiguousarray(volume[n]), "labels") for n in (30, 32, 34, 36)]
    learned = tb.method("kopf", **QUICK["kopf"], gap=2).fit(sections)
    return learned.generate((24, 28, 26), seed=2)


@case("kopf-coarse")
def _kopf_coarse() -> tb.Image:
    truth = tb.Image(bone(64).values, "labels", phases=("void", "solid"))
    share = truth.values.reshape(16, 4, 16, 4, 16, 4).mean(axis=(1, 3, 5), dtype=np.float64)
    coarse = tb.Image((share > 0.5).astype(np.uint8), "labels", phases=truth.phases)
    shown = tb.Image(picture(tb.sample("bone")).values, "labels", phases=truth.phases)
    learned = tb.method("kopf", **QUICK["kopf"]).fit(shown)
    return learned.generate(64, coarse=coarse, seed=2)


@case("kopf-process")
def _kopf_process() -> tb.Image:
    learned = tb.method("kopf", process="gaussian").fit(picture(bone(48)))
    return learned.generate(SHAPE, seed=6)


@case("packing")
def _packing() -> tb.Image:
    cells = tb.crop(tb.sample("cells"), 40)
    learned = tb.method("packing", phase="void", separation=0.95, fillet=0.5).fit(cells)
    return learned.generate((40, 36, 28), seed=1, periodic=(True, False, False))


@case("packing-trials")
def _packing_trials() -> tb.Image:
    cells = tb.crop(tb.sample("cells"), 48)
    learned = tb.method("packing", fillet=0.0, degree=3).fit(cells)
    return learned.generate(32, seed=2, target={"porosity": 0.55})


@case("fibres")
def _fibres() -> tb.Image:
    foam = tb.crop(tb.sample("foam"), 40)
    learned = tb.method("fibres", phase="solid", separation=0.7, fillet=0.5, bend=0.2).fit(foam)
    return learned.generate((40, 36, 28), seed=1, periodic=(True, False, False))


@case("texture-without-flips")
def _texture_without_flips() -> tb.Image:
    """Make what the default of before made, in which single voxels did not flip."""
    return tb.method("texture", interface_rounds=0).fit(bone(24)).generate(SHAPE, seed=6)


@case("texture-without-balls")
def _texture_without_balls() -> tb.Image:
    """Make what the default of before made, whose flips did not count balls."""
    return tb.method("texture", interface_balls=False).fit(bone(24)).generate(SHAPE, seed=6)


@case("texture-by-leaves")
def _texture_by_leaves() -> tb.Image:
    return tb.method("texture", search="leaves").fit(bone(24)).generate(SHAPE, seed=6)


@case("texture-sliced-layout")
def _texture_sliced_layout() -> tb.Image:
    """Make what the default of before, which was laid out by sliced rounds, made."""
    settings = {"layout": "structure", "interface_rounds": 0}
    return tb.method("texture", **settings).fit(bone(24)).generate(SHAPE, seed=6)


@case("texture-plain-votes")
def _texture_plain_votes() -> tb.Image:
    """Make what a default of before that, whose votes were plain means of distances, made."""
    settings = {"layout": "structure", "vote_power": 1.0, "interface_rounds": 0}
    return tb.method("texture", **settings).fit(bone(24)).generate(SHAPE, seed=6)


@case("texture-sliced-beside")
def _texture_beside_sliced() -> tb.Image:
    """Make what the default of before made beside known voxels."""
    return _texture_beside(layout="structure", interface_rounds=0)


@case("texture-energy")
def _texture_energy() -> tb.Image:
    settings = {**QUICK["texture"], "gradient": 0.1, "adaptive": True, "orientations": "mirrors"}
    return tb.method("texture", **settings).fit(bone(24)).generate(SHAPE, seed=6)


@case("texture-paper-before")
def _texture_paper_before() -> tb.Image:
    """Make what `preset="paper"` made before it started from copies, of the settings it had."""
    settings = {
        "novelty": 0.0,
        "neighbourhood": (10, 8, 4),
        "step": 0,
        "levels": 2,
        "first_rounds": 30,
        "rounds": (30,),
        "components": 128,
        "trim": 0,
        "histogram": False,
        "search": "exact",
        "orientations": "mirrors",
        "gradient": 0.1,
        "adaptive": True,
        "tolerance": 1e-3,
    }
    return tb.method("texture", **settings).fit(bone(24)).generate(SHAPE, seed=3)


@case("texture-exact-search")
def _texture_exact() -> tb.Image:
    settings = {**QUICK["texture"], "search": "exact", "field": "indicator"}
    return tb.method("texture", **settings).fit(bone(24)).generate(SHAPE, seed=6)


for _relaxation, _heuristic in (("icm", "h1a"), ("annealing", "h2b"), ("gibbs", "h2a")):

    @case(f"mrf-{_relaxation}-{_heuristic}")
    def _mrf(relaxation: str = _relaxation, heuristic: str = _heuristic) -> tb.Image:
        settings = {**QUICK["mrf"], "relaxation": relaxation, "heuristic": heuristic}
        return tb.method("mrf", **settings).fit(exemplar_of("mrf")).generate(SHAPE, seed=6)


@case("mrf-icm-by-classes")
def _mrf_by_classes() -> tb.Image:
    """Make what icm made before it visited sites in a random order."""
    settings = {"sweeps": (3,), "candidates": 256, "scales": 2, "relaxation": "icm", "xi": -12.0}
    learned = tb.method("mrf", **settings, order="classes").fit(picture(grey(28)))
    return learned.generate(SHAPE, seed=6)


@case("quilt-graded")
def _quilt_graded() -> tb.Image:
    return model("quilt").generate(SHAPE, seed=6, target={"volume_fraction": ramp(0.1, 0.3)})


@case("quilt-minkowski")
def _quilt_minkowski() -> tb.Image:
    target = {"surface": 0.15, "euler": -1e-4, "volume_fraction:solid": 0.2}
    return model("quilt").generate(SHAPE, seed=6, target=target)


@case("quilt-apparent")
def _quilt_apparent() -> tb.Image:
    target = {"volume_fraction": 0.2, "apparent_stiffness:z": ramp(0.02, 0.08)}
    return model("quilt").generate(SHAPE, seed=6, target=target)


# Pictures from pictures, and no exemplar


@case("quilt-flat")
def _quilt_flat() -> tb.Image:
    learned = tb.method("quilt", **QUICK["quilt"]).fit(picture(bone(48)))
    return learned.generate((40, 44), seed=7, target={"perimeter": 0.1})


@case("noise-flat")
def _noise_flat() -> tb.Image:
    return tb.method("noise", reach=8).fit(picture(bone(32))).generate((30, 34), seed=7)


@case("bubbles-flat")
def _bubbles_flat() -> tb.Image:
    learned = tb.method("bubbles", **QUICK["bubbles"]).fit(picture(bone(32)))
    return learned.generate((30, 34), seed=7)


@case("bubbles-alone-flat")
def _bubbles_alone_flat() -> tb.Image:
    return tb.method("bubbles", distance=8).fit(spacing=2.0, unit="um").generate((30, 34), seed=7)


@case("bubbles-particles")
def _bubbles_particles() -> tb.Image:
    return tb.method("bubbles", growth="particles", distance=8).fit().generate(SHAPE, seed=7)


@case("bubbles-flow")
def _bubbles_flow() -> tb.Image:
    settings = {"flow": "y, -x", "flow_regions": (("z > 0.5", "radial"),), "randomness": 0.5}
    learned = tb.method("bubbles", distance=8, silhouette_share=1.0, crust_share=0.2, **settings)
    return learned.fit().generate(SHAPE, seed=7, mask=ball())


for _kind in ("gaussian", "white", "perlin", "worley", "voronoi"):

    @case(f"noise-alone-{_kind}")
    def _noise_alone(kind: str = _kind) -> tb.Image:
        learned = tb.method("noise", kind=kind, porosity=0.6).fit(spacing=3.0, unit="um")
        return learned.generate(SHAPE, seed=8)


@case("noise-exact")
def _noise_exact() -> tb.Image:
    return tb.method("noise", reach=8, exact=True).fit(bone(24)).generate(SHAPE, seed=8)


def lattice(cell_size: Any = 24.0, **settings: Any) -> Any:
    """Return a model of cells of 8 voxels."""
    return tb.method("lattice", cell_size=cell_size, **settings).fit(spacing=3.0, unit="um")


for _cell in (
    *("gyroid", "schwarz_p", "schwarz_d", "iwp", "neovius", "fischer_koch_s", "frd"),
    *("simple_cubic", "bcc", "fcc", "octet", "kelvin", "diamond"),
):

    @case(f"lattice-{_cell}")
    def _lattice(cell: str = _cell) -> tb.Image:
        return lattice(cell=cell).generate(SHAPE, seed=1)


@case("lattice-network")
def _lattice_network() -> list[tb.Image]:
    return [
        lattice(cell=cell, phase="network", porosity=0.5).generate(SHAPE, seed=1)
        for cell in ("gyroid", "iwp")
    ]


@case("lattice-graded")
def _lattice_graded() -> list[tb.Image]:
    target = {"porosity": ramp(0.5, 0.8)}
    return [
        lattice(cell=cell).generate(tb.Request(SHAPE, seed=1, target=target))
        for cell in ("gyroid", "kelvin")
    ]


@case("lattice-direction")
def _lattice_direction() -> tb.Image:
    turned = lattice([18, 24, 30], cell="diamond", direction=[1, 1, 1])
    return turned.generate(SHAPE, seed=1)


@case("lattice-coordinates")
def _lattice_coordinates() -> tb.Image:
    rings = ["z / 24", "hypot(y - Y / 2, x - X / 2) / 24", "3 * atan2(y - Y / 2, x - X / 2) / pi"]
    return lattice(None, coordinates=rings).generate(SHAPE, seed=1)


@case("lattice-periodic-mask")
def _lattice_periodic_mask() -> tb.Image:
    request = tb.Request(SHAPE, seed=1, periodic=(True, False, True), mask=ball())
    return lattice().generate(request)


@case("lattice-window")
def _lattice_window() -> np.ndarray:
    return lattice(cell="octet").window(SHAPE, ((-5, 9), (3, 17), (30, 45)), seed=1)


# Windows, and volumes in blocks


@case("noise-window")
def _noise_window() -> np.ndarray:
    return model("noise").window(SHAPE, ((-5, 9), (3, 17), (30, 45)), seed=9)


@case("noise-window-periodic")
def _noise_window_periodic() -> np.ndarray:
    box = ((-5, 20), (3, 17), (-3, 30))
    return model("noise").window(SHAPE, box, seed=9, periodic=(True, False, True))


@case("bubbles-window")
def _bubbles_window() -> np.ndarray:
    return model("bubbles").window(SHAPE, ((-5, 9), (3, 17), (30, 45)), seed=9)


@case("bubbles-window-mask")
def _bubbles_window_mask() -> np.ndarray:
    return model("bubbles").window(SHAPE, ((2, 9), (3, 17), (0, 11)), seed=9, mask=ball())


@contextmanager
def new_folder() -> Iterator[Path]:
    """Work in a new folder, which is removed afterwards."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        yield Path(folder)


def command(*words: str) -> None:
    """Run the command line; raise where it fails."""
    if main([str(word) for word in words]):
        raise RuntimeError(f"trabecula {' '.join(map(str, words))} failed")


def options_of(settings: Mapping[str, Any]) -> list[str]:
    """Return settings as words of the command line."""
    return [
        word
        for name, value in settings.items()
        for word in ("--set", f"{name}={json.dumps(value)}")
    ]


def in_blocks(method: str, *words: str) -> tb.Image:
    """Generate into a store in blocks of 16 voxels, with every array in a scratch file."""
    with new_folder(), patch.object(memmap, "SMALLEST", 256):
        tb.write(exemplar_of(method), "exemplar.tif")
        size = ("--shape", "16", "18", "20", "--seed", "3", "--chunks", "16")
        chosen = ("--method", method, *options_of(QUICK[method]))
        command("generate", "exemplar.tif", *chosen, *size, "--out", "made.zarr", *words)
        return tb.read("made.zarr")


for _name in HONOURS:
    case(f"{_name}-in-blocks")(lambda method=_name: in_blocks(method))

for _name in ("texture", "quilt"):
    case(f"{_name}-in-blocks-periodic")(lambda method=_name: in_blocks(method, "--periodic", "z"))
    case(f"{_name}-in-blocks-target")(
        lambda method=_name: in_blocks(method, "--target", "porosity=0.8")
    )


@case("noise-levels")
def _noise_levels() -> list[Any]:
    with new_folder():
        size = ("--shape", "40", "--chunks", "16")
        command(
            "generate", "--method", "noise", "--set", "porosity=0.6", *size, "--out", "made.zarr"
        )
        return [tb.read("made.zarr", level=1), tb.read("made.zarr", level=0)]


def interrupted(method: str, path: str, at: int) -> tb.Image:
    """Interrupt a run at the `at`-th report of its progress, and resume it from its checkpoint."""
    reports = iter(range(at))

    def interrupt(label: str, done: float) -> None:
        if next(reports, None) is None:
            raise KeyboardInterrupt

    learned = tb.method(method, **QUICK[method]).fit(exemplar_of(method))
    often = patch.multiple(checkpoint, EVERY=0.0, _SHARE=0)
    with often, new_folder():
        try:
            with listen(interrupt), tb.kept_at(path):
                learned.generate(SHAPE, seed=3)
            raise RuntimeError("the run was over before it was interrupted")
        except KeyboardInterrupt:
            if not Path(path).exists():
                raise RuntimeError("the run left no checkpoint") from None
        with tb.kept_at(path):
            return learned.generate(SHAPE, seed=3)


for _name in ("texture", "mrf", "kopf", "chen", "sliced"):
    case(f"{_name}-resumed")(lambda method=_name: interrupted(method, "made.part", 6))


@case("texture-resumed-in-blocks")
def _texture_resumed_in_blocks() -> tb.Image:
    reports = iter(range(30))

    def interrupt(label: str, done: float) -> None:
        if next(reports, None) is None:
            raise KeyboardInterrupt

    often = patch.multiple(checkpoint, EVERY=0.0, _SHARE=0)
    with new_folder(), often, patch.object(memmap, "SMALLEST", 256):
        tb.write(bone(24), "exemplar.tif")
        learned = tb.method("texture", **QUICK["texture"]).fit(tb.read("exemplar.tif"))
        request = tb.Request((18, 20, 34), seed=3)
        try:
            with listen(interrupt):
                generate_to(learned, request, "made.zarr", chunks=16)
            raise RuntimeError("the run was over before it was interrupted")
        except KeyboardInterrupt:
            command("generate", "--resume", "made.zarr")
        return tb.read("made.zarr")


# Models: what a file holds of them, and that it makes the same voxels


for _name in HONOURS:

    @case(f"{_name}-model-file")
    def _model_file(method: str = _name) -> tb.Image:
        with new_folder():
            model(method).save("one.model")
            return tb.load_model("one.model").generate(SHAPE, seed=3)


# Model files that version 0.1 wrote


for _path in sorted(FILES.glob("*.model")):
    case(f"{_path.stem}-old-model")(lambda path=_path: tb.load_model(path).generate(SHAPE, seed=3))


# Trained models need PyTorch


@case("gan-shipped")
def _gan_shipped() -> tb.Image:
    return tb.load_model("bone").unmatched().generate((24, 20, 22), seed=3)


@case("gan-shipped-window")
def _gan_shipped_window() -> np.ndarray:
    return tb.load_model("berea").unmatched().window(SHAPE, ((-5, 9), (3, 17), (30, 45)), seed=9)


@case("gan-shipped-periodic-mask")
def _gan_shipped_periodic() -> tb.Image:
    shape = (16, 24, 16)
    return (
        tb.load_model("nmc")
        .unmatched()
        .generate(shape, seed=3, periodic=(True, False, True), mask=ball(shape))
    )


@case("gan-shipped-in-blocks")
def _gan_in_blocks() -> tb.Image:
    tb.load_model("cement")  # raises MissingExtraError, which the command line only prints
    with new_folder():
        size = ("--shape", "18", "20", "34", "--seed", "3", "--chunks", "16")
        command("generate", "--model", "cement", *size, "--out", "made.zarr")
        return tb.read("made.zarr")


@case("gan-trained")
def _gan_trained() -> tb.Image:
    with tb.threads(1):
        # Without local fractions: its hashes on two kinds of processors are from before them.
        learned = tb.method("gan", **QUICK["gan"], fractions=0).fit(bone(64))
        return learned.generate((24, 20, 22), seed=3)


# Finish


@cache
def rough() -> tb.Image:
    """Return bone with floating parts, free ends, and a closed pore."""
    values = bone(32).values.copy()
    values[4:12, 4:12, 4:12] = 1
    values[6:9, 6:9, 6:9] = 0
    values[14:17] = 0
    values[20:22, 5, 5:25] = 1
    return tb.Image(values, "labels", (40.0,) * 3, "um", ("void", "solid"))


OPERATIONS: dict[str, Callable[[], Any]] = {
    "connect": lambda: tb.finish.connect(rough()),
    "connect-reach": lambda: tb.finish.connect(rough(), reach=4, brush=1, min_size=20),
    "connect-mask": lambda: tb.finish.connect(rough(), mask=ball((32, 32, 32))),
    "connect-phase": lambda: tb.finish.connect(three_phase(28), phase="active", connectivity=26),
    "prune": lambda: tb.finish.prune(rough()),
    "prune-exemplar": lambda: tb.finish.prune(rough(), exemplar=bone(32), mask=ball((32, 32, 32))),
    "smooth": lambda: tb.finish.smooth(rough(), sigma=50.0),
    "thicken": lambda: tb.finish.thicken(rough(), thickness=120.0),
    "offset": lambda: tb.finish.offset(rough(), fraction=0.2),
    "remove_floaters": lambda: tb.finish.remove_floaters(rough()),
    "remove_floaters-small": lambda: tb.finish.remove_floaters(rough(), smaller_than=50),
    "mend_contacts": lambda: tb.finish.mend_contacts(rough()),
    "fill_trapped": lambda: tb.finish.fill_trapped(rough()),
    "trapped": lambda: tb.finish.trapped(rough()),
    "print_check": lambda: asdict(tb.print_check(rough(), printer="sls")),
}
for _name, _function in OPERATIONS.items():
    case(f"finish-{_name}")(_function)


@case("finish-command")
def _finish_command() -> tb.Image:
    with new_folder():
        tb.write(rough(), "rough.nrrd")
        tb.write(bone(32), "bone.nrrd")
        steps = ("--prune", "--like", "bone.nrrd", "--connect", "--thicken", "100", "--fill")
        command("finish", "rough.nrrd", *steps, "--out", "part.npy")
        return tb.read("part.npy")


@case("finish-in-slabs")
def _finish_in_slabs() -> tb.Image:
    with new_folder(), patch.object(memmap, "SMALLEST", 256):
        tb.write(rough(), "rough.zarr")
        slabs = tb.open_slabs("rough.zarr")
        tb.finish.finish_slabs(slabs, "part.zarr", [("connect", {}), ("fill_trapped", {})])
        return tb.read("part.zarr")


# Files for other programs


@cache
def plain() -> tb.Image:
    """Return a small volume of labels without a recipe."""
    values = three_phase(24).values[4:16, 4:14, 4:18].copy()
    return tb.Image(values, "labels", (0.02, 0.03, 0.04), "mm", ("void", "active", "binder"))


def exported(name: str, image: tb.Image, **options: Any) -> dict[str, bytes]:
    """Return the bytes of every file that an export writes, by name."""
    with new_folder() as folder:
        tb.export(image, name, **options)
        found = sorted(path for path in folder.rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def _contents(name: str, image: tb.Image, **options: Any) -> list[Any]:
    """Return names and bytes of an export, without what depends on the library that compresses."""
    result: list[Any] = []
    for path, data in exported(name, image, **options).items():
        result.append(path)
        if path.endswith(".3mf"):
            with tempfile.TemporaryFile() as file:
                file.write(data)
                with zipfile.ZipFile(file) as members:
                    for member in members.namelist():
                        text = members.read(member)
                        result += [member, text.replace(tb.__version__.encode(), b"VERSION")]
        elif path.endswith(".nrrd"):
            header, _, packed = data.partition(b"\n\n")
            lines = [line for line in header.splitlines() if not line.startswith(b"#")]
            result += [*lines, gzip.decompress(packed)]
        elif path.endswith(".gz"):
            result.append(gzip.decompress(data))
        else:
            result.append(data)
    return result


for _suffix in ("stl", "ply", "obj", "3mf", "npy", "nrrd", "mhd", "nii", "nii.gz"):
    case(f"export-{_suffix}")(lambda name=f"part.{_suffix}": _contents(name, plain()))
for _suffix in ("vti", "tif", "mha", "zarr"):
    # The bytes depend on the library that compresses: what is read from them is hashed.

    @case(f"export-{_suffix}")
    def _export(name: str = f"part.{_suffix}") -> tb.Image:
        with new_folder():
            tb.export(plain(), name)
            return tb.read(name)


@case("export-stl-phase")
def _export_phase() -> list[Any]:
    return _contents("part.stl", plain(), phase="binder", spacing=0.1, unit="mm", scale=2.0)


@case("export-stl-slabs")
def _export_slabs() -> list[Any]:
    with new_folder():
        tb.write(plain(), "part.zarr")
        tb.export(tb.open_slabs("part.zarr"), "part.stl")
        return [Path("part.stl").read_bytes()]


@case("export-grey")
def _export_grey() -> list[Any]:
    return [_contents("scan.nrrd", tb.Image(grey(12).values, "grey", (2.0,) * 3, "um")),
            _contents("scan.npy", tb.Image(grey(12).values, "grey", (2.0,) * 3, "um"))]  # fmt: skip


@case("view-render")
def _render() -> tb.Image:
    return tb.render(bone(24), size=(64, 48))


@case("mesh-voxelise")
def _voxelise() -> list[Any]:
    with new_folder():
        tb.export(plain(), "part.stl")
        surface = tb.read_mesh("part.stl", unit="mm")
        return [surface.vertices, surface.faces, tb.voxelise(surface, spacing=0.017)]


# Images and samples


@case("exemplar-samples")
def _samples() -> list[tb.Image]:
    return [tb.sample(name) for name in ("bone", "foam")]


@case("exemplar-segment")
def _segment() -> list[tb.Image]:
    return [tb.segment(grey(24), threshold) for threshold in ("otsu", "dual", 100.0, (40, 120))]


@case("exemplar-margins")
def _margins() -> tb.Image:
    values = np.pad(bone(32).values, 5)
    return tb.crop_margins(tb.Image(values, "labels", (2.0,) * 3, "um", ("void", "solid")))


# Fields


FIELDS: dict[str, Callable[[], Any]] = {
    "ramp": lambda: tb.fields.ramp((9, 8, 7), axis="y", start=0.1, end=0.4, spacing=2.0, unit="um"),
    "radial": lambda: tb.fields.radial((9, 8, 7), inside=0.4, outside=0.1),
    "radial-axis": lambda: tb.fields.radial((9, 8, 7), inside=0.4, outside=0.1, axis="x", radius=3),
    "formula": lambda: tb.fields.formula((9, 8, 7), "0.3 + 0.2 * x / X - 0.1 * (y / Y) ** 2"),
    "picture": lambda: tb.fields.picture(picture(grey(24)), (5, 12, 14), low=0.1, high=0.5),
    "measure": lambda: tb.fields.measure(bone(24), "volume_fraction", size=7),
    "measure-euler": lambda: tb.fields.measure(bone(24), "euler", size=7),
    "measure-surface": lambda: tb.fields.measure(bone(24), "surface", size=9),
    "resample": lambda: tb.fields.resample(tb.fields.ramp(6, start=0.1, end=0.4), (11, 9, 7)),
    "rescale": lambda: tb.fields.rescale(tb.fields.ramp(6, start=0.1, end=0.4), low=0.2, high=0.3),
    "fill": lambda: tb.fields.fill(tb.fields.ramp(9, start=0.1, end=0.4), ball((9, 9, 9))),
    "interpolate": lambda: tb.fields.interpolate((9, 8, 7), [(0, 0, 0), (8, 7, 6)], [0.1, 0.4]),
    "interpolate-mask": lambda: tb.fields.interpolate(
        (9, 9, 9), [(4, 4, 1), (4, 4, 7)], [0.1, 0.4], mask=ball((9, 9, 9)), power=2
    ),
    "directions": lambda: [np.round(part, 5) + 0.0 for part in tb.fields.directions(bone(16))],
    "windowed": lambda: tb.fields.windowed(bone(16), size=6, names=("volume_fraction", "euler")),
    "topology-cantilever": lambda: _rounded(tb.fields.simp("cantilever", (8, 4, 15)).values),
    "topology-wheel": lambda: _rounded(
        tb.fields.simp("wheel", (8, 4, 8), penalty=2, rounds=20).values
    ),
}
for _name, _function in FIELDS.items():
    case(f"fields-{_name}")(_function)


# Measures


@case("measure-labels")
def _describe_labels() -> dict[str, Any]:
    return tb.describe(bone(24))


@case("measure-labels-full")
def _describe_full() -> dict[str, Any]:
    found = tb.describe(bone(20), level="full", box=12)
    for solves in found["physics"].values():
        for solve in solves.values():
            del solve["imbalance"]  # what is left at the end is round-off, another on each machine
    return {key: _solved(value) if key in SOLVED else value for key, value in found.items()}


SOLVED = ("permeability", "diffusivity", "conductivity", "tortuosity", "stiffness", "physics")


def _solved(value: Any) -> Any:
    """Return figures of solvers with four digits, and 0 for what is lost in round-off."""
    if isinstance(value, Mapping):
        return {key: _solved(each) for key, each in value.items()}
    if isinstance(value, (list, np.ndarray)):
        return [_solved(each) for each in value]
    if isinstance(value, float) and math.isfinite(value):
        return 0.0 if abs(value) < 1e-6 else float(f"{value:.4g}")
    return value


@case("measure-three-phase")
def _describe_three_phase() -> dict[str, Any]:
    return tb.describe(three_phase(24))


@case("measure-phases")
def _describe_phases() -> dict[str, Any]:
    return tb.measure.describe_phases(three_phase(20))


@case("measure-grey")
def _describe_grey() -> dict[str, Any]:
    return tb.describe(grey(24))


@case("measure-colour")
def _describe_colour() -> dict[str, Any]:
    return tb.describe(picture(colour(24)))


@case("measure-picture")
def _describe_picture() -> dict[str, Any]:
    return tb.describe(picture(bone(48)))


@case("measure-slabs")
def _describe_slabs() -> dict[str, Any]:
    with new_folder():
        tb.write(bone(32), "bone.zarr")
        return tb.measure.describe_slabs(tb.open_slabs("bone.zarr"))


# Certificate and inspection


def _printed(*words: str) -> Any:
    """Return the JSON that a verb of the command line prints."""
    with redirect_stdout(StringIO()) as text, new_folder():
        tb.write(bone(32), "bone.npy")
        tb.write(model("noise").generate(32, seed=1), "noise.npy")
        status = main([*words, "--json"])
    found = json.loads(text.getvalue())
    return [status, found]


@case("report-verify")
def _verify() -> Any:
    return _printed("verify", "bone.npy", "noise.npy")


@case("report-inspect")
def _inspect() -> Any:
    return _printed("inspect", "bone.npy")
