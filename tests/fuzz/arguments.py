"""One call of a public function, or one line of the command line, with strange arguments."""

import inspect
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from damage import LIES
from specimens import COLOUR, FLOATS, HALF, LABELS, check, image

import trabecula as tb
from commands import attempt as run_line
from trabecula.cli.main import VERBS
from trabecula.errors import TrabeculaError

MODULES = ("measure", "finish", "fields")
LINE_SHARE = 0.2
"""Of the cases, those of the command line."""
SKIPPED = {
    "fields.simp",  # minutes by right: an optimisation of a grid
    "sample",  # the same: samples are made at their size
}
UNTRIED_VERBS = ("demo", "bench")  # take minutes, whatever their arguments

BINDING = (
    "positional argument but",
    "unexpected keyword argument",
    "required positional argument",
    "required keyword-only",
)
"""What Python itself says of arguments that are missing or unknown, also of an inner function."""

VOLUME = np.kron(HALF, np.ones((3, 3, 3), np.uint8))


@cache
def functions() -> dict[str, Callable[..., Any]]:
    """Return every public function by its name below `trabecula`."""
    found: dict[str, Callable[..., Any]] = {}
    for module in ("", *MODULES):
        home = getattr(tb, module) if module else tb
        for name in home.__all__:
            value = getattr(home, name)
            whole = f"{module}.{name}".lstrip(".")
            callable_ = callable(value) and not isinstance(value, type)
            if callable_ and whole not in SKIPPED:
                found[whole] = value
    found |= {"Image": tb.Image, "Request": tb.Request, "Recipe.from_json": tb.Recipe.from_json}
    for name in ("noise", "lattice", "kopf"):
        found[f"method({name})"] = lambda name=name, **settings: tb.method(name, **settings)
        found[f"{name}.fit"] = tb.method(name).fit
    found["lattice.generate"] = tb.method("lattice", cell_size=4.0).fit().generate
    return found


def choose(seed: int, number: int) -> tuple[str, np.random.Generator]:
    """Return the name of a function, or of a verb as "trabecula VERB", and its random numbers."""
    rng = np.random.default_rng([seed, number, 7])
    verbs = [verb for verb in VERBS if verb not in UNTRIED_VERBS]
    if rng.random() < LINE_SHARE:
        return f"trabecula {verbs[int(rng.integers(len(verbs)))]}", rng
    names = list(functions())
    return names[int(rng.integers(len(names)))], rng


def attempt(seed: int, number: int, folder: Path) -> None:
    """Call the function of a case, or run its line."""
    name, rng = choose(seed, number)
    write_files(folder)
    if name.startswith("trabecula "):
        words = [name.split()[1], *(_word(rng) for _ in range(int(rng.integers(0, 6))))]
        output = run_line(*words)
        assert output.status in (0, 2), f"exit status {output.status}: {output.err}"
        if output.status == 2:
            assert len(output.lines) == 1 and not output.out, output.err
            raise TrabeculaError(output.lines[0])
        return
    function = functions()[name]
    positional, named = arguments(rng, function)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = function(*positional, **named)
        except TypeError as error:
            inner = error.__traceback__ and error.__traceback__.tb_next
            if inner is None or any(words in str(error) for words in BINDING):
                return
            raise
    for value in found if isinstance(found, tuple) else (found,):
        check(value)


def prepare() -> None:
    """Import what every case needs."""
    functions()


def write_files(folder: Path) -> None:
    """Write the files that arguments name."""
    np.save(folder / "scan.npy", VOLUME)
    np.save(folder / "grey.npy", FLOATS)
    tb.write(image(LABELS[0], "labels"), folder / "plane.png")


def arguments(rng: np.random.Generator, function: Callable) -> tuple[list[Any], dict[str, Any]]:
    """Draw the arguments of a function: some that fit by their names, some of any sort."""
    positional, named = [], {}
    for name, parameter in inspect.signature(function).parameters.items():
        needed = parameter.default is parameter.empty
        if parameter.kind is parameter.VAR_KEYWORD:
            if rng.random() < 0.3:
                named[str(rng.choice(["phase", "r_max", "kind", "spacing", "x"]))] = _any(rng)
        elif parameter.kind is parameter.VAR_POSITIONAL:
            positional += [_fitting(rng, "image") for _ in range(int(rng.integers(0, 3)))]
        elif rng.random() < (0.98 if needed else 0.35):
            value = _fitting(rng, name) if rng.random() < (0.85 if needed else 0.4) else _any(rng)
            if parameter.kind is parameter.KEYWORD_ONLY:
                named[name] = value
            elif len(positional) == list(inspect.signature(function).parameters).index(name):
                positional.append(value)
            else:
                named[name] = value
    return positional, named


