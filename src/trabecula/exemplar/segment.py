"""Grey to labels by a threshold: given, found by Otsu's criterion, or a pair of thresholds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import check_name, check_type, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, distinct_levels, with_values
from trabecula.measure.components import label_components

METHODS = ("otsu", "dual")
_BINS = 1024
_PIECE = 1 << 22  # voxels counted at once: bincount widens them to 8 bytes each
_LARGEST = 1e150  # its square is still a number


def segment(
    image: Image,
    threshold: float | Sequence[float] | str = "otsu",
    *,
    phases: Sequence[str] = ("void", "solid"),
) -> Image:
    """Segment a grey image: label 1 (the second of `phases`) where it is brighter than a threshold.

    Parameters
    ----------
    image : Image
        Grey.
    threshold : float, pair of float, or {"otsu", "dual"}
        A number: brighter voxels are solid. A pair (low, high): voxels brighter than `low` that
        are connected (by faces) to one brighter than `high` are solid, so that thin, dim struts
        are kept and dim specks are not. "otsu" finds the number (Otsu 1979,
        doi:10.1109/TSMC.1979.4310076), "dual" the pair, by the same criterion with three classes.
        Two thresholds are what Buie et al. (2007, doi:10.1016/j.bone.2007.07.007) use and Zhang et
        al. (2017) cite; Buie's further steps, which split bone into cortical and trabecular
        compartments, have no use here.
    phases : pair of str
        Names of the darker and the brighter phase.

    Returns
    -------
    Image
        Labels. The recipe's last step holds the threshold, found or given.

    Raises
    ------
    InputError
        The image is not grey, has one value only, or the threshold leaves one phase only.
    """
    check_type(image, Image, name="image", advice="give tb.Image(array, kind='grey')")
    if image.kind != "grey":
        raise InputError(f"segment takes a grey image, got {image.kind}")
    values = np.asarray(image.values)
    low, high = float(values.min()), float(values.max())
    if low == high:
        raise InputError(f"the image has one value only ({low:g}): there is nothing to segment")
    found = _thresholds(values, threshold)
    solid = values > np.float64(found[0]) if len(found) == 1 else _hysteresis(values, found)
    if not solid.any() or solid.all():
        raise InputError(
            f"threshold {_text(found)} leaves one phase only: the image runs from {low:g} to "
            f"{high:g}"
        )
    labels = solid.astype(np.uint8)
    recorded = found[0] if len(found) == 1 else list(found)
    recipe = image.recipe.then(
        "segment",
        labels,
        threshold=recorded,
        found_by=threshold if isinstance(threshold, str) else "given",
        phases=tuple(phases),
    )
    return with_values(image, labels, recipe=recipe, kind="labels", phases=tuple(phases))


def otsu(values: np.ndarray, *, classes: int = 2) -> tuple[float, ...]:
    """Return thresholds that split values into 2 or 3 classes of greatest between-class variance
    (Otsu 1979, eq. 18).
    """
    levels, counts = _histogram(values)
    share = counts / counts.sum()
    weight = np.concatenate([[0.0], np.cumsum(share)])
    # About the mean, or a large offset would cost the digits that tell the classes apart.
    moment = np.concatenate([[0.0], np.cumsum(share * (levels - np.sum(share * levels)))])

    def spread(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        # weight times squared mean of the class of bins first..last-1: its part of the
        # between-class variance
        w = weight[last] - weight[first]
        return np.where(w > 0, (moment[last] - moment[first]) ** 2 / np.where(w > 0, w, 1), 0.0)

    cut = np.arange(1, len(levels))
    end = np.full_like(cut, len(levels))
    if classes == 2:
        best = cut[np.argmax(spread(np.zeros_like(cut), cut) + spread(cut, end))]
        return (_between(levels, best),)
    i, j = np.meshgrid(cut, cut, indexing="ij")
    score = (
        spread(np.zeros_like(i), i)
        + spread(i, np.maximum(i, j))
        + spread(j, np.full_like(j, len(levels)))
    )
    score[j <= i] = -np.inf
    a, b = np.unravel_index(np.argmax(score), score.shape)
    return _between(levels, cut[a]), _between(levels, cut[b])


def _thresholds(values: np.ndarray, threshold: float | Sequence[float] | str) -> tuple[float, ...]:
    if isinstance(threshold, str):
        check_name(threshold, METHODS, name="way to find a threshold")
        if max(abs(float(values.min())), abs(float(values.max()))) > _LARGEST:
            raise InputError(
                f"the image holds values beyond {_LARGEST:g}: rescale it, or give a threshold as a "
                "number"
            )
        return otsu(values, classes=2 if threshold == "otsu" else 3)
    try:
        found = tuple(float(number) for number in np.atleast_1d(threshold))
    except (TypeError, ValueError):
        raise InputError(
            f"threshold {quote(threshold)} should be a number, a pair (low, high), 'otsu' or 'dual'"
        ) from None
    if len(found) not in (1, 2) or not np.all(np.isfinite(found)) or sorted(found) != list(found):
        raise InputError(
            f"threshold {_text(found)} should be one finite number, or a pair (low, high)"
        )
    return found


def _hysteresis(values: np.ndarray, thresholds: tuple[float, ...]) -> np.ndarray:
    low, high = (np.float64(threshold) for threshold in thresholds)
    components, sizes = label_components(values > low)
    kept = np.zeros(len(sizes) + 1, bool)
    kept[np.unique(components[values > high])] = True
    kept[0] = False
    return kept[components]


def _histogram(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the levels in rising order and the count of each; more than 1024 levels are binned."""
    levels = distinct_levels(values, limit=_BINS)
    if levels is not None:
        return levels.astype(np.float64), _count_levels(values.ravel(), levels)
    # In float16 the edges of 1024 bins would coincide.
    counts, edges = np.histogram(
        values.astype(np.float32) if values.dtype == np.float16 else values, bins=_BINS
    )
    centres = (edges[:-1] + edges[1:]) / 2
    used = np.flatnonzero(counts)
    return centres[used], counts[used]


def _count_levels(flat: np.ndarray, levels: np.ndarray) -> np.ndarray:
    total = np.zeros(len(levels), np.int64)
    for start in range(0, flat.size, _PIECE):
        total += np.bincount(
            np.searchsorted(levels, flat[start : start + _PIECE]), minlength=len(levels)
        )
    return total


def _between(levels: np.ndarray, cut: int) -> float:
    low, high = float(levels[cut - 1]), float(levels[cut])
    middle = low + (high - low) / 2
    # of two neighbouring numbers the middle rounds to one of them
    return middle if middle < high else low


def _text(thresholds: Sequence[float]) -> str:
    return ", ".join(f"{number:g}" for number in thresholds)
