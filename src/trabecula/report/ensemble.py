"""Is an ensemble the material? Members of one shape against real parts of that shape, as
distributions: one sample alone shows neither a bias nor members that are all alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_name, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.parallel import map_items
from trabecula.measure.blockwise import images_at_once
from trabecula.measure.copying import TurnedCopies, differences, diversity
from trabecula.measure.copying.pair import ExemplarTrees
from trabecula.measure.copying.turned import ENOUGH
from trabecula.measure.fractions import porosity
from trabecula.measure.registry import LEVELS
from trabecula.report.band import parts
from trabecula.report.compatibility import check_corresponds
from trabecula.report.decidability import trend_reasons
from trabecula.report.dependence import CorrelatedSample
from trabecula.report.ensemble_certificate import Copying, EnsembleCertificate
from trabecula.report.ensemble_figures import EnsembleFigures, choose_lags, power
from trabecula.report.ensemble_tests import compare
from trabecula.report.real_checks import contradictions, judge_halves, leave_one_out
from trabecula.report.real_parts import RealParts
from trabecula.report.reference import (
    LAG,
    SAMPLES,
    copies_limit,
    search_copies,
    search_parts,
)
from trabecula.report.verdict import about_image

LEAST_MEMBERS = 4
"""Fewer members know no spread."""

EXAMINED = 4
"""Members, evenly chosen, that are searched for copies: seconds each, of a large exemplar."""

REPEATED = 0.5
"""Two members that differ in a smaller share of what independent ones would are called repeated."""


def verify_ensemble(
    exemplar: Image | ArrayLike | list[Image] | tuple[Image, ...],
    images: Sequence[Image | ArrayLike],
    *,
    names: Sequence[str] | None = None,
    level: str = "default",
    box: int | None = None,
    r_max: int = 50,
) -> EnsembleCertificate:
    """Judge whether images are distributed as parts of the exemplar are.

    Parameters
    ----------
    exemplar : Image or array of labels, (Z, Y, X) or (Y, X), or a list of Images
        One scan of the material, or several.
    images : sequence of Image or array of labels
        The members, `LEAST_MEMBERS` at least: of one shape; of the exemplar's phases, spacing and
        unit.
    names : sequence of str, optional
        What to call the members.
    level : {"quick", "default", "full"}
        "quick" leaves out thickness, pore size and copying; "full" adds diffusivity and
        permeability of the void.
    box : int, optional
        At level "full": edge of the centre box, voxels, that transport is solved in.
    r_max : int
        Largest distance of the two-point function, voxels; lowered to half the smallest side.

    Returns
    -------
    certificate : EnsembleCertificate

    Raises
    ------
    InputError
        Too few members; members of different shapes; kinds, phases, spacing, unit or dimensions
        that do not correspond; grey or colour images; an exemplar of one phase only; too few real
        parts.

    Notes
    -----
    Figures: porosity and the fraction of each of several phases, specific surface, mean curvature,
    Euler number per volume, the two-point function at half, one and two correlation lengths, chord
    length, thickness, pore size, the share of the largest component, diffusivity and permeability.

    Real parts are boxes of the members' shape, evenly spread over the exemplars; they overlap by
    half where fewer than 27 fit side by side. Their correlations follow from how they lie
    (`report.dependence`), and with them the standard deviation of the material, its degrees of
    freedom and the error of the mean. Where no exemplar holds such parts, the deviation is that of
    smaller parts, extrapolated to the members' volume, the mean that of the exemplar, and there are
    no rank tests.

    Tests of every figure: Welch's t of the means, F of the variances with degrees of freedom
    lowered where tails are heavy, Kolmogorov-Smirnov and Mann-Whitney with p values from draws that
    have the correlations of the parts. All p values of all figures are corrected together
    (Benjamini-Hochberg at 0.05), so real material fails in some figure about once in 20 ensembles.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> scan = (rng.random((64, 64, 64)) < 0.3).astype(np.uint8)
    >>> members = [(rng.random((24, 24, 24)) < 0.3).astype(np.uint8) for _ in range(12)]
    >>> verify_ensemble(scan, members, level="quick").metrics["porosity"].verdict
    'pass'
    """
    several = isinstance(exemplar, (list, tuple))
    given: list[Any] = list(cast(Sequence, exemplar)) if several else [exemplar]
    exemplars = [as_image(each, name="exemplar") for each in given]
    check_name(level, LEVELS, name="level")
    members = [as_image(each, name=f"member {n}") for n, each in enumerate(images, start=1)]
    called = _name(names, len(members))
    _check(exemplars, members, called, r_max)
    shape = members[0].shape
    reach = min(r_max, *(min(image.shape) // 2 for image in (*exemplars, members[0])))
    figures = EnsembleFigures(level, choose_lags(exemplars, reach), box)
    real = RealParts(exemplars, figures, shape)
    found = figures.measure_all(members, "measuring members")
    known = [
        name
        for name in real.names()
        if sum(one[name] is not None for one in found) >= LEAST_MEMBERS
    ]
    samples = {
        name: CorrelatedSample.independent(
            [value for one in found if (value := one[name]) is not None]
        )
        for name in known
    }
    metrics = compare(samples, {name: real.expected(name) for name in known})
    copying = _find_copies(exemplars, members, called, level)
    failed, judged = judge_halves(real)
    about_real = {
        "parts": real.count,
        "shape": list(real.shape),
        "exemplars": len(exemplars),
        "independent": real.independent,
        "freedom": real.freedom,
        "exponent": real.exponent,
        "extrapolated": real.extrapolated,
        "inside": {name: leave_one_out(real, name) for name in known},
        "sets_judged": judged,
        "sets_failed": failed,
    }
    notes = _notes(real, about_real, [name for name in found[0] if name not in known])
    return EnsembleCertificate(
        metrics,
        {name: _title(figures, name, exemplars[0].unit) for name in known},
        tuple(called),
        shape,
        about_real,
        copying,
        tuple(notes),
        {"exemplars": [about_image(each) for each in exemplars], "level": level},
    )


def _name(names: Sequence[str] | None, count: int) -> Sequence[str]:
    if names is None:
        return [f"member {n}" for n in range(1, count + 1)]
    check_type(names, Sequence, name="names", advice="give a list of them")
    if len(names) != count:
        raise InputError(f"{len(names)} names for {count} members: give one for each")
    return names


def _check(
    exemplars: Sequence[Image], members: Sequence[Image], names: Sequence[str], r_max: int
) -> None:
    """Raise where members and exemplars cannot be compared."""
    if not exemplars:
        raise InputError(
            "verify_ensemble needs a scan of the material: verify_ensemble(scan, images)"
        )
    if len(members) < LEAST_MEMBERS:
        raise InputError(
            f"an ensemble of {len(members)} members has no spread to judge: give {LEAST_MEMBERS} "
            "at least (24 decide something), or verify single images without ensemble"
        )
    if r_max < 1:
        raise InputError(f"r_max {r_max} must be at least 1 voxel")
    for n, each in enumerate(exemplars, start=1):
        if each.kind != "labels":
            raise InputError(
                f"the exemplar is {each.kind}: figures of an ensemble are those of labels; segment "
                "it (tb.segment, or --threshold)"
            )
        check_corresponds(exemplars[0], each, f"exemplar {n}")
        if not 0 < porosity(each) < 1:
            raise InputError(
                f"exemplar {n} is all void or holds none: there is nothing to compare; check its "
                "threshold"
            )
    for member, name in zip(members, names, strict=True):
        check_corresponds(exemplars[0], member, name)
        if member.shape != members[0].shape:
            one, other = (" x ".join(map(str, each.shape)) for each in (members[0], member))
            raise InputError(
                f"members have one shape, {names[0]} has {one} voxels and {name} {other}: spread "
                "depends on the size; crop them alike"
            )


def _find_copies(
    exemplars: Sequence[Image], members: Sequence[Image], names: Sequence[str], level: str
) -> Copying:
    """Measure how different members are, and above level "quick" if they are copies of patches."""
    apart = differences(members)
    np.fill_diagonal(apart, np.inf)
    first, second = sorted(int(n) for n in np.unravel_index(np.argmin(apart), apart.shape))
    closest, pair = float(apart[first, second]), (names[first], names[second])
    faults = []
    if closest < REPEATED:
        repeated = int((apart.min(axis=1) < REPEATED).sum())
        faults.append(
            f"Members repeat each other: {pair[0]} and {pair[1]} differ in {closest:.0%} of what "
            f"independent ones would, and {repeated} of {len(members)} have such a twin"
        )
    chosen = choose_evenly(len(members), EXAMINED)
    real = [] if level == "quick" else [*_search_real(exemplars)]
    if not real:
        return Copying(closest, pair, faults=tuple(faults))
    limit = copies_limit([share for share, _ in real], SAMPLES)
    among = _coherence_among([members[n] for n in chosen])
    copied: dict[str, float] = {}
    turned: dict[str, TurnedCopies] = {}
    trees = [ExemplarTrees() for _ in exemplars]
    searched = map_items(
        lambda n: [
            search_copies(exemplar, members[n], trees=grown)
            for exemplar, grown in zip(exemplars, trees, strict=True)
        ],
        chosen,
        "searching copies",
        most=images_at_once([one.shape for one in (*exemplars, *members)], level),
    )
    for n, found in zip(chosen, searched, strict=True):
        found = [each for each in found if each[0] is not None]
        copied[names[n]] = max((share or 0.0 for share, _ in found), default=0.0)
        seen = [each for _, each in found if each]
        if seen:
            turned[names[n]] = max(seen, key=lambda each: each.share)
    worst = max(copied, key=lambda name: copied[name])
    if copied[worst] > limit:
        faults.append(
            f"Copied from the exemplar: of {worst}, {copied[worst]:.0%} of the voxels continue a "
            f"patch of it (real material: up to {limit:.0%})"
        )
    most = copies_limit([copies.share for _, copies in real], ENOUGH)
    for name, copies in turned.items():
        if copies.share > most:
            faults.append(
                f"Copied from the exemplar: {name} is partly or wholly {copies.text} "
                f"({copies.share:.0%} of its voxels; real material: up to {most:.0%})"
            )
    if among is not None and among > limit:
        faults.append(
            f"Members share patches: up to {among:.0%} of the voxels of one continue a patch of "
            f"another (real material: up to {limit:.0%})"
        )
    examined = tuple(names[n] for n in chosen)
    return Copying(closest, pair, among, copied[worst], limit, examined, tuple(faults))


def choose_evenly(count: int, most: int) -> list[int]:
    """Return at most so many places among `count`, from the first to the last."""
    return sorted({n * (count - 1) // (most - 1) for n in range(most)})


def _search_real(exemplars: Sequence[Image]) -> Iterator[tuple[float, TurnedCopies]]:
    """Yield what parts of exemplars have in common with other parts, where they are large
    enough.
    """
    for exemplar in exemplars:
        for share, turned in search_parts(list(parts(exemplar, share=2))):
            if share is not None and turned is not None:
                yield share, turned


def _coherence_among(members: Sequence[Image]) -> float | None:
    """Return the largest coherence of one member with another; None where they are too small."""
    try:
        return float(np.nanmax(diversity(members, k=LAG, samples=SAMPLES).coherence))
    except InputError:
        return None


def _title(figures: EnsembleFigures, name: str, unit: str) -> str:
    """Return the title of a figure with its unit."""
    marks = {1: unit, 2: f"{unit}\u00b2", -1: f"1/{unit}", -2: f"1/{unit}\u00b2"}
    mark = marks.get(power(name), f"1/{unit}\u00b3") if power(name) else ""
    return f"{figures.title(name)} ({mark})" if mark else figures.title(name)


def _notes(real: RealParts, about: dict[str, Any], missing: Sequence[str]) -> Iterator[str]:
    """Yield what to know about the real parts before believing the figures."""
    size, members = (" x ".join(map(str, shape)) for shape in (real.shape, real.members))
    yield (
        f"Real parts: {real.count} of {size} voxels that overlap or touch; their mean is as sure "
        f"as that of {real.independent:.1f} independent ones, their spread has {real.freedom:.1f} "
        f"degrees of freedom (the variance falls as the volume to the power -{real.exponent:.2f})."
    )
    if real.extrapolated:
        yield (
            f"No exemplar holds enough parts as large as the members ({members}): the spread of "
            "smaller parts is extrapolated to that size, the mean is the exemplar's own with its "
            "own uncertainty, and rank tests (Kolmogorov-Smirnov, Mann-Whitney) are not possible."
        )
    elif not all(real.boxes):
        small = [str(n) for n, boxes in enumerate(real.boxes, start=1) if not boxes]
        yield f"Exemplar {', '.join(small)} is smaller than the members and gives no part."
    if about["sets_judged"]:
        yield (
            f"Real material judged as an ensemble, parts against parts that share no voxel with "
            f"them: {about['sets_failed']} of {about['sets_judged']} sets failed."
        )
    inside = [share for share in about["inside"].values() if share is not None]
    if inside:
        yield (
            f"Left out one by one, {float(np.mean(inside)):.0%} of the real parts lie in the 95 % "
            "band of those parts that share no voxel with them."
        )
    differing = contradictions(real)
    if differing:
        yield (
            "The exemplars contradict each other: by more than their own parts differ in "
            f"{', '.join(differing)}. They may be no samples of one material."
        )
    for n, exemplar in enumerate(real.exemplars, start=1):
        what = "the exemplar" if len(real.exemplars) == 1 else f"exemplar {n}"
        for reason in trend_reasons(exemplar, what=what):
            yield f"{reason[0].upper()}{reason[1:]}."
    if missing:
        yield (
            f"Not judged: {', '.join(missing)}. Too few members or parts have a value, or it "
            "cannot be extrapolated, being no mean over the volume."
        )
