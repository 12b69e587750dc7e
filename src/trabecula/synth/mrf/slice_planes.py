"""Three planes at once: the scores of every level at some sites, from the densities of the slices
through them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.synth.mrf import decision_rules
from trabecula.synth.mrf.bias_feedback import Tables
from trabecula.synth.mrf.colouring import Classes
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.density import densities
from trabecula.synth.mrf.feedback import cells_of, pull
from trabecula.synth.mrf.gather import gather_confidence, gather_levels, gather_places, local_sums
from trabecula.synth.mrf.lattice import Lattice, marks_of
from trabecula.synth.mrf.limits import STEPS
from trabecula.synth.mrf.patch_distance import weigh
from trabecula.synth.mrf.patches import Source
from trabecula.synth.mrf.planes import Plane
from trabecula.synth.mrf.tables import LOGS, log_units

BATCH_OF_BITS, BATCH_OF_PRODUCTS = 1024, 128
"""Sites of a batch: what belongs to them stays in the cache."""

_MOST = 1 << 30


@dataclass(frozen=True)
class Face:
    """A view at one scale: its plane and what it learns from; `learner` numbers its statistics."""

    plane: Plane
    source: Source
    learner: int


class Frame:
    """The views that a sweep goes by.

    Parameters
    ----------
    faces : sequence of Face
    lattice : Lattice
    content : Content
    width : int
        Of the neighbourhoods.
    correction : float
        Setting `correction`.
    """

    def __init__(
        self,
        faces: Sequence[Face],
        lattice: Lattice,
        content: Content,
        *,
        width: int,
        correction: float,
    ) -> None:
        self.faces = tuple(faces)
        turned = any(any(face.plane.stretched) for face in faces)
        planes = [face.plane for face in faces]
        self.classes = Classes(lattice, width, turned=turned)
        self._lattice, self.content = lattice, content
        self._offsets = [(plane.offsets(width), plane.mirrored.offsets(width)) for plane in planes]
        self._blur = np.stack([face.source.blur for face in faces])
        self._prior = prior_of([face.source.marginal for face in faces], correction)

    @property
    def batch(self) -> int:
        """Sites that are done at a time."""
        return BATCH_OF_BITS if self.faces[0].source.bits is not None else BATCH_OF_PRODUCTS

    def scratch(self, count: int) -> np.ndarray:
        """Room for the products of a batch of so many sites; fresh pages for each would cost as
        much as its products.
        """
        bits = self.faces[0].source.bits is not None
        widest = 0 if bits else max(len(face.source.centres) for face in self.faces)
        return np.empty((min(self.batch, count), widest), np.float32)

    def densities(
        self,
        sites: np.ndarray,
        scratch: np.ndarray,
        temperature: np.ndarray,
        pulled: np.ndarray,
        bias: Tables,
        cells: np.ndarray,
        *,
        mirrored: bool = False,
    ) -> np.ndarray:
        """The logarithms of the views' densities (S, V, L) int64, in units.

        Parameters
        ----------
        sites : (S,) int64
        scratch : (S or more, n) float32
        temperature : (Z, Y, X) float32
            Empty where there is none.
        pulled : (S, L) int64
            What the feedback's `bias` (empty: none) says is added to it.
        cells : (V, S, C) uint8
            Where the local sums lie is written to it, where there is a bias.
        mirrored : bool
            Whether the pictures are seen from behind.
        """
        features = self.content.features
        bins = np.empty((len(sites), len(self.faces), len(features)), np.int64)
        for v, face in enumerate(self.faces):
            offsets = self._offsets[v][int(mirrored)]
            places = np.empty((len(sites), len(offsets)), np.int64)
            found, weight = np.empty(places.shape, np.uint8), np.empty(places.shape, np.uint8)
            gather_places(
                sites, offsets, self._lattice.shape, marks_of(self._lattice.there), places
            )
            gather_levels(places, self._lattice.levels, found, weight)
            if bias:
                sums = np.empty((len(sites), features.shape[1]), np.int32)
                local_sums(found, weight, features, sums)
                cells_of(sums, face.source.joint.edges, cells[v])
                pull(cells[v], bias[face.learner], self.content.groups, pulled)
            if temperature.size:
                gather_confidence(places, temperature, STEPS, weight)
            weigh(
                found,
                weight,
                STEPS if temperature.size else 1,
                face.source,
                features,
                v,
                bins,
                scratch,
            )
        share, log = np.empty(bins.shape, np.float64), np.empty(bins.shape, np.int64)
        densities(bins, self._blur, LOGS, share, log)
        return log

    def score(self, log: np.ndarray, pulled: np.ndarray, heuristic: str, score: np.ndarray) -> None:
        """One score (S, L) int32 of the views' logarithms and what is added to them: h2a or h2b."""
        total = np.empty(pulled.shape, np.int64)
        if heuristic == "h2a":
            decision_rules.least_of(log, pulled, total)
        else:
            decision_rules.combined(log, self._prior, pulled, total)
        score[:] = np.clip(total, -_MOST, _MOST)


def prior_of(marginals: Sequence[np.ndarray], power: float) -> np.ndarray:
    """(views - 1) times the logarithm of the views' mean marginal, times `power`, in units (L,).

    Given the centre, let what the views see besides it be independent: then by Bayes' rule the
    density given all of them is the product of theirs over the marginal to the power (views - 1).
    """
    share = np.mean([marginal / marginal.sum() for marginal in marginals], axis=0)
    floor = 0.5 / sum(int(marginal.sum()) for marginal in marginals)
    return np.rint((len(marginals) - 1) * power * log_units(np.maximum(share, floor))).astype(
        np.int64
    )
