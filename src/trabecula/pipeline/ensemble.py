"""Ensembles: realisations that scatter as real samples do.

Samples of a material are parts of more of it: no part has its mean sizes and surface, even where it
has its porosity. So members are cut from volumes of twice their sides, whose porosity is drawn: it
scatters as that of real samples as large. Where a member cannot be a part, since it repeats or has
a form, its own porosity is drawn. What is drawn stands in a member's recipe as a target, so that
one member can be made again without the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.checks import as_number, as_seed
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.target import OF_A_PHASE
from trabecula.exemplar.crop import crop
from trabecula.exemplar.spread import FractionSpread, fraction_spread
from trabecula.synth.api.model import Model, as_request

MOST = 100_000
"""Members at most."""

_SIDES = 2  # of a member, along each side of the volume that it is a part of


@dataclass(frozen=True)
class Member:
    """One realisation of an ensemble.

    Attributes
    ----------
    seed : int
        Its name: those of an ensemble follow each other.
    request : Request
        That makes it, or the volume that it is a part of, with the seed of the first of the parts.
    corner : tuple of int, optional
        The first voxel of the part. Default: it is the whole.
    """

    seed: int
    request: Request
    corner: tuple[int, ...] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the member's own shape."""
        sides = self.request.shape
        return sides if self.corner is None else tuple(side // _SIDES for side in sides)

    def cut(self, volume: Image) -> Image:
        """Return the member, of what its request makes."""
        return volume if self.corner is None else crop(volume, self.shape, corner=self.corner)


@dataclass(frozen=True)
class Members:
    """An ensemble that is to be made.

    Attributes
    ----------
    members : tuple of Member
        By seed; parts of one volume follow each other.
    spread : FractionSpread, optional
        The distribution that the fractions of their requests were drawn from; None where they were
        not drawn.
    note : str
        A sentence that says why they were not drawn; empty where nothing is to be said.
    """

    members: tuple[Member, ...]
    spread: FractionSpread | None = None
    note: str = ""

    def volumes(self) -> list[tuple[Request, list[Member]]]:
        """Return what is to be made, each with the members that it gives."""
        found: dict[int, tuple[Request, list[Member]]] = {}
        for member in self.members:
            found.setdefault(member.request.seed, (member.request, []))[1].append(member)
        return list(found.values())


def ensemble(
    model: Model,
    shape: Request | int | Sequence[int],
    *,
    count: int,
    seed: int | None = None,
    spread: float = 1.0,
    alone: bool = False,
    memory: int | None = None,
    **parts: Any,
) -> Iterator[Image]:
    """Make realisations one after the other, with the seeds `seed`, `seed` + 1, ...

    Parameters
    ----------
    model : Model
    shape : int, sequence of int, or Request
        Of every member.
    count : int
        Members.
    seed : int
        Of the first member; 0 where neither this nor the request says otherwise.
    spread : float
        Scatter from member to member, 0 .. 4. 1: as of real samples of this shape. Eight members
        (four of two axes) are the parts of a volume of twice their sides, whose fractions are drawn
        as those of real samples as large (`fraction_spread`). With a mask or periodic axes, and for
        other numbers, each is made by itself with fractions that scatter so much; 0: each has the
        exemplar's. A method that takes no target porosity, or makes windows of unlimited material,
        makes members as it does.
    alone : bool
        Make each by itself, with fractions of its own. It takes an eighth of the memory, and
        members differ less in what does not follow from their fractions.
    memory : int, optional
        Budget in bytes of what one member is cut from. Default: the memory that is available.
    **parts
        Other fields of `Request`.

    Returns
    -------
    members : iterator of Image
        Each is made when it is asked for.

    Raises
    ------
    InputError
        As `draw_members`, and what `Model.generate` raises.
    """
    request = as_request(shape, seed, parts)
    drawn = draw_members(model, request, count=count, spread=spread, alone=alone)
    return (
        member.cut(volume)
        for volume_request, members in drawn.volumes()
        for volume in (model.generate(volume_request, memory=memory),)
        for member in members
    )


def draw_members(
    model: Model, request: Request, *, count: int, spread: float = 1.0, alone: bool = False
) -> Members:
    """Return an ensemble's members: parts of volumes, or each by itself, with fractions of their
    own where the method takes them as a target.

    Parameters
    ----------
    model : Model
    request : Request
        Its seed is that of the first member.
    count, spread, alone
        As of `ensemble`.

    Raises
    ------
    InputError
        A count or spread out of range; a spread beside a target, known voxels or a coarse scan, or
        of an exemplar without phases.
    """
    number = int(as_number(count, name="count", low=1, high=MOST, whole=True))
    scale = float(as_number(spread, name="spread", low=0, high=4))
    as_seed(request.seed + number - 1)
    single = tuple(
        Member(seed, replace(request, seed=seed))
        for seed in range(request.seed, request.seed + number)
    )
    if not scale:
        return Members(single)
    asked = [name for name in ("target", "fixed", "coarse") if name in request.asks_for()]
    if asked:
        raise InputError(
            f"the request has a {asked[0]}, which leaves no porosity to draw: leave it out, or "
            "give spread 0"
        )
    note = _why_not_drawn(model, len(request.shape))
    if note:
        return Members(single, note=note)
    apart = alone or scale != 1 or bool(request.asks_for())
    members = single if apart else _parts(request, number)
    found = fraction_spread(model.exemplars, _sample_shape(members[0].request))
    seeds = sorted({one.request.seed for one in members})
    targets = dict(zip(seeds, map(_target, found.draw(seeds, scale=scale)), strict=True))
    drawn = tuple(
        replace(one, request=replace(one.request, target=targets[one.request.seed]))
        for one in members
    )
    return Members(drawn, found)


def _parts(request: Request, count: int) -> tuple[Member, ...]:
    """Return members that are the parts of volumes of twice their sides."""
    corners = list(np.ndindex(*[_SIDES] * len(request.shape)))
    found = []
    for n in range(count):
        sides = tuple(_SIDES * side for side in request.shape)
        first = request.seed + n - n % len(corners)
        at = zip(corners[n % len(corners)], request.shape, strict=True)
        corner = tuple(int(step * side) for step, side in at)
        found.append(Member(request.seed + n, replace(request, shape=sides, seed=first), corner))
    return tuple(found)


def _why_not_drawn(model: Model, ndim: int) -> str:
    """Return why the members of a model get no fractions of their own; empty where they do."""
    known = model.capabilities
    own = f"members differ as {known.name} makes them"
    if "target" not in known.honours or "porosity" not in known.targets:
        return f"method {known.name!r} takes no target porosity: {own}"
    if known.large == "box":
        return f"windows of unlimited material scatter by themselves: {own}"
    if not model.exemplars:
        return f"the model has no exemplar that says how samples scatter: {own}"
    if model.facts[0].kind == "labels" and model.facts[0].ndim != ndim:
        return f"a picture does not say how the fractions of volumes scatter: {own}"
    phases = model.facts[0].phases
    if len(phases) > 2 and OF_A_PHASE not in known.targets:
        return f"method {known.name!r} takes no target for {len(phases)} phases: {own}"
    return ""


def _target(fractions: dict[str, float]) -> dict[str, float]:
    """Return the target of a request for fractions by the phase's name."""
    void = "void" if "void" in fractions else next(iter(fractions))
    if len(fractions) == 2:
        return {"porosity": fractions[void]}
    return {OF_A_PHASE + name: share for name, share in fractions.items() if name != void}


def _sample_shape(request: Request) -> tuple[int, ...]:
    """Return the shape of a sample; of a form that of a box of its volume and proportions."""
    if request.mask is None:
        return request.shape
    share = float(request.mask.mean()) ** (1 / len(request.shape))
    return tuple(max(1, round(side * share)) for side in request.shape)
