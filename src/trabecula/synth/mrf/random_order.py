"""A random order of the sites in which a sweep still updates many at once.

Every sweep gives each of its sites a priority, a random number of the seed, the sweep and the
coordinate. A site has its turn as soon as all its neighbours of higher priority have had theirs
(Blelloch, Fineman, Shun 2012, "Greedy sequential maximal independent set and matching are parallel
on average", doi:10.1145/2312005.2312058). No two sites of one turn are in each other's
neighbourhood, so turn after turn equals site after site by falling priority: a uniformly random
order.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.engine.random import philox
from trabecula.synth.mrf.lattice import ClassName, SiteLattice, marks_or_all

_WAITING, _NEVER = 0, 65535  # turns begin at 1


class RandomTurns:
    """Sites of a lattice by their turns in one sweep, as `SiteClasses` gives them by classes.

    Attributes
    ----------
    lattice : SiteLattice
    names : list of (int,)
        Turns, the first one first.
    """

    def __init__(self, lattice: SiteLattice, turn: np.ndarray, count: int) -> None:
        self.lattice = lattice
        self.names: list[ClassName] = [(number,) for number in range(1, count + 1)]
        self._turn = turn

    def sites(self, name: ClassName, first: int, last: int) -> np.ndarray:
        """Return the sites of a turn in the planes first .. last as flat places, rising (int64)."""
        _, height, width = self.lattice.shape
        found = np.flatnonzero(self._turn[first:last] == np.uint16(name[0]))
        return np.asarray(found + first * height * width, np.int64)


def draw_turns(
    lattice: SiteLattice,
    offsets: np.ndarray,
    temperature: np.ndarray,
    held: np.ndarray,
    *,
    key: np.uint64,
    sweep: int,
    turn: np.ndarray,
    priority: np.ndarray,
) -> RandomTurns:
    """Draw the turns of a sweep.

    Parameters
    ----------
    lattice : SiteLattice
    offsets : (K, 3) int64
        Of the neighbours in three dimensions; with each its opposite.
    temperature : (Z, Y, X) float32
        Sites at 0 are not visited unless `held` (bool); without entries all free sites are.
    held : (Z, Y, X) bool
    key : uint64
        Of the scale, for `philox`.
    sweep : int
    turn, priority : (Z, Y, X) uint16, uint32
        Overwritten; the turns refer to the first.
    """
    free = marks_or_all(lattice.free)

    def begin(first: int, last: int) -> None:
        draw_priorities(first, last, free, temperature, held, key, sweep, priority, turn)

    for_slabs(begin, lattice.shape[0])
    waiting, count = sum_slabs(lambda a, b: int(np.sum(turn[a:b] == _WAITING)), len(turn)), 0
    while waiting:
        count += 1

        def take(first: int, last: int, number: int = count) -> int:
            return int(take_turns(first, last, offsets, priority, number, turn))

        waiting -= sum_slabs(take, lattice.shape[0])
    return RandomTurns(lattice, turn, count)


@kernel
def draw_priorities(first, last, free, temperature, held, key, sweep, priority, turn):
    """Draw the priorities of the planes first .. last, and mark the sites that wait for a turn."""
    _, Y, X = turn.shape
    marks, warm, kept = free.ravel(), temperature.ravel(), held.ravel()
    for z in range(first, last):
        for y in range(Y):
            for x in range(X):
                site = (z * Y + y) * X + x
                asked = len(marks) == 0 or marks[site]
                if asked and len(warm) > 0:
                    asked = warm[site] > 0 or (len(kept) > 0 and kept[site])
                turn[z, y, x] = _WAITING if asked else _NEVER
                priority[z, y, x] = philox(key, site, site >> 32, sweep, 0)[0]


@kernel
def take_turns(first, last, offsets, priority, number, turn):
    """Give this turn to the waiting sites of the planes first .. last before which no neighbour is
    waiting; return how many they are.

    Of equal priorities the first site goes first. A neighbour that gets the same turn, perhaps
    this moment from another thread, counts as waiting.
    """
    Z, Y, X = turn.shape
    found = 0
    for z in range(first, last):
        for y in range(Y):
            for x in range(X):
                if turn[z, y, x] != _WAITING:
                    continue
                own, site = priority[z, y, x], (z * Y + y) * X + x
                ready = True
                for k in range(len(offsets)):
                    a = (z + offsets[k, 0]) % Z
                    b = (y + offsets[k, 1]) % Y
                    c = (x + offsets[k, 2]) % X
                    word = priority[a, b, c]
                    if word < own or (word == own and (a * Y + b) * X + c >= site):
                        continue
                    state = turn[a, b, c]
                    if state in (_WAITING, number):
                        ready = False
                        break
                if ready:
                    turn[z, y, x] = number
                    found += 1
    return found
