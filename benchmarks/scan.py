"""`scan`: is a segmenter that was trained on our scans as good as one trained on the real one?

Half of a real scan trains, the other half tests. The segmenter is a logistic regression on nine
features of a voxel's surroundings, in NumPy; where scikit-learn is installed, a random forest too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import trabecula as tb
from common import table
from descriptors import SCANS
from trabecula.finish import ScanModel, fit_scan, scan
from trabecula.measure.smooth import gaussian

CASES = {"bone": "trabecular_bone_grey_lhdl.tif"}
VOXELS = 30_000
"""Voxels that a segmenter is trained on."""

SEEDS = (0, 1, 2)


def segmenters() -> None:
    """Dice of the bright phase of the half of a scan that no segmenter has seen; three seeds.

    Truth: `smoothed` is Otsu's threshold of the scan after a Gaussian of 1 voxel, specks below 30
    voxels removed; `plain` is Otsu's threshold of the scan itself. Nobody labelled these by hand.
    """
    if not SCANS.is_dir():
        print("the real scans are not here: nothing to compare with")
        return
    for name, file in CASES.items():
        grey = tb.read(SCANS / file)
        cut = grey.shape[0] // 2
        for truth, label in (("smoothed", smoothed), ("plain", plain)):
            labels = label(grey)
            pair = (grey[:cut], labels[:cut])
            _compare(f"{name}, {truth}", pair, (grey[cut:], labels[cut:]), label)


def smoothed(grey: tb.Image) -> tb.Image:
    """Return labels by Otsu's threshold after a Gaussian, without specks."""
    values = tb.Image(gaussian(grey.values, 1.0), "grey", grey.spacing, grey.unit)
    labels = tb.segment(values, "otsu").values
    found = tb.measure.label_components(labels == 1)
    return tb.Image(_without_specks(found), "labels", grey.spacing, grey.unit)


def plain(grey: tb.Image) -> tb.Image:
    """Return labels by Otsu's threshold."""
    return tb.segment(grey, "otsu")


def _without_specks(found: Any, least: int = 30) -> np.ndarray:
    numbers = np.asarray(found[0] if isinstance(found, tuple) else found)
    sizes = np.bincount(numbers.ravel())
    sizes[0] = 0
    return (sizes >= least)[numbers].astype(np.uint8)


def _compare(
    name: str,
    train: tuple[tb.Image, tb.Image],
    test: tuple[tb.Image, tb.Image],
    label: Callable[[tb.Image], tb.Image],
) -> None:
    grey, labels = train
    model = fit_scan(grey, labels)
    print(f"model: levels {model.levels}, blur {model.blur}, inset {model.inset}")
    like_texture = tb.method("texture").fit(labels)
    makers: dict[str, Callable[[int], tuple[tb.Image, tb.Image]]] = {
        "real scan, real labels": lambda seed: train,
        "its labels, our scan": lambda seed: (scan(labels, model=model, seed=seed), labels),
        "our labels, our scan": lambda seed: _made(like_texture, model, labels.shape, seed),
        "sample bone, our scan": lambda seed: (
            scan(tb.sample("bone").values, model=model, seed=seed),
            tb.sample("bone"),
        ),
        "our labels, white noise": lambda seed: _made(
            like_texture, _naive(model), labels.shape, seed
        ),
    }
    row = table(name, *("Dice", "range", "forest"), wide=26)
    for kind, make in makers.items():
        found = [_dice(Logistic().fit(*_sample(*make(seed), seed)), *test) for seed in SEEDS]
        forest = _forest(make, test)
        spread = f"{min(found):.4f} .. {max(found):.4f}"
        row(kind, f"{np.mean(found):.4f}", spread, "" if forest is None else f"{forest:.4f}")
    print()


def _naive(model: ScanModel) -> ScanModel:
    """Return the model without blur and with white noise: what is often done."""
    white = (((1.0,),) * 3,) * len(model.levels)
    return ScanModel(model.levels, 0.0, model.noise, white, dtype=model.dtype)


def _made(
    learned: Any, model: ScanModel, shape: tuple[int, ...], seed: int
) -> tuple[tb.Image, tb.Image]:
    labels = learned.generate(shape, seed=seed)
    return scan(labels, model=model, seed=seed), labels


def features(grey: tb.Image) -> np.ndarray:
    """Return what the surroundings of every voxel say, (voxels, 9): values smoothed over 0, 1, 2
    and 4 voxels, slopes and curvatures at two scales, and a spread.
    """
    values = grey.values.astype(np.float32)
    found = [values]
    for sigma in (1.0, 2.0, 4.0):
        found.append(gaussian(values, sigma))
    for sigma in (1.0, 2.0):
        even = gaussian(values, sigma)
        slopes = [np.gradient(even, axis=axis) for axis in range(3)]
        found.append(np.sqrt(sum(slope**2 for slope in slopes)))
        found.append(sum(np.gradient(slope, axis=axis) for axis, slope in enumerate(slopes)))
    square = gaussian(values**2, 1.5) - gaussian(values, 1.5) ** 2
    found.append(np.sqrt(np.maximum(square, 0)))
    return np.stack([one.ravel() for one in found], axis=1)


def _sample(grey: tb.Image, labels: tb.Image, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return features and labels of some voxels, as many of each phase."""
    rng = np.random.default_rng(seed)
    flat = labels.values.ravel() == 1
    at = [rng.choice(np.flatnonzero(flat == kind), VOXELS // 2) for kind in (False, True)]
    chosen = np.concatenate(at)
    return features(grey)[chosen], flat[chosen]


class Logistic:
    """Logistic regression on features, their squares and products, by Newton's method."""

    def fit(self, given: np.ndarray, labels: np.ndarray) -> Logistic:
        """Learn from features and labels."""
        self.middle, self.wide = given.mean(axis=0), given.std(axis=0) + 1e-9
        design = self._design(given)
        weights = np.zeros(design.shape[1])
        ridge = 1e-3 * len(design) * np.eye(len(weights))
        for _ in range(20):
            share = 1 / (1 + np.exp(-np.clip(design @ weights, -30, 30)))
            slope = design.T @ (labels - share) - ridge @ weights
            curve = (design * (share * (1 - share))[:, None]).T @ design + ridge
            weights += np.linalg.solve(curve, slope)
        self.weights = weights
        return self

    def predict(self, given: np.ndarray) -> np.ndarray:
        """Return the labels of features."""
        return np.concatenate(
            [self._design(part) @ self.weights > 0 for part in np.array_split(given, 32)]
        )

    def _design(self, given: np.ndarray) -> np.ndarray:
        unit = ((given - self.middle) / self.wide).clip(-8, 8).astype(np.float64)
        pairs = [unit[:, i] * unit[:, j] for i in range(unit.shape[1]) for j in range(i + 1)]
        return np.column_stack([np.ones(len(unit)), unit, *pairs])


def _dice(learned: Any, grey: tb.Image, labels: tb.Image) -> float:
    found = np.asarray(learned.predict(features(grey)), bool)
    true = labels.values.ravel() == 1
    return float(2 * np.count_nonzero(found & true) / (found.sum() + true.sum()))


def _forest(
    make: Callable[[int], tuple[tb.Image, tb.Image]], test: tuple[tb.Image, tb.Image]
) -> float | None:
    """Return the Dice of a random forest of the first seed; None without scikit-learn."""
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError:
        return None
    learned = RandomForestClassifier(30, min_samples_leaf=5, random_state=0)
    learned.fit(*_sample(*make(SEEDS[0]), SEEDS[0]))
    return _dice(learned, *test)
