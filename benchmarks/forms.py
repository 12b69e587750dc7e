"""Materials whose bodies have a form, made by their process: what `texture` keeps of it, and what
`verify` sees.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

import trabecula as tb
from common import asked, busy, table
from texture import KINDS, cells, fitted, judged, out_of_band, reference_of

SIDE, EXEMPLAR = 160, 96
SEEDS = (1, 2)
NAMES = ("shape", "S2 cov", "thickness", "Euler", "pore size", "coh(4)")


def texture_forms() -> None:
    """120^3 from 96^3 of materials of grains, fibres and tubes, by some settings, and another 96^3
    of the same material: the distance of the shape index and other figures, `!` out of band.
    """
    row = table("material, what", "out", "of", *NAMES, "CPU s", wide=36)
    for name in (one for one in asked("ONLY") or FORMS if one in FORMS):
        whole = made_form(name)
        exemplar, other = (tb.Image(np.ascontiguousarray(part), "labels") for part in ends(whole))
        reference = reference_of(exemplar)

        def line(words: str, image: tb.Image, seconds: str, name=name, reference=reference) -> None:
            metrics = judged(reference, image)
            row(f"{name}, {words}", *out_of_band(metrics), *cells(metrics, NAMES), seconds)

        line("another part", other, "")
        for kind, settings in KINDS.items():
            model = fitted(exemplar, settings)
            for seed in SEEDS:
                seconds, made = busy(lambda m=model, s=seed: m.generate(120, seed=s))
                line(f"{kind}, {seed}", made, f"{seconds:.1f}")


def ends(whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two corners that share an eighth of their voxels at most."""
    return whole[(slice(EXEMPLAR),) * 3], whole[(slice(-EXEMPLAR, None),) * 3]


def _grains(draw: np.random.Generator) -> np.ndarray:
    """Spheres that were pressed together and cemented: concave pores between them."""
    field = ndimage.gaussian_filter(_depth(draw, 11, 0.12, 0.62).clip(-4, 4), 1, mode="wrap")
    return field < np.quantile(field, 0.8)


def _beads(draw: np.random.Generator) -> np.ndarray:
    """Touching spheres."""
    return _depth(draw, 8, 0.05, 0.58) < 0


def _suspension(draw: np.random.Generator) -> np.ndarray:
    """Spheres of several sizes that hardly touch."""
    return _depth(draw, 7, 0.25, 0.28) < 0


def _fibres(draw: np.random.Generator) -> np.ndarray:
    """Long straight fibres that lie in planes across z, as in a gas diffusion layer."""
    at = np.stack(np.indices((SIDE,) * 3), -1).astype(np.float32)
    distance = np.full((SIDE,) * 3, np.inf, np.float32)
    for _ in range(int(0.25 * SIDE**2 / (np.pi * 4**2))):
        angle = draw.uniform(0, np.pi)
        way = np.array([draw.normal(0, 0.08), np.cos(angle), np.sin(angle)], np.float32)
        way /= np.linalg.norm(way)
        off = at - draw.uniform(0, SIDE, 3).astype(np.float32)
        off[..., 0] = (off[..., 0] + SIDE / 2) % SIDE - SIDE / 2
        along = off @ way
        np.minimum(distance, (off**2).sum(-1) - along**2, out=distance)
    return distance < np.quantile(distance, 0.25)


def _tubes(draw: np.random.Generator) -> np.ndarray:
    """Walls of tubes along z that wander a little, as in wood."""
    count = SIDE**2 // 14**2
    spots = _spread_evenly(draw.uniform(0, SIDE, (count, 2)), draw)
    drift = np.cumsum(draw.normal(0, 0.12, (SIDE, count, 2)), axis=0)
    places = np.stack(np.indices((SIDE, SIDE)), -1).reshape(-1, 2)
    walls = np.empty((SIDE, SIDE, SIDE), np.float32)
    for z in range(SIDE):
        near, _ = cKDTree((spots + drift[z]) % SIDE, boxsize=SIDE).query(places, k=2)
        walls[z] = (near[:, 1] - near[:, 0]).reshape(SIDE, SIDE)
    return walls < np.quantile(walls, 0.35)


FORMS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "cemented grains": _grains,
    "beads": _beads,
    "suspension": _suspension,
    "fibres": _fibres,
    "tubes": _tubes,
}


def made_form(name: str) -> np.ndarray:
    """Return a material of `FORMS`, uint8."""
    return FORMS[name](np.random.default_rng(0)).astype(np.uint8)


def _depth(draw: np.random.Generator, radius: float, spread: float, share: float) -> np.ndarray:
    """Return the distance to the nearest of spheres that share the volume and were pushed apart,
    negative inside.
    """
    count = int(share * SIDE**3 / (4 / 3 * np.pi * radius**3))
    centres = draw.uniform(0, SIDE, (count, 3))
    radii = radius * np.exp(spread * draw.standard_normal(count))
    for _ in range(200):
        tree = cKDTree(centres % SIDE, boxsize=SIDE)
        first, second = tree.query_pairs(2 * radii.max(), output_type="ndarray").T
        apart = _around(centres[first] - centres[second])
        length = np.linalg.norm(apart, axis=1) + 1e-9
        over = np.maximum(radii[first] + radii[second] - length, 0)
        if not over.any():
            break
        push = (0.3 * over / length)[:, None] * apart
        np.add.at(centres, first, push)
        np.add.at(centres, second, -push)
    return _distance_to(centres % SIDE, radii)


def _distance_to(centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return the distance to the surfaces of spheres in a box that repeats, 9 voxels at most."""
    distance = np.full((SIDE,) * 3, 9.0, np.float32)
    for centre, radius in zip(centres, radii, strict=True):
        near = [np.arange(int(c - radius - 9), int(c + radius + 10)) for c in centre]
        offsets = np.ix_(*(line - c for line, c in zip(near, centre, strict=True)))
        own = np.sqrt(sum(offset**2 for offset in offsets)) - radius
        box = np.ix_(*(line % SIDE for line in near))
        distance[box] = np.minimum(distance[box], own)
    return distance


def _around(offset: np.ndarray) -> np.ndarray:
    """Return offsets in a box that repeats as the shortest of them."""
    return (offset + SIDE / 2) % SIDE - SIDE / 2


def _spread_evenly(spots: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """Move spots in a square that repeats to the middle of their cells, five times (Lloyd)."""
    places = draw.uniform(0, SIDE, (20_000, 2))
    for _ in range(5):
        _, owner = cKDTree(spots, boxsize=SIDE).query(places)
        off = _around(places - spots[owner])
        count = np.maximum(np.bincount(owner, minlength=len(spots)), 1)
        mean = [np.bincount(owner, line, len(spots)) / count for line in off.T]
        spots = (spots + np.stack(mean, axis=1)) % SIDE
    return spots
