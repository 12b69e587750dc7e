"""Settings of `texture`: the only home of its defaults."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.core.errors import InputError


@dataclass(frozen=True)
class TextureConfig:
    """Settings of `texture`. Voxels are those of the level in question unless said otherwise."""

    neighbourhood: int = 8
    """Width w of the cubic neighbourhood, voxels, 4 .. 10 (section 4.1). Larger keeps more structure and copies more."""

    step: int = 2
    """Distance t between neighbourhoods on all but the coarsest level, voxels, 1 .. w / 2 (section 4.1; 1 on the coarsest)."""

    levels: int = 6
    """Resolutions at most, each half the next, 1 .. 8 (section 5.1: two). As many are used as leave room for a neighbourhood in
    the exemplar: the coarsest has to see its largest structures, or the density of the result drifts."""

    first_rounds: int = 20
    """Rounds of search and vote on the coarsest level, which starts from random patches, 1 .. 100 (section 5.1: up to 30)."""

    rounds: tuple[int, ...] = (4, 6, 8, 12)
    """Rounds on the other levels, finest first, each 1 .. 100; the last counts for the rest."""

    clip: float = 5.0
    """Signed distance at which the field saturates, voxels, 2 .. 20. Longer reach feels wider pores, shorter resolves struts."""

    variance: float = 0.95
    """Share of the neighbourhoods' variance that the principal components keep, 0.5 .. 1 (section 4.2)."""

    components: int = 32
    """At most so many principal components, 4 .. 128."""

    sweeps: int = 2
    """Search sweeps per round, 1 .. 10."""

    tries: int = 8
    """Random candidates per neighbourhood and sweep, 0 .. 64: half anywhere, half around the best with a shrinking radius."""

    index_penalty: float = 0.05
    """Weight of the index histogram in the search, 0 .. 1 (section 4.2): how much being chosen too often adds to a distance."""

    robustness: float = 0.8
    """Exponent r of the vote's weights d^(r - 2), 0 .. 2 (section 4.3); 2 is plain least squares."""

    trim: int = 1
    """Voxels at the rim of a neighbourhood that do not vote on the finest level, 0 .. (w - t) / 2: less averaging."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "rounds", tuple(int(count) for count in _as_sequence(self.rounds)))
        _check_range(self, "neighbourhood", 4, 10)
        _check_range(self, "step", 1, self.neighbourhood // 2)
        _check_range(self, "levels", 1, 8)
        _check_range(self, "first_rounds", 1, 100)
        _check_range(self, "clip", 2, 20)
        _check_range(self, "variance", 0.5, 1)
        _check_range(self, "components", 4, 128)
        _check_range(self, "sweeps", 1, 10)
        _check_range(self, "tries", 0, 64)
        _check_range(self, "index_penalty", 0, 1)
        _check_range(self, "robustness", 0, 2)
        _check_range(self, "trim", 0, (self.neighbourhood - self.step) // 2)
        if not self.rounds or not all(1 <= count <= 100 for count in self.rounds):
            raise InputError(f"rounds {self.rounds} should be whole numbers from 1 to 100, finest level first")


def _as_sequence(value: object) -> list[int]:
    try:
        return list(value)  # type: ignore[call-overload]
    except TypeError:
        return [value]  # type: ignore[list-item]


def _check_range(config: TextureConfig, name: str, low: float, high: float) -> None:
    value = getattr(config, name)
    whole = isinstance(getattr(TextureConfig, name), int)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or (whole and value != int(value)):
        raise InputError(f"{name}={value!r} should be {'a whole' if whole else 'a'} number from {low} to {high}")
    if not low <= value <= high:
        raise InputError(f"{name}={value} is outside {low} .. {high}")
