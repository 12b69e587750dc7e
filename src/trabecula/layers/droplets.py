"""Droplets of material jetting: which material each pixel of a layer is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.recipe import digest
from trabecula.core.seeds import key
from trabecula.layers.dithering import diffuse
from trabecula.layers.sampling import AxisWeights, LayerSampler, average_plane

COLOURS = (
    (255, 255, 255),
    (0, 0, 0),
    (0, 174, 239),
    (236, 0, 140),
    (255, 242, 0),
    (0, 166, 81),
    (242, 101, 34),
)
"""Of the background, and of materials in turn; the printer's program asks what each stands for."""

BACKGROUND = "background"


@dataclass(frozen=True, eq=False)
class Mixture:
    """A phase made of droplets of two materials.

    Parameters
    ----------
    share : (z, y, x) float32
        Of the second material, 0 to 1, over the whole part; its voxels may be larger.
    materials : two ints
        Their numbers.
    """

    share: np.ndarray
    materials: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Palette:
    """Materials of a volume's phases.

    Attributes
    ----------
    phases : tuple of int
        Labels that are printed.
    makers : tuple of (int or Mixture)
        Of each of them: the number of its material, or its mixture.
    materials : tuple of str
        Names; number 0 is the background.
    """

    phases: tuple[int, ...]
    makers: tuple[int | Mixture, ...]
    materials: tuple[str, ...]

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        printed: Sequence[int],
        materials: Mapping[str, str],
        mixtures: Mapping[str, tuple[Any, str, str]],
    ) -> Palette:
        """Give every printed phase its material, by default one of its own name.

        Raises
        ------
        UnknownNameError
            A phase that the volume does not have.
        InputError
            Too many materials, or a mixture that is none.
        """
        for name in (*materials, *mixtures):
            check_name(name, names, name="phase")
        known = [BACKGROUND]

        def number(material: str) -> int:
            if material not in known:
                known.append(material)
            return known.index(material)

        labels = [*printed]
        labels += [names.index(n) for n in (*materials, *mixtures) if names.index(n) not in labels]
        makers: list[int | Mixture] = []
        for label in labels:
            name = names[label]
            if name in mixtures:
                share, first, second = mixtures[name]
                makers.append(Mixture(_checked(share, name), (number(first), number(second))))
            else:
                makers.append(number(materials.get(name, name)))
        if len(known) > len(COLOURS):
            raise InputError(
                f"{len(known) - 1} materials, there are colours for {len(COLOURS) - 1}: give "
                "several phases the same material"
            )
        return cls(tuple(labels), tuple(makers), tuple(known))

    @property
    def about(self) -> dict[str, Any]:
        """Return plain values: the colour of every material, and what makes each phase."""
        makers = [
            {"materials": list(maker.materials), "sha256": digest(maker.share)}
            if isinstance(maker, Mixture)
            else maker
            for maker in self.makers
        ]
        colours = dict(zip(self.materials, map(list, COLOURS), strict=False))
        return {"colours": colours, "makers": makers}

    def layer(self, sampler: LayerSampler, number: int, seed: int) -> np.ndarray:
        """Return the material of every droplet of a layer, (Y, X) uint8.

        The phase with the largest share of a pixel has it; the background is what is left.
        """
        shares = sampler.shares(number, self.phases)
        rest = 1 - shares.sum(axis=0)
        largest = shares.max(axis=0)
        solid = largest >= rest
        phase = shares.argmax(axis=0)
        chosen = np.zeros(solid.shape, np.uint8)
        for at, maker in enumerate(self.makers):
            inside = solid & (phase == at)
            if not isinstance(maker, Mixture):
                chosen[inside] = maker
            elif inside.any():
                second = _share_of(maker, sampler, number)
                stack = np.stack([1 - second, second])
                drops = diffuse(inside, stack, key(seed, f"layers/{at}"), number)
                chosen[inside] = np.array(maker.materials, np.uint8)[drops[inside]]
        return chosen


def _checked(share: Any, name: str) -> np.ndarray:
    values = np.asarray(getattr(share, "values", share), np.float32)
    if values.ndim != 3:
        raise InputError(
            f"the mixture of {quote(name)} has shape {values.shape}: give the share of the second "
            "material as a volume (z, y, x)"
        )
    if not np.isfinite(values).all() or values.min() < 0 or values.max() > 1:
        raise InputError(
            f"the mixture of {quote(name)} goes from {values.min():g} to {values.max():g}: give "
            "shares from 0 to 1"
        )
    return values


def _share_of(mixture: Mixture, sampler: LayerSampler, number: int) -> np.ndarray:
    """Interpolate the share of the second material on the droplets of a layer, (Y, X) float32."""
    edges = [side / count for side, count in zip(sampler.size, mixture.share.shape, strict=True)]
    along = []
    for axis, (edge, count) in enumerate(zip(edges, mixture.share.shape, strict=True)):
        places = np.array([number]) if axis == 0 else np.arange(sampler.shape[axis])
        centres = (places + 0.5) * sampler.pitch[axis]
        # beyond the outermost centres the share stays what it is there
        centres = np.clip(centres, edge / 2, (count - 0.5) * edge)
        along.append(AxisWeights.over(centres, edge, edge))
    first, weights = int(along[0].first[0]), along[0].weights[0]
    plane = sum(
        weight * mixture.share[first + tap] for tap, weight in enumerate(weights) if weight > 0
    )
    return average_plane(np.asarray(plane, np.float32)[None], along[1], along[2])[0]
