"""Settings of `texture`: the only home of its defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.synth.shared.settings import keep_choices, keep_numbers, keep_rounds


@dataclass(frozen=True)
class TextureConfig:
    """Settings of `texture`. Voxels are those of the level in question unless said otherwise."""

    neighbourhood: tuple[int, ...] = (8,)
    """Widths w of the cubic neighbourhoods, voxels, each 4 .. 10, used one after another on every
    level (sections 4.1, 5.1). Larger ones keep more structure and copy more."""

    step: int = 2
    """Distance t between neighbourhoods on all but the coarsest level, voxels, 1 .. w / 2 (section
    4.1; 1 on the coarsest). 0 stands for `step_share` of the width on every level."""

    step_share: float = 0.5
    """Share of the width that a `step` of 0 stands for, .25 .. .9. The more neighbourhoods overlap,
    the more is averaged away where they do not match yet."""

    levels: int = 6
    """Resolutions at most, each half the next, 1 .. 8 (section 5.1: two). As many are used as leave
    room for a neighbourhood in the exemplar: the coarsest has to see its largest structures, or the
    density of the result drifts."""

    novelty: float | None = None
    """The dial, 0 .. 1, between moving patches of the exemplar (0) and copying no more than an
    independent sample of the material does (1). Default: 1; 0 with the paper's search, field or
    energies, which know no other. Grey values and colours above 0: their structure is made as
    labels, then painted."""

    layout: str = "rounds"
    """How new material begins. "rounds": with noise on the level that fits the exemplar's
    structure, and rounds of search and vote there; its small bodies are counted in the end, and
    grey values and colours are on a structure of their own. "structure": with sliced rounds, which
    lose shapes, as the default was before. "coarse": with sliced rounds on the coarsest level,
    without the counts, as recipes and models have it that do not name it."""

    scan_phases: str = "found"
    """What new grey values and colours are painted on. "found": on two phases, or on three where
    the scan's gradients tell so many, with levels that know thin bodies from thick ones. "two": on
    two, split by Otsu's threshold, as recipes and models have it that do not name it."""

    first_rounds: int = 20
    """Rounds of search and vote on the coarsest level, which starts from random patches, 1 .. 100
    (section 5.1: up to 30).
    """

    rounds: tuple[int, ...] = (4, 6, 8, 12)
    """Rounds on the other levels, finest first, each 1 .. 100; the last counts for the rest."""

    grading: str = "held"
    """How a target that holds around every place is met. "held": new material, held to it on every
    coarse level (`held_fractions`); from patches, where nothing new can be laid out, as "feedback".
    "feedback": from patches, the search is led towards denser or sparser places of the exemplar by
    what is missing, and interfaces of the last result are moved. "shift": by shifts of the field
    alone, as in recipes and models that do not name it."""

    connected: str = "auto"
    """Whether the solid becomes one component where a target holds around every place: "solid", or
    "none". "auto": where nine tenths of the exemplar's solid are one. Recipes and models that do
    not name it: "none"."""

    clip: float = 4.2
    """Signed distance at which the field saturates, voxels, 2 .. 20. Longer reach feels wider
    pores, shorter resolves struts.
    """

    variance: float = 0.95
    """Share of the neighbourhoods' variance that the principal components keep, 0.5 .. 1 (section
    4.2).
    """

    components: int = 32
    """At most so many principal components, 4 .. 128."""

    sweeps: int = 2
    """Search sweeps per round, 1 .. 10."""

    tries: int = 4
    """Pairs of random candidates per neighbourhood and sweep, 0 .. 64: one anywhere, one around the
    best, ever nearer.
    """

    index_penalty: float = 0.05
    """Weight of the index histogram in the search, 0 .. 1 (section 4.2): how much being chosen too
    often adds to a distance.
    """

    robustness: float = 0.8
    """Exponent r of the vote's weights d^(r - 2), 0 .. 2 (section 4.3); 2 is plain least squares.
    """

    vote_power: float = 0.0
    """With novelty: the power to which the finest level's distances are raised before they are
    averaged, 0 .. 4. Below 1 thin joins outlive a vote, above 1 they are smoothed away. 0 stands
    for 1 where `interface_rounds` meet Euler numbers in the end, else for the power that leaves
    these nearest to the exemplar's. Recipes and models that do not name it: 1."""

    interface_rounds: int = 2
    """With novelty: rounds over the voxels of interfaces in the end, 0 .. 10, in which single ones
    change their phase until chords, cubes of voxels and neighbours occur as often as in the
    exemplar. Of two phases, and of three without a target from exemplars of 62^3 on. Recipes
    and models that do not name it: 0."""

    interface_balls: bool = True
    """Whether `interface_rounds` also bring to the exemplar's how full of a phase balls of 4 and 8
    voxels' radius are, where there are neither a target nor known voxels: bodies and pores of
    several voxels are as wide as there. Recipes and models that do not name it: False."""

    beyond_known: float = 0.7
    """Beside known voxels: how far a known voxel of labels is taken to be from an interface beyond
    the joint, at least, over the farthest that it may be, 0 .. 1. With 0 nothing is taken, and
    bodies end in the joint. Recipes and models that do not name it: 0."""

    field: str = "distance"
    """The field of labels: "distance", the clipped signed distance of every phase, or "indicator",
    its 0 and 1 as the paper's grey levels. Grey values and colours are what they are."""

    histogram: bool = True
    """Whether every round matches the histogram of the field to the exemplar's, and the result
    holds its volume fractions."""

    iso_value: str = "middle"
    """Where labels are split if `histogram` does not hold: at the "middle" of the field, which is
    the exemplar's own iso-value (section 3), or at that of the exemplar's volume "fraction"; then
    grey values and colours have the exemplar's histogram in the end, thus every iso-value holds."""

    search: str = "coherent"
    """"coherent": each site tries its own match, its neighbours' moved along, and random ones.
    "leaves", with novelty that begins with noise: on coarse levels those of a leaf of a tree
    before, in more rounds, and wide neighbourhoods first on the finest one; beads, fibres and cells
    come nearer to the exemplar's, thin struts have wider pores between them, and it takes a third
    longer; else as "coherent". "exact": the `nearest` nearest neighbourhoods, ordered again by the
    index histogram (section 4.2)."""

    nearest: int = 10
    """k, the nearest neighbourhoods that the exact search looks at, 1 .. 100 (section 4.2)."""

    orientations: str = "none"
    """Copies of the exemplar to learn from besides itself (section 5.1): "none", "mirrors" (8),
    "upright" (16, that keep the first axis), "all" (48)."""

    gradient: float = 0.0
    """mu, the weight of the gradient energy beside that of the values, 0 .. 100 (equation 1);
    smaller for thin features.
    """

    adaptive: bool = False
    """Whether lambda follows the energy (equation 2). It acts through the gradient energy only:
    alone it cancels.
    """

    increase: float = 0.05
    """epsilon_i, by how much lambda rises where the energy fell, 0 .. 1 (equation 2)."""

    decrease: float = 0.3
    """epsilon_d, by how much lambda falls where the energy rose, 0 .. 0.9 (equation 2)."""

    corrections: tuple[int, ...] = (0,)
    """Steps towards the exemplar's two-point function after every round at novelty 0, finest level
    first, each 0 .. 10; the last counts for the rest. With novelty they are part of it, beside
    fixed voxels there are none."""

    tolerance: float = 0.0
    """Relative change of the energy at which a level is left before its rounds are used up, 0 ..
    0.1 (section 4.3); 0: never.
    """

    trim: int = 1
    """Voxels at the rim of a neighbourhood that do not vote on the finest level, 0 .. (w - t) / 2:
    less averaging.
    """

    def __post_init__(self) -> None:
        keep_numbers(self, _RANGES)
        if self.novelty is not None:
            novelty = as_number(self.novelty, name="novelty", low=0, high=1)
            object.__setattr__(self, "novelty", novelty)
        widths = "the widths, largest first, such as [10, 7, 4]"
        keep_rounds(self, "neighbourhood", low=4, high=10, advice=widths)
        keep_rounds(self, "corrections", low=0, high=10)
        keep_rounds(self, "rounds", high=100)
        keep_choices(self, _CHOICES)
        narrowest = min(self.neighbourhood)
        keep_numbers(self, {"step": (0, narrowest // 2)})
        keep_numbers(self, {"trim": (0, (narrowest - self.step_of(narrowest)) // 2)})

    def step_of(self, width: int) -> int:
        """Return the distance between neighbourhoods of a width."""
        return self.step or int(width * self.step_share)

    def novelty_for(self, *, labels: bool) -> float:
        """Return the dial, or its default for exemplars of labels or of grey values and colours.

        Raises
        ------
        InputError
            Novelty is set where it does not apply.
        """
        distances = self.field == "distance" and (labels or self.layout != "coarse")
        new = self.search != "exact" and self.histogram
        applies = distances and new and not self.energetic
        if self.novelty and not applies:
            raise InputError(
                f"novelty={self.novelty:g} is for search=coherent or leaves, field=distance, "
                "histogram and no energies, with layout=coarse for labels alone: give novelty=0, "
                "or leave the others out"
            )
        return (_NOVELTY if applies else 0.0) if self.novelty is None else self.novelty

    @property
    def energetic(self) -> bool:
        """Return whether rounds follow the energy of equation (1) rather than the plain vote."""
        return self.gradient > 0 or self.adaptive or self.tolerance > 0

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        before = {"layout": "coarse", "iso_value": "middle", "step_share": 0.5}
        later = {"grading": "shift", "connected": "none", "scan_phases": "two", "vote_power": 1.0}
        later |= {"beyond_known": 0.0, "interface_rounds": 0, "interface_balls": False}
        known = {name: value for name, value in settings.items() if name not in _DROPPED}
        return {**before, **later, **known}

    def alternatives(self, effort: int) -> tuple[dict[str, Any], ...]:
        """List settings to try beside these, of `effort` 2 or 3: leaves only where material begins
        with noise.
        """
        offered = _ALTERNATIVES if effort > 2 else _ALTERNATIVES[:2]
        noise = self.layout == "rounds" and self.novelty != 0
        return tuple(settings for settings in offered if noise or "search" not in settings)

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return dict(_PRESETS[name])


_NOVELTY = 1.0
_DROPPED = ("schedule",)  # of recipes of before, when there were two

_ALTERNATIVES: tuple[dict[str, Any], ...] = (
    {"search": "leaves"},
    {"layout": "structure"},
    {"novelty": 0.5},
    {"layout": "coarse"},
    {"novelty": 0.25},
    {"layout": "structure", "novelty": 0.5},
)

_CHOICES: dict[str, tuple[Any, ...]] = {
    "histogram": (True, False),
    "interface_balls": (True, False),
    "adaptive": (True, False),
    "field": ("distance", "indicator"),
    "iso_value": ("middle", "fraction"),
    "search": ("coherent", "leaves", "exact"),
    "layout": ("rounds", "structure", "coarse"),
    "scan_phases": ("found", "two"),
    "grading": ("held", "feedback", "shift"),
    "connected": ("auto", "solid", "none"),
    "orientations": ("none", "mirrors", "upright", "all"),
}

_PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"novelty": 0.0, "first_rounds": 14, "rounds": (2, 4, 6), "sweeps": 1, "tries": 2},
    "best": {
        "novelty": 0.0,
        "first_rounds": 20,
        "rounds": (2, 6, 8),
        "sweeps": 1,
        "tries": 2,
        "corrections": (1,),
    },
    "paper": {
        "novelty": 0.0,
        "neighbourhood": (10, 8, 4),
        "step": 0,
        "step_share": 0.8,
        "levels": 2,
        "first_rounds": 30,
        "rounds": (30,),
        "variance": 0.99,
        "components": 128,
        "trim": 0,
        "histogram": False,
        "iso_value": "fraction",
        "search": "exact",
        "gradient": 0.1,
        "adaptive": True,
        "tolerance": 0.02,
    },
}

_RANGES = {
    "step_share": (0.25, 0.9),
    "levels": (1, 8),
    "first_rounds": (1, 100),
    "clip": (2, 20),
    "variance": (0.5, 1),
    "components": (4, 128),
    "sweeps": (1, 10),
    "tries": (0, 64),
    "index_penalty": (0, 1),
    "robustness": (0, 2),
    "vote_power": (0, 4),
    "interface_rounds": (0, 10),
    "beyond_known": (0, 1),
    "nearest": (1, 100),
    "gradient": (0, 100),
    "increase": (0, 1),
    "decrease": (0, 0.9),
    "tolerance": (0, 0.1),
}
