"""The least of a function of a few numbers without its slope: Hooke and Jeeves (1961),
doi:10.1145/321062.321069.

Each number is tried one step up and one step down, and what is better is kept; a round that helped
is done again as a leap, and one that did not halves the steps. Where to begin is looked for among
points spread evenly (Halton 1960, doi:10.1007/BF01386213).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Scale:
    """A number that is searched for.

    Attributes
    ----------
    name : str
    low, high : float
        Its range.
    step : float
        Of the first round; all are halved together.
    """

    name: str
    low: float
    high: float
    step: float


_PRIMES = (2, 3, 5, 7, 11, 13, 17)

Point = tuple[float, ...]


@dataclass
class Search:
    """A search that remembers where it was.

    Attributes
    ----------
    cost : callable
        Of a point, the less the better.
    scales : sequence of Scale
    most : int
        Points that may be tried.
    tried : dict
        Cost by point, in the order of trials.
    """

    cost: Callable[[Point], float]
    scales: Sequence[Scale]
    most: int
    tried: dict[Point, float] = field(default_factory=dict)

    @property
    def over(self) -> bool:
        """Whether all trials are used up."""
        return len(self.tried) >= self.most

    def at(self, point: Sequence[float]) -> tuple[float, Point]:
        """The cost of a point moved into the ranges, and that point; infinite where no trial is
        left.
        """
        inside = tuple(min(max(x, s.low), s.high) for x, s in zip(point, self.scales, strict=True))
        if inside not in self.tried:
            if self.over:
                return float("inf"), inside
            self.tried[inside] = self.cost(inside)
        return self.tried[inside], inside

    def run(self, starts: Sequence[Sequence[float]], *, halvings: int = 3) -> None:
        """Look for the least cost: from the best start until steps are small, then from the next
        one while trials are left.
        """
        costs = sorted(self.at(start) for start in starts)
        for begun in costs:
            best, share, signs = begun, 1.0, [1.0] * len(self.scales)
            while not self.over and share >= 0.5**halvings:
                before = best
                best = self._around(best, share, signs)
                if best[0] < before[0]:
                    leap = [2 * new - old for new, old in zip(best[1], before[1], strict=True)]
                    best = min(best, self.at(leap))
                else:
                    share /= 2

    def best(self, count: int) -> list[Point]:
        """The points of least cost, the least first; of equal ones the first that was tried."""
        return sorted(self.tried, key=lambda point: self.tried[point])[:count]

    def _around(
        self, best: tuple[float, Point], share: float, signs: list[float]
    ) -> tuple[float, Point]:
        """Every number a step up or down, first the way that last helped."""
        for n, scale in enumerate(self.scales):
            for sign in (signs[n], -signs[n]):
                moved = list(best[1])
                moved[n] += sign * share * scale.step
                found = self.at(moved)
                if found[0] < best[0]:
                    best, signs[n] = found, sign
                    break
        return best


def even(scales: Sequence[Scale], around: Point, count: int) -> list[Point]:
    """Points spread evenly over the ranges, of which each reaches four steps from `around` at most."""
    found = []
    for number in range(1, count + 1):
        place = []
        for scale, middle, prime in zip(scales, around, _PRIMES, strict=False):
            low, high = (
                max(scale.low, middle - 4 * scale.step),
                min(scale.high, middle + 4 * scale.step),
            )
            eighth = scale.step / 8
            place.append(round((low + (high - low) * _turned(number, prime)) / eighth) * eighth)
        found.append(tuple(place))
    return found


def _turned(number: int, base: int) -> float:
    """The digits of a number behind the point, in reverse."""
    value, weight = 0.0, 1.0
    while number:
        number, digit = divmod(number, base)
        weight /= base
        value += digit * weight
    return value
