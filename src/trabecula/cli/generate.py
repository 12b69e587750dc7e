"""`trabecula generate EXEMPLAR ... [--method NAME] --shape Z Y X --seed N --out FILE`, or with
`--model FILE|NAME`.

`trabecula generate --resume FILE` resumes an interrupted run.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.method_choice import check_fits, method_for, tried
from trabecula.core.errors import InputError
from trabecula.core.progress import part, whole_run

_READING, _TRIALS = 0.02, 0.7
"""Parts of a run's time before it learns: reading, and with --effort trials of settings."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the request, the result's place, and the options of runs in blocks."""
    add_request(parser)
    shared.add_effort(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        help="volume to write (.zarr .tif .npy .mhd .nrrd .nii.gz .vti), or s3://BUCKET/NAME.zarr",
    )
    group = parser.add_argument_group("an ensemble")
    group.add_argument(
        "--count",
        metavar="N",
        help="make N members, with the seeds from --seed on, into --out with {seed} in its name "
        "(DIR/{seed}.zarr), several at once; the same command resumes after an interruption",
    )
    group.add_argument(
        "--spread",
        metavar="S",
        help="scatter from member to member: 1 (default) as of real samples of this size: eight "
        "members are the parts of a volume of twice their sides; else that of the porosity they "
        "are made with, 0: all have the exemplar's",
    )
    group.add_argument(
        "--alone",
        action="store_true",
        help="make each member by itself, of a porosity that is drawn: less memory, and they "
        "differ in little but porosity",
    )
    group = parser.add_argument_group("resuming a run, and workers")
    group.add_argument(
        "--resume",
        metavar="FILE",
        help="instead of all else: resume the interrupted run that makes FILE; what it started "
        "from is looked for "
        "where it was, or given with --exemplar, --model, --mask, --fixed, --known, --coarse, "
        "--like",
    )
    group.add_argument(
        "--exemplar",
        nargs="+",
        metavar="FILE",
        help="with --resume: the exemplars, where they have moved",
    )
    group.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="make the blocks of a .zarr in N processes (needs the extra cluster)",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDR",
        help="or on the Dask cluster of this scheduler: tcp://HOST:PORT",
    )
    group.add_argument(
        "--scratch",
        metavar="DIR",
        help="folder for the scratch files of a .zarr that does not fit into memory (default: that "
        "of the .zarr)",
    )
    parser.add_argument("--json", action="store_true", help="print what was made as JSON")


def add_request(parser: argparse.ArgumentParser) -> None:
    """Add the options that `plan` shares."""
    parser.add_argument(
        "exemplars",
        nargs="*",
        metavar="EXEMPLAR",
        help="scan to learn from, or sample:NAME; several where the method can, none where it "
        "needs none",
    )
    parser.add_argument("--method", help="see trabecula methods (default: what inspect recommends)")
    parser.add_argument(
        "--model",
        metavar="FILE|NAME",
        help="instead of EXEMPLAR and --method: what fit wrote, or see trabecula models",
    )
    parser.add_argument(
        "--shape",
        nargs="+",
        metavar="N",
        help="voxels: one number (a cube), z y x, or y x of a picture (default: that of --mask, "
        "--fixed, or of --coarse at the exemplar's spacing)",
    )
    parser.add_argument("--seed", help="0 .. 2**63 - 1 (default 0)")
    shared.add_settings(parser)
    shared.add_memory(parser)
    shared.add_threads(parser)
    parser.add_argument(
        "--chunks",
        type=int,
        metavar="N",
        help="of a .zarr: make it in blocks of N voxels a side, whatever its size (default: what "
        "fits, in chunks of 128)",
    )
    shared.add_parts(parser)
    shared.add_reading(parser)


@dataclass(frozen=True)
class GenerateTask:
    """A request, and either a model or a method with its exemplars (or the voxels' size)."""

    request: Any
    method: Any = None
    exemplars: Any = None
    voxel: Any = field(default_factory=dict)
    model: Any = None
    recommended: str = ""
    """A line that says which method was chosen, and why; empty where it was named."""
    asked: Any = field(default_factory=dict)
    """The property that is to be met by changing porosity; empty where none is."""

    def learning_share(self) -> float:
        """Return the part of the run's time that learning takes; 0 where nothing is learned."""
        if self.model is not None:
            return 0.0
        return float(self.method.learning_share(self.exemplars, self.request.shape))

    def fit(self, *, memory: int | None) -> Any:
        """Return the model, which is learned where it is not given."""
        if self.model is not None:
            return self.model
        model = self.method.fit(self.exemplars, memory=memory, **self.voxel)
        if self.recommended:  # now, so that what cannot be learnt from is refused in one line
            terminal.note(self.recommended)
        if self.exemplars and not self.request.target:
            shared.note_trends(self.exemplars)
        return model


def prepare(options: argparse.Namespace) -> GenerateTask:
    """Build the task that the options describe; whatever can be refused without work is refused
    first.
    """
    from trabecula.core.checks import as_seed, as_shape
    from trabecula.core.request import Request
    from trabecula.synth.api.exemplar_info import without_exemplar

    chosen, model = _source(options)
    if all(getattr(options, name) is None for name in ("shape", "mask", "fixed", "coarse")):
        raise InputError(
            "the size of the result is not given: add --shape N, or --shape Z Y X (or a --mask)"
        )
    sides = None if options.shape is None else shared.integers(options.shape, name="--shape")
    shape = None if sides is None else as_shape(sides, ndim=2 if len(sides) == 2 else 3)
    seed = as_seed(shared.integer(options.seed or "0", name="--seed"))
    periodic = shared.periodic(options.periodic)
    exemplars = [shared.load_exemplar(source, options) for source in options.exemplars] or None
    recommended = ""
    if exemplars and chosen is None:
        chosen, recommended = method_for(exemplars, options, shape)
    elif exemplars:
        check_fits(chosen, exemplars)
    voxel = _voxel(options) if chosen and exemplars is None else {}
    known = exemplars or ([without_exemplar(**voxel)] if model is None else list(model.facts))
    edges = partial(_edges, chosen, known) if model is None else lambda: model.spacing
    parts = shared.load_parts(options, known, shape, edges)
    refined = parts.pop("shape", None)
    asked = _take_properties(parts["target"])
    if shape is None:
        named = next((parts[name] for name in ("mask", "fixed") if name in parts), None)
        shape = refined if named is None else named.shape
    request = Request(shape, seed=seed, periodic=periodic, **parts)
    return GenerateTask(request, chosen, exemplars, voxel, model, recommended, asked)


def _take_properties(targets: dict[str, Any]) -> dict[str, Any]:
    """Take the properties out of the targets, and return them."""
    from trabecula.core.target import is_target

    others = [name for name in targets if not is_target(name)]
    if not others:
        return {}
    from trabecula.measure.properties import is_property
    from trabecula.pipeline.property_target import as_property

    asked = {name: targets.pop(name) for name in others if is_property(name)}
    if asked:
        as_property(asked)
    return asked


def _edges(method: Any, exemplars: list[Any]) -> tuple[float, ...]:
    """Return the edges of the voxels that a method will make."""
    from trabecula.pipeline.inputs import voxels_of

    config = method.config
    return voxels_of(exemplars, getattr(config, "views", ()), gap=getattr(config, "gap", 0))


def _voxel(options: argparse.Namespace) -> dict[str, Any]:
    """Return the voxel size of a result without an exemplar."""
    given = [name for name in ("kind", "phases", "threshold", "crop") if getattr(options, name)]
    if given:
        raise InputError(
            f"--{given[0]} says how an exemplar is read: name one, or leave the option out"
        )
    edges = shared.numbers(options.spacing or ["1"], name="--spacing")
    if len(set(edges)) > 1:
        raise InputError(
            f"--spacing {' '.join(options.spacing)}: what is made without an exemplar has cubes: "
            "give one number"
        )
    return {"spacing": edges[0], "unit": options.unit or "voxel"}


def _source(options: argparse.Namespace) -> tuple[Any, Any]:
    """Return the method that will learn, or the model that has learned; neither where the exemplar
    chooses the method.
    """
    from trabecula.synth.api.registry import method
    from trabecula.synth.api.serialize import load_model

    if options.model is None:
        preset, settings = shared.preset_and_settings(options)
        if options.method is None and options.exemplars:
            return None, None
        chosen = (
            None if options.method is None else method(options.method, preset=preset, **settings)
        )
        if chosen is None or not (options.exemplars or chosen.capabilities.alone):
            raise InputError(
                "no exemplar was given: name a scan to learn from, or a --model that has learned"
            )
        return chosen, None
    names = (
        "exemplars",
        "method",
        "preset",
        "set",
        "kind",
        "spacing",
        "unit",
        "phases",
        "threshold",
        "crop",
    )
    given = [name for name in names if getattr(options, name)]
    if given:
        what = "an exemplar" if given[0] == "exemplars" else f"--{given[0]}"
        raise InputError(
            f"{what} beside --model {options.model}: the model has learned with settings of its own"
        )
    return None, load_model(options.model)


def run(options: argparse.Namespace) -> int:
    """Generate and write; an interrupted run is resumed from its state beside --out."""
    from trabecula.engine.parallel import thread_count, threads

    _check_ensemble(options)
    with threads(options.threads if options.threads is not None else thread_count()):
        if options.count is not None:
            return _generate_members(options)
        made = _generate(options) if options.resume is None else _resume(options)
    out = options.out or str(made.path)
    if options.json:
        found = {
            "out": out,
            "shape": made.shape,
            "sha256": made.sha256,
            "recipe": made.recipe.to_json(),
        }
        terminal.show_json(found)
    else:
        print(f"{out}: {made.text}\nsha256 {made.sha256}")
    return 0


def _generate(options: argparse.Namespace) -> Any:
    from trabecula.pipeline.outputs import check_target

    _check_out(options)
    check_target(options.out, resumes=True)
    cluster = _cluster(options)
    with whole_run("reading"):
        begin = _share_before(options)
        with part(0, begin):
            job = _prepare(options)
        if not job.asked:
            with part(begin, 1):
                return _make(options, job, cluster)
    _check_match(options, job, cluster)
    return _match(options, job, job.fit(memory=options.memory))


def _share_before(options: argparse.Namespace) -> float:
    """Return the part of the run's time before it learns."""
    return _READING if options.effort is None else _TRIALS


def _make(options: argparse.Namespace, job: GenerateTask, cluster: Any) -> Any:
    """Learn, make and write."""
    from trabecula.pipeline.generate import generate_to
    from trabecula.pipeline.outputs import check_target
    from trabecula.pipeline.plan import plan_to

    learning = job.learning_share()
    with part(0, learning):
        model = job.fit(memory=options.memory)
    cut = {"memory": options.memory, "chunks": options.chunks}
    # What workers need is forecast when they are there and tell what they have.
    size = (
        plan_to(model, job.request, options.out, **cut).disk
        if cluster is None
        else model.plan(job.request).disk
    )
    check_target(options.out, size=size, resumes=True)
    with part(learning, 1):
        made = generate_to(
            model, job.request, options.out, **cut, cluster=cluster, scratch=options.scratch
        )
    _note_figures(model, job.request, made)
    return made


def _check_match(options: argparse.Namespace, job: GenerateTask, cluster: Any) -> None:
    """Raise where a property is asked for beside what is not made in memory."""
    given = [name for name in ("chunks", "scratch") if getattr(options, name) is not None]
    given += ["workers"] if cluster is not None else []
    if given:
        raise InputError(
            f"--{given[0]} beside --target {next(iter(job.asked))}: what has a property is made "
            "and measured in memory; leave the option out"
        )


def _match(options: argparse.Namespace, job: GenerateTask, model: Any) -> Any:
    """Make what has the property that is asked for, in memory, and write it."""
    from trabecula.engine.storage import path_or_remote
    from trabecula.io import files
    from trabecula.pipeline.generate import Result
    from trabecula.pipeline.property_target import match_property

    found = match_property(model, job.request, job.asked, memory=options.memory)
    files.write(found.image, options.out)
    terminal.note(str(found))
    image = found.image
    return Result(path_or_remote(options.out), image.shape, repr(image), image.recipe)


def _note_figures(model: Any, request: Any, made: Any) -> None:
    """Say which quick figures of a result are off."""
    from trabecula.pipeline.quick_check import quick_check

    line = quick_check(model, request, made)
    if line:
        terminal.note(line)


def _check_out(options: argparse.Namespace) -> None:
    if options.out is None:
        raise InputError("the place of the result is not given: add --out FILE")
    if options.exemplar:
        raise InputError(
            "--exemplar is for --resume and rerun: name the exemplar without an option"
        )


def _prepare(options: argparse.Namespace) -> GenerateTask:
    """Build the task, its settings chosen by trial where an effort is given."""
    job = prepare(options)
    if options.effort is None:
        return job
    if job.model is not None:
        raise InputError(
            f"--effort beside --model {options.model}: the model has learned with settings of its "
            "own; give --effort to fit"
        )
    return replace(job, method=tried(job.method, job.exemplars, options, job.request.shape))


def _check_ensemble(options: argparse.Namespace) -> None:
    """Raise where one option of an ensemble lacks the other."""
    for name in ("spread", "alone"):
        if options.count is None and getattr(options, name):
            raise InputError(f"--{name} is for an ensemble: add --count N, or leave it out")
    if options.count is not None and options.resume is not None:
        raise InputError(
            "--count beside --resume: the same command without --resume resumes an ensemble"
        )


def _generate_members(options: argparse.Namespace) -> int:
    """Make the members of an ensemble and its manifest."""
    from trabecula.pipeline.members import check_pattern

    _check_out(options)
    check_pattern(options.out)
    count = shared.integer(options.count, name="--count")
    spread = shared.number(options.spread or "1", name="--spread")
    cluster = _cluster(options)
    with whole_run("reading"):
        return _make_members(options, count, spread, cluster)


def _make_members(options: argparse.Namespace, count: int, spread: float, cluster: Any) -> int:
    """Learn, and make the members one after another."""
    from trabecula.pipeline.ensemble import draw_members
    from trabecula.pipeline.members import generate_members, member_path
    from trabecula.pipeline.outputs import check_target
    from trabecula.pipeline.plan import plan_to

    begin = _share_before(options) / count
    with part(0, begin):
        job = _prepare(options)
    if job.asked:
        raise InputError(
            f"--count beside --target {next(iter(job.asked))}: a property is met by one result; "
            "find its porosity, then give --target porosity=P with --count"
        )
    first = member_path(options.out, job.request.seed)
    check_target(first, resumes=True)
    learned = begin + (1 - begin) * job.learning_share() / count
    with part(begin, learned):
        model = job.fit(memory=options.memory)
    members = draw_members(model, job.request, count=count, spread=spread, alone=options.alone)
    if members.note:
        terminal.note(members.note)
    cut = {"memory": options.memory, "chunks": options.chunks}
    volumes = [request for request, _ in members.volumes()]
    size = plan_to(model, volumes[0], first, **cut).disk if cluster is None else 0
    beside = int(members.members[0].corner is not None)  # a volume while its parts are written
    check_target(first, size=size * (len(volumes) + beside), resumes=True)
    with part(learned, 1):
        made = generate_members(
            model, members, options.out, **cut, cluster=cluster, scratch=options.scratch
        )
    if options.json:
        terminal.show_json({"manifest": str(made.manifest), **made.read()})
    else:
        print(f"{made.manifest}: {len(made.members)} members of {made.members[0].text}")
    return 0


_MOVED = ("exemplar", "mask", "fixed", "known", "coarse", "like", "model")


def _resume(options: argparse.Namespace) -> Any:
    from trabecula.pipeline.generate import resume

    kept = {"resume", "memory", "threads", "workers", "scheduler", "scratch", "json", *_MOVED}
    given = [
        name
        for name, value in vars(options).items()
        if name not in kept and value not in (None, [], 0)
    ]
    if given:
        option = {"exemplars": "an EXEMPLAR", "halvings": "--level"}.get(
            given[0], f"--{given[0].replace('_', '-')}"
        )
        hint = " (--exemplar gives its place now)" if given[0] == "exemplars" else ""
        raise InputError(
            f"{option} beside --resume: the unfinished run knows its request; leave it out{hint}"
        )
    moved = {name: getattr(options, name) for name in _MOVED}
    kept_in = {"memory": options.memory, "cluster": _cluster(options), "scratch": options.scratch}
    with whole_run("reading"):
        return resume(options.resume, **kept_in, **moved)


def _cluster(options: argparse.Namespace) -> Any:
    """Return the workers that the options name; their package is imported where they are."""
    if options.scheduler is None and options.workers is None:
        return None
    from trabecula.engine.cluster import Cluster

    return Cluster(options.scheduler, options.workers)
