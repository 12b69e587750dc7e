"""Orientations of an exemplar that count as alike: crops are taken in each of them."""

from __future__ import annotations

from itertools import permutations, product

from torch import Tensor

Turn = tuple[tuple[int, ...], tuple[int, ...]]
"""Order of the axes 1, 2, 3 of a field (1, 2 of a picture's), and the axes that are then flipped.
"""


def turns_of(orientations: str, *, axes: int = 3) -> tuple[Turn, ...]:
    """List the orientations of a setting, of a volume or a picture.

    Inverted through a point a material has the same two-point function along every direction;
    mirrored it has the same along the axes.
    """
    plain = tuple(range(1, axes + 1))
    orders = list(permutations(plain)) if orientations == "all" else [plain]
    flips: list[tuple[int, ...]] = [()]
    if orientations == "inverted":
        flips.append(plain)
    elif orientations in ("mirrors", "all"):
        flips = [
            tuple(axis for axis, on in zip(plain, chosen, strict=True) if on)
            for chosen in product((0, 1), repeat=axes)
        ]
    return tuple(product(orders, flips))


def oriented(part: Tensor, turn: Turn) -> Tensor:
    """Return a crop (K, ...) of a field in an orientation."""
    order, flipped = turn
    return part.permute(0, *order).flip(flipped)