IMAGES: list[Callable[[], Any]] = [
    lambda: image(VOLUME, "labels"),
    lambda: tb.Image(VOLUME, "labels", 2.0, "um"),
    lambda: VOLUME,
    lambda: image(VOLUME[0], "labels"),
    lambda: image(LABELS, "labels"),
    lambda: image(FLOATS, "grey"),
    lambda: image(COLOUR, "colour"),
    lambda: image(np.zeros((4, 4, 4), np.uint8), "labels"),
    lambda: image(np.ones((4, 4, 4), np.uint8), "labels"),
    lambda: image(np.ones((1, 1, 1), np.uint8), "labels"),
    lambda: image(np.full((3, 4, 5), 7.5), "grey"),
    lambda: tb.Image(VOLUME, "labels", phases=("rock", "oil")),
    lambda: tb.Image(np.eye(7, dtype=np.uint8), "labels", spacing=(1e-9, 1e-9), unit="m"),
    lambda: image(np.ones((1, 9, 1), np.uint8), "labels"),
]
FITTING: dict[str, list[Any]] = {
    "phase": ["solid", "void", 0, 1, None],
    "phases": [("void", "solid"), ("a", "b", "c")],
    "kind": ["labels", "grey", "colour"],
    "spacing": [1.0, (1, 2, 3), (0.5, 0.5)],
    "unit": ["um", "mm", "voxel"],
    "r_max": [1, 3, 5],
    "shape": [(4, 5, 6), 8, (6, 6)],
    "corner": [(0, 0, 0), (1, 1, 1)],
    "size": [3, (2, 3, 4), (64, 48)],
    "threshold": [0.0, "otsu", (0.0, 1.0), "dual"],
    "axis": [0, 1, 2, "z"],
    "axes": ["zyx", (0, 1, 2)],
    "level": ["quick", 0, 1],
    "seed": [0, 7],
    "path": ["scan.npy", "grey.npy", "plane.png", "new.npy", "new.stl", "new.zarr"],
    "source": ["scan.npy", "grey.npy", "sample:bone"],
    "name": ["noise", "lattice", "x"],
    "values": [VOLUME, LABELS, FLOATS],
    "target": [{"porosity": 0.4}],
    "count": [1, 2],
    "radius": [1.0, 2.0],
    "mask": [VOLUME > 0, None],
    "printer": ["sla", "fdm"],
    "window": [3, (2, 2, 2)],
}
ODD: list[Any] = [None, True, -1, 0, 1, 2, 0.5, -0.5, 1e-300, 1e300, float("nan"), float("inf")]
ODD += ["", "x", "zyx", "solid", b"x", [], (), {}, [1, 2, 3], (1, 2), [[1]], ["a", 1], {"x": 1}]
ODD += [object(), 1j, np.nan, np.float32(2), np.int8(-3), np.array(3), np.array([]), set(), print]
ODD += [np.zeros((2, 2, 2)), np.full((3, 3, 3), np.nan), np.zeros((0, 3, 3), np.uint8)]
ODD += [np.zeros((2,) * 5, np.uint8), np.array(["a", "b"]), np.array([None, 1]), Path("scan.npy")]
ODD += [np.zeros((4, 4, 4), "M8[s]"), np.full((3, 3), 300), np.array([[1 + 2j]]), range(3), *LIES]


def _any(rng: np.random.Generator) -> Any:
    return ODD[int(rng.integers(len(ODD)))] if rng.random() < 0.85 else _image(rng)


def _image(rng: np.random.Generator) -> Any:
    return IMAGES[int(len(IMAGES) * rng.random() ** 1.5)]()


def _fitting(rng: np.random.Generator, name: str) -> Any:
    """Return a value that a parameter of that name may take."""
    values = FITTING.get(name)
    return _image(rng) if values is None else values[int(rng.integers(len(values)))]


WORDS = ["scan.npy", "grey.npy", "plane.png", "new.npy", "new.stl", "x.zarr", ".", "sample:", "-"]
WORDS += ["--out", "--json", "--shape", "--seed", "--crop", "--phase", "--method", "--set", "--box"]
WORDS += [
    "--spacing",
    "--unit",
    "--kind",
    "--threshold",
    "--quick",
    "--r-max",
    "--threads",
    "--help",
]
WORDS += ["--memory", "--connect", "--smooth", "--target", "--mask", "--periodic", "--fixed", "--"]
WORDS += ["4", "8", "-1", "0", "nan", "inf", "1e9", "99999999999999999999", "x=1", "porosity=nan"]
WORDS += ["noise", "lattice", "solid", "um", "ramp", "labels", "otsu", "../..", "", "é", "9" * 5000]


def _word(rng: np.random.Generator) -> str:
    return WORDS[int(rng.integers(len(WORDS)))]
