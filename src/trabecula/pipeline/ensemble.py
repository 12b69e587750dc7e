"""Ensembles: realisations whose porosity scatters as that of real samples does.

A member is a request like any other. The porosity that is drawn for it stands in its recipe as a
target, so that one member can be made again without the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from trabecula.core.checks import as_number, as_seed
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.target import OF_A_PHASE
from trabecula.exemplar.spread import FractionSpread, fraction_spread
from trabecula.synth.api.model import Model, as_request

MOST = 100_000
"""Members at most."""


@dataclass(frozen=True)
class Members:
    """The requests of an ensemble.

    Attributes
    ----------
    requests : tuple of Request
        With seeds that follow each other.
    spread : FractionSpread, optional
        The distribution that their fractions were drawn from; None where they were not drawn.
    note : str
        A sentence that says why they were not drawn; empty where nothing is to be said.
    """

    requests: tuple[Request, ...]
    spread: FractionSpread | None = None
    note: str = ""


def ensemble(
    model: Model,
    shape: Request | int | Sequence[int],
    *,
    count: int,
    seed: int | None = None,
    spread: float = 1.0,
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
        Scatter of the fractions from member to member, 0 .. 4: 1 as of real samples of this shape,
        learned from the exemplar (`fraction_spread`), 0 none: each has the exemplar's. A method
        that takes no target porosity, or makes windows of unlimited material, makes members as it
        does.
    memory : int, optional
        Budget in bytes of one member. Default: the memory that is available.
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
    members = draw_members(model, as_request(shape, seed, parts), count=count, spread=spread)
    return (model.generate(request, memory=memory) for request in members.requests)


def draw_members(model: Model, request: Request, *, count: int, spread: float = 1.0) -> Members:
    """Return the requests of an ensemble's members, each with a seed and, where the method takes
    it as a target, a porosity of its own.

    Parameters
    ----------
    model : Model
    request : Request
        Its seed is that of the first member.
    count, spread
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
    members = tuple(replace(request, seed=request.seed + n) for n in range(number))
    if not scale:
        return Members(members)
    asked = [name for name in ("target", "fixed", "coarse") if name in request.asks_for()]
    if asked:
        raise InputError(
            f"the request has a {asked[0]}, which leaves no porosity to draw: leave it out, or "
            "give spread 0"
        )
    note = _why_not_drawn(model, len(request.shape))
    if note:
        return Members(members, note=note)
    found = fraction_spread(model.exemplars, _sample_shape(request))
    fractions = found.draw([one.seed for one in members], scale=scale)
    drawn = tuple(
        replace(one, target=_target(drawn)) for one, drawn in zip(members, fractions, strict=True)
    )
    return Members(drawn, found)


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
