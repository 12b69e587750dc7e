"""Who made what from what: the sentences on a certificate's face, and a text for a paper's Methods
section.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from trabecula.core.errors import TrabeculaError
from trabecula.measure.registry import GROUPS

if TYPE_CHECKING:
    from trabecula.report.verdict import Certificate

LEVELS = {"quick": "the quick level", "default": "the default level", "full": "the full level"}
_DIGITS = 12
"""Digits of a SHA-256 that are shown on the face; the Methods text has all."""


def today() -> str:
    """Return the date, ISO 8601; that of SOURCE_DATE_EPOCH where it is set
    (reproducible-builds.org).
    """
    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    if seconds.isdecimal():
        return datetime.datetime.fromtimestamp(int(seconds), datetime.UTC).date().isoformat()
    return datetime.date.today().isoformat()


def face(certificate: Certificate, *, date: str) -> list[str]:
    """Return the sentences on a certificate's face: exemplar, image and its method, judgement."""
    from trabecula import __version__

    exemplar, image = (certificate.about.get(who) or {} for who in ("exemplar", "image"))
    sentences = [f"Exemplar: {_whole(exemplar)}."] if exemplar else []
    if image:
        sentences.append(f"{certificate.name}: {_whole(image, named=False)}{_made(image)}.")
    level = LEVELS.get(str(certificate.about.get("level")), "")
    sentences.append(
        f"Judged on {date} by trabecula {__version__}" + (f" at {level}." * bool(level))
    )
    return sentences


def methods_text(certificates: Sequence[Certificate], *, date: str) -> str:
    """Return a paragraph for a Methods section, and the works that it cites."""
    from trabecula import __version__

    first = certificates[0]
    exemplar = first.about.get("exemplar") or {}
    works = [f"trabecula {__version__}: porous and heterogeneous materials by example"]
    parts = []
    if exemplar:
        parts.append(f"The exemplar was {_whole(exemplar, digits=64)}.")
    for one in certificates:
        image = one.about.get("image") or {}
        step = _step(image)
        if step:
            works += [work for work in _papers(step) if work not in works]
        if image:
            parts.append(f"{one.name} was {_whole(image, named=False, digits=64)}{_made(image)}.")
    band = next((m.real_band for m in first.metrics.values() if m.real_band), None)
    judged = sum(metric.passed is not None for metric in first.metrics.values())
    groups = [GROUPS[name].lower() for name in first.groups]
    parts.append(
        f"{judged} figures ({', '.join(groups)}) were judged on {date} with trabecula "
        f"{__version__} [1] at {LEVELS.get(str(first.about.get('level')), 'its usual level')}."
    )
    if band:
        parts.append(
            "The band of a figure holds 99 % of other samples of the material as large as the "
            "image; it follows from equal parts of the exemplar, extrapolated to the image's size."
        )
    for one in certificates:
        failed = f" ({', '.join(one.failed)} outside)" if one.failed else ""
        verdict = {"pass": "passed", "fail": "failed"}.get(one.verdict, "was not decided")
        parts.append(f"{one.name} {verdict}{failed}.")
    cited = [f"[{number}] {work}." for number, work in enumerate(works, start=1)]
    return "\n".join([" ".join(parts), "", *cited])


def source_name(about: Mapping[str, Any]) -> str:
    """Return the name of the file or sample that an image began with; "" where none is known."""
    steps = about.get("recipe") or []
    first = steps[0] if steps else {}
    if first.get("verb") == "sample":
        return f"sample:{first.get('name')}"
    return str(first.get("source") or "").replace("\\", "/").rpartition("/")[2]


def digest_of_image(about: Mapping[str, Any]) -> str:
    """Return the SHA-256 of an image's voxels by its recipe; "" where none is known."""
    steps = about.get("recipe") or []
    return str(steps[-1].get("sha256") or "") if steps else ""


def _whole(about: Mapping[str, Any], *, named: bool = True, digits: int = _DIGITS) -> str:
    """Return name, size, edge and hash of an image in words."""
    size = " x ".join(f"{n}" for n in about["shape"])
    edges = [f"{n:g}" for n in about["spacing"]]
    edge = edges[0] if len(set(edges)) == 1 else " x ".join(edges)
    name = source_name(about) if named else ""
    text = f"{size} voxels of {edge} {about['unit']}"
    digest = digest_of_image(about)
    hashed = f" (SHA-256 {digest[:digits]}{'...' * (digits < 64)})" if digest else ""
    phases = about.get("phases") or ()
    what = f"phases {', '.join(phases)}" if phases else str(about.get("kind") or "")
    return (f"{name}, " if name else "") + text + (f", {what}" if what else "") + hashed


def _step(about: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the step of a recipe that a method made; empty where there is none."""
    steps = about.get("recipe") or []
    return next((step for step in steps if step.get("verb") == "generate"), {})


def _made(about: Mapping[str, Any]) -> str:
    """Return how an image was made, from its recipe."""
    step = _step(about)
    name = step.get("method")
    if not name:
        return ", whose making is not recorded"
    settings = ", ".join(f"{key} {_brief(value)}" for key, value in _chosen(step).items())
    seed = (step.get("request") or {}).get("seed", 0)
    version = (step.get("versions") or {}).get("trabecula", "")
    text = f", made by the method {name} of trabecula {version}".rstrip() + f" with seed {seed}"
    text += f" and the settings {settings}" if settings else " and its default settings"
    steps = about.get("recipe") or []
    after = [str(one.get("operation") or one.get("verb")) for one in steps[steps.index(step) + 1 :]]
    return text + (f", then finished by {', '.join(after)}" if after else "")


def _chosen(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that differ from the method's defaults; all where these are unknown."""
    from dataclasses import asdict

    from trabecula.synth.api.registry import method

    given = dict(step.get("settings") or {})
    try:
        usual = asdict(method(step["method"]).config)
    except (TrabeculaError, TypeError):
        return {key: value for key, value in given.items() if value is not None}
    plain = {key: list(one) if isinstance(one, tuple) else one for key, one in usual.items()}
    return {key: value for key, value in given.items() if plain.get(key, value) != value}


def _papers(step: Mapping[str, Any]) -> Iterator[str]:
    from trabecula.synth.api.registry import methods

    found = methods().get(str(step.get("method")))
    if found is not None and found.paper:
        yield found.paper


def _brief(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(_brief(one) for one in value) + ")"
    return f"{value:g}" if isinstance(value, float) else str(value)
