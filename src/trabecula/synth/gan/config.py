"""Settings of `gan`: the only home of its defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.exemplar.views import as_planes, check_gap_alone

GENERATORS = ("subpixel", "deconvolution", "deconvolution+conv")
DISCRIMINATORS = ("scales", "patch", "score")
ADVERSARIAL = ("relativistic", "standard")
DEVICES = ("auto", "cpu", "cuda")
PRECISIONS = ("auto", "bf16", "float32")
REDUCTIONS = ("mean", "sum")
STORAGES = ("float32", "float16")
ORIENTATIONS = ("auto", "none", "inverted", "mirrors", "all")


@dataclass(frozen=True)
class GanConfig:
    """Settings of `gan`."""

    generator: str = "subpixel"
    """Generator: "subpixel" (convolutions without padding, sub-pixel steps),
    "deconvolution" (the paper's table read with its fifth layer as the output: B) or
    "deconvolution+conv" (with an output convolution after it: A)."""

    discriminator: str = "scales"
    """Discriminator: "scales" (a verdict for every place, on two scales), or the paper's
    layers with one verdict for the whole crop ("score") or one for every place ("patch")."""

    width: int = 16
    """Channels of the finest layer of both networks, 2 .. 128; coarser ones have 2, 4 and 8 times
    as many. The paper's: 64.
    """

    smoothing: int = 1
    """Blurs of 1 2 1 along every axis that end the sub-pixel generator, 0 .. 2: without any there
    are chequerboards.
    """

    polish: int = 0
    """Further blurs when material is made, after the training, 0 .. 2 - smoothing: fewer specks,
    smoother interfaces, fewer connections."""

    specks: int = 2
    """Edge of the box, voxels, 0 .. 2: components of a phase that fit into it, 1 to 8
    voxels, are removed when material is made. 0 keeps them."""

    interface_rounds: int = 1
    """Rounds over the voxels of interfaces, 0 .. 1, when material is made: a voxel changes phase
    where that brings what the generator's patterns (chords, cubes of 2^3 voxels, neighbours) are
    off on average nearer to the exemplar's. Measured after the training, of volumes of two or three
    phases; anything else is made without."""

    latent: int = 16
    """Channels of the latent, 1 .. 512. The paper's: 100."""

    crop: int = 64
    """Edge of the crops that the discriminator sees, voxels, 32 .. 128: a multiple of 8 of at least
    40, for the paper's networks of 32.
    """

    batch: int = 2
    """Crops an iteration, 1 .. 512."""

    adversarial: str = "relativistic"
    """Loss: "relativistic" (pairs of a real and a made crop) or "standard" (the paper's,
    non-saturating).
    """

    penalty: float = 0.5
    """Weight of the gradient penalty R1 on real crops (squared gradient of all verdicts over their
    number), 0 .. 1000; 0 leaves it out. With too much the discriminator learns nothing, with too
    little it runs away from the generator."""

    noise: tuple[float, float] = (0.1, 0.02)
    """Standard deviation of the noise that both kinds of crops get before the discriminator
    sees them, at the start and at the end.
    """

    warmup: float = 0.12
    """Share of the training that matches sliced distributions of neighbourhoods, before the
    discriminator starts, 0 .. 1.
    """

    sliced: float = 2.0
    """Weight of the same term beside the adversarial loss afterwards, 0 .. 1000."""

    fractions: float = 1.0
    """Weight of the term by which the generator obeys the local fractions of the phases that it is
    given, 0 .. 1000: samples scatter as parts of the exemplar do, and a target porosity is
    honoured. 0 gives it none. Of the sub-pixel generator, labels of at least 64 voxels or pixels a
    side, and crops of at least 40; anything else learns without."""

    gram: float = 0.0
    """Weight of the gram loss, 0 .. 1000. The paper's: 0.1."""

    structural: float = 0.0
    """Weight of the structural loss, 0 .. 1000. The paper's: 1."""

    reduction: str = "mean"
    """How the gram and the structural loss add up: "mean" (over regions, slices and features: the
    weights do not depend on the crop) or "sum" (equation 4 and section 3.3 of the paper as
    printed; a mean over the crops of a batch alone)."""

    rate: float = 1e-3
    """Learning rate of Adam, 1e-6 .. 0.1. The paper's: 2e-4."""

    decay: float = 0.4
    """Share of the training, at its end, over which the rate falls to nothing, 0 .. 1."""

    average: float = 0.995
    """Decay of the exponential moving average of the weights per iteration, 0 .. 0.99999; 0 takes
    the last weights alone.
    """

    clip: float = 5.0
    """Voxels at which the signed distance that stands for labels saturates, 0 .. 50; 0 learns -1
    and 1 (the paper's). Of pictures always 0: a distance in their plane is none in space.
    """

    orientations: str = "auto"
    """Copies of the exemplar that are learnt from as well: "none", "inverted" (its point
    reflection, which has the same two-point function along every direction), "mirrors" (about the
    axes), or "all" 48; of pictures "mirrors" are 4 and "all" 8. "auto" is "inverted", and "all" of
    one picture that stands for all three planes: its rows are then like its columns."""

    views: tuple[str, ...] = ()
    """Planes of the volume that look like the pictures, where it learns from pictures: two or
    three of "yx" (seen across z), "zx" (across y), "zy" (across x); turned pictures are "xy",
    "xz", "yz". None named: as `kopf` and `sliced` take them.
    """

    gap: int = 0
    """Pixels from one to the next of two or more parallel sections of a material that is alike from
    all sides, 0 .. 32, less than half a crop: pairs of slices are then judged, so that it is joined
    across the planes as well. 0: pictures are of different planes."""

    minutes: float = 10.0
    """Time to train for, 0 .. 100000 minutes by the clock; 0 leaves it to the iterations."""

    iterations: int = 0
    """Iterations to train for, 0 .. 10**8; 0 leaves it to the minutes. Only then does the same seed
    give the same model; give minutes as well, and it stops where they are over."""

    looks: int = 24
    """Evaluations in a run, 1 .. 1000: figures, a picture, and a checkpoint."""

    patience: int = 0
    """Evaluations without a better two-point function after which the training stops, 0 .. 1000;
    0 never stops it.
    """

    seed: int = 0
    """Seed of the training: weights, crops and noise."""

    device: str = "auto"
    """Where to train and to generate: "cpu", "cuda", or "auto" (a GPU where there is one)."""

    precision: str = "auto"
    """Arithmetic of the networks in training: "bf16", "float32", or "auto" (bf16 where the
    device that trains multiplies in it). Material is made in bf16 where the processor multiplies
    in it, but for "float32".
    """

    storage: str = "float32"
    """Numbers that the model is stored in: "float32", or "float16" for half the bytes. Weights
    are rounded at the end of the training, before the calibration."""

    checkpoint: float = 2.0
    """Minutes between two checkpoints at most, 0.01 .. 100000, beside those of the evaluations."""

    run: str = ""
    """Folder for metrics.csv, pictures and checkpoints of the training; none where empty."""

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        older = {
            "reduction": "mean",
            "storage": "float32",
            "views": (),
            "fractions": 0.0,
            "gap": 0,
            "interface_rounds": 0,
        }
        return {**older, **settings}

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return PRESETS[name]

    def __post_init__(self) -> None:
        check_name(self.generator, GENERATORS, name="generator")
        check_name(self.discriminator, DISCRIMINATORS, name="discriminator")
        check_name(self.adversarial, ADVERSARIAL, name="adversarial loss")
        check_name(self.device, DEVICES, name="device")
        check_name(self.precision, PRECISIONS, name="precision")
        check_name(self.orientations, ORIENTATIONS, name="orientations")
        check_name(self.reduction, REDUCTIONS, name="reduction")
        check_name(self.storage, STORAGES, name="storage")
        object.__setattr__(self, "views", as_planes(self.views))
        for name, low, high, whole in _RANGES:
            object.__setattr__(
                self,
                name,
                as_number(getattr(self, name), name=name, low=low, high=high, whole=whole),
            )
        object.__setattr__(self, "noise", _as_pair(self.noise))
        self._check_crop()
        if self.smoothing + self.polish > 2:
            raise InputError(
                f"smoothing={self.smoothing} and polish={self.polish} are more than 2 blurs: "
                "lower one of them"
            )
        if self.gap >= self.crop // 2:
            raise InputError(
                f"gap={self.gap} leaves few pairs of slices in crops of {self.crop} voxels: give a "
                "gap of less than half a crop"
            )
        check_gap_alone(self.gap, self.views)
        if not self.minutes and not self.iterations:
            raise InputError("minutes=0 and iterations=0 train for ever: give one of them")
        if (self.gram or self.structural) and self.discriminator == "scales":
            raise InputError(
                "gram and structural losses compare features of the paper's networks: "
                "discriminator='score'"
            )

    def _check_crop(self) -> None:
        step = 8 if self.discriminator == "scales" else 32
        if self.crop % max(step, self.cell) or self.crop < self.least_crop:
            raise InputError(
                f"crop={self.crop} should be a multiple of {max(step, self.cell)} voxels, "
                f"{self.least_crop} at least, with generator={self.generator!r} and "
                f"discriminator={self.discriminator!r}"
            )

    @property
    def least_crop(self) -> int:
        """Return the edge of the smallest crop that the networks take, voxels."""
        least = 40 if self.discriminator == "scales" else 32
        return least if self.generator == "subpixel" else max(64, least)

    @property
    def cell(self) -> int:
        """Return the edge of a cell of the latent, voxels."""
        return 8 if self.generator == "subpixel" else 16


_RANGES = (
    ("width", 2, 128, True),
    ("smoothing", 0, 2, True),
    ("polish", 0, 2, True),
    ("specks", 0, 2, True),
    ("interface_rounds", 0, 1, True),
    ("latent", 1, 512, True),
    ("crop", 32, 128, True),
    ("batch", 1, 512, True),
    ("penalty", 0, 1000, False),
    ("warmup", 0, 1, False),
    ("sliced", 0, 1000, False),
    ("fractions", 0, 1000, False),
    ("gram", 0, 1000, False),
    ("structural", 0, 1000, False),
    ("rate", 1e-6, 0.1, False),
    ("decay", 0, 1, False),
    ("average", 0, 0.99999, False),
    ("clip", 0, 50, False),
    ("gap", 0, 32, True),
    ("minutes", 0, 1e5, False),
    ("checkpoint", 0.01, 1e5, False),
    ("iterations", 0, 10**8, True),
    ("looks", 1, 1000, True),
    ("patience", 0, 1000, True),
    ("seed", 0, 2**63 - 1, True),
)


def _as_pair(noise: Any) -> tuple[float, float]:
    """Return the two standard deviations of `noise`."""
    try:
        first, last = noise
    except (TypeError, ValueError):
        raise InputError(
            f"noise={noise!r} should be two numbers, at the start and at the end"
        ) from None
    values = [float(as_number(value, name="noise", low=0, high=10)) for value in (first, last)]
    return values[0], values[1]


_PAPER: dict[str, Any] = {
    "generator": "deconvolution",
    "discriminator": "score",
    "width": 64,
    "latent": 100,
    "crop": 64,
    "batch": 100,
    "adversarial": "standard",
    "penalty": 0.0,
    "noise": (0.0, 0.0),
    "warmup": 0.0,
    "sliced": 0.0,
    "fractions": 0.0,
    "orientations": "none",
    "rate": 2e-4,
    "decay": 0.0,
    "average": 0.0,
    "clip": 0.0,
    "specks": 0,
    "interface_rounds": 0,
    "minutes": 0.0,
    "iterations": 40000,
}

PRESETS: dict[str, dict[str, Any]] = {
    "compact": {},
    "paper": {**_PAPER, "gram": 0.1, "structural": 1.0},
    "3dgan": _PAPER,
    "patchgan": {**_PAPER, "discriminator": "patch"},
    "gram": {**_PAPER, "gram": 0.1},
    "structural": {**_PAPER, "structural": 1.0},
    "all": {**_PAPER, "gram": 0.1, "structural": 1.0},
}
