"""Measure the language and the layout of the code: `python tests/language/figures.py [--list]
[FOLDER]`.

Prints, for every Python file below a folder (default: the package), how its docstrings begin, how
its functions and classes are named, how long its lines are, and how its modules depend on one
another. `docs/guide/vocabulary.md` has the rules; `test_language.py` holds the package to them.
"""

from __future__ import annotations

import argparse
import ast
import functools
import io
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "trabecula"
LINE_LENGTH = 100

IMPERATIVES = frozenset(
    [
        "absorb",
        "accept",
        "accumulate",
        "adapt",
        "add",
        "adjust",
        "advance",
        "align",
        "allocate",
        "allow",
        "append",
        "apply",
        "ask",
        "assemble",
        "assign",
        "attach",
        "average",
        "balance",
        "begin",
        "bin",
        "binarise",
        "bind",
        "blend",
        "blur",
        "bound",
        "break",
        "bring",
        "broadcast",
        "build",
        "cache",
        "calibrate",
        "call",
        "cancel",
        "cap",
        "carry",
        "cast",
        "change",
        "check",
        "choose",
        "claim",
        "clamp",
        "clean",
        "clear",
        "clip",
        "close",
        "coarsen",
        "collect",
        "colour",
        "combine",
        "compare",
        "compile",
        "complete",
        "compose",
        "compress",
        "compute",
        "connect",
        "construct",
        "continue",
        "convert",
        "convolve",
        "copy",
        "correct",
        "correlate",
        "count",
        "cover",
        "create",
        "crop",
        "crossfade",
        "cut",
        "decide",
        "declare",
        "decode",
        "decompose",
        "decorate",
        "decrease",
        "define",
        "deflate",
        "delete",
        "deliver",
        "demand",
        "derive",
        "describe",
        "detect",
        "determine",
        "differentiate",
        "dilate",
        "discard",
        "dispatch",
        "distribute",
        "divide",
        "do",
        "double",
        "downsample",
        "draw",
        "drive",
        "drop",
        "dye",
        "edit",
        "embed",
        "emit",
        "empty",
        "encode",
        "end",
        "enforce",
        "enlarge",
        "ensure",
        "enter",
        "enumerate",
        "erase",
        "erode",
        "estimate",
        "evaluate",
        "exchange",
        "exclude",
        "execute",
        "expand",
        "explain",
        "export",
        "express",
        "extend",
        "extract",
        "extrapolate",
        "factorise",
        "factorize",
        "fetch",
        "fill",
        "filter",
        "find",
        "finish",
        "fit",
        "fix",
        "flatten",
        "flip",
        "flood",
        "fold",
        "follow",
        "forecast",
        "forget",
        "form",
        "format",
        "free",
        "freeze",
        "gather",
        "generate",
        "get",
        "give",
        "go",
        "group",
        "grow",
        "guard",
        "guess",
        "halve",
        "hand",
        "handle",
        "hash",
        "hide",
        "hold",
        "homogenise",
        "identify",
        "ignore",
        "import",
        "improve",
        "increase",
        "index",
        "infer",
        "inflate",
        "initialise",
        "insert",
        "inspect",
        "install",
        "integrate",
        "interleave",
        "interpolate",
        "intersect",
        "invert",
        "invite",
        "iterate",
        "join",
        "judge",
        "keep",
        "label",
        "lay",
        "learn",
        "leave",
        "let",
        "lift",
        "light",
        "limit",
        "linearise",
        "link",
        "list",
        "load",
        "locate",
        "lock",
        "log",
        "look",
        "lower",
        "make",
        "map",
        "mark",
        "mask",
        "match",
        "measure",
        "merge",
        "mesh",
        "minimise",
        "minimize",
        "mirror",
        "mix",
        "move",
        "multiply",
        "name",
        "narrow",
        "negate",
        "nest",
        "normalise",
        "normalize",
        "notify",
        "nudge",
        "number",
        "obtain",
        "offer",
        "open",
        "optimise",
        "optimize",
        "order",
        "orient",
        "orthonormalise",
        "overlap",
        "overlay",
        "own",
        "pack",
        "pad",
        "paint",
        "parse",
        "partition",
        "pass",
        "pause",
        "perform",
        "permute",
        "pick",
        "pin",
        "place",
        "plan",
        "play",
        "plot",
        "point",
        "pool",
        "pop",
        "populate",
        "postpone",
        "predict",
        "prefer",
        "prepare",
        "present",
        "press",
        "print",
        "probe",
        "process",
        "produce",
        "project",
        "prolong",
        "propagate",
        "propose",
        "prove",
        "provide",
        "prune",
        "pull",
        "push",
        "put",
        "quantise",
        "query",
        "quote",
        "raise",
        "rank",
        "read",
        "rearrange",
        "rebuild",
        "receive",
        "recognise",
        "recompute",
        "record",
        "reduce",
        "refer",
        "refine",
        "refuse",
        "register",
        "reject",
        "relabel",
        "relax",
        "release",
        "remember",
        "remove",
        "rename",
        "render",
        "reorder",
        "repair",
        "repeat",
        "repel",
        "replace",
        "replay",
        "report",
        "represent",
        "request",
        "require",
        "resample",
        "rescale",
        "reset",
        "reshape",
        "resolve",
        "respond",
        "restore",
        "restrict",
        "resume",
        "retry",
        "return",
        "reverse",
        "rewind",
        "rotate",
        "round",
        "run",
        "sample",
        "save",
        "say",
        "scale",
        "scan",
        "scatter",
        "search",
        "seed",
        "seek",
        "segment",
        "select",
        "send",
        "separate",
        "serve",
        "set",
        "settle",
        "shade",
        "shape",
        "share",
        "shift",
        "show",
        "shrink",
        "shuffle",
        "sign",
        "simulate",
        "skip",
        "smooth",
        "solve",
        "sort",
        "split",
        "spread",
        "square",
        "stack",
        "standardise",
        "start",
        "stay",
        "step",
        "stop",
        "store",
        "stream",
        "stretch",
        "strip",
        "subtract",
        "suggest",
        "sum",
        "summarise",
        "supply",
        "support",
        "suspend",
        "swap",
        "sweep",
        "symmetrise",
        "take",
        "tell",
        "test",
        "thicken",
        "thin",
        "thread",
        "threshold",
        "throw",
        "tile",
        "time",
        "trace",
        "track",
        "train",
        "transform",
        "translate",
        "transport",
        "transpose",
        "traverse",
        "treat",
        "triangulate",
        "trim",
        "try",
        "turn",
        "undo",
        "unite",
        "unpack",
        "unroll",
        "update",
        "upload",
        "upsample",
        "use",
        "validate",
        "verify",
        "view",
        "visit",
        "vote",
        "voxelise",
        "wait",
        "walk",
        "warm",
        "warn",
        "warp",
        "watch",
        "weigh",
        "weight",
        "weld",
        "widen",
        "wrap",
        "write",
        "yield",
        "zip",
    ]
)

RELATIVES = frozenset(
    [
        "what",
        "whether",
        "how",
        "of",
        "where",
        "which",
        "who",
        "whose",
        "that",
        "when",
        "as",
        "why",
        "whatever",
        "wherever",
        "whichever",
        "whenever",
    ]
)

IRREGULAR = frozenset(
    [
        "begun",
        "bent",
        "bought",
        "bound",
        "broken",
        "brought",
        "built",
        "burnt",
        "chosen",
        "cut",
        "dealt",
        "done",
        "drawn",
        "driven",
        "drunk",
        "fallen",
        "felt",
        "forgotten",
        "found",
        "frozen",
        "given",
        "gone",
        "ground",
        "grown",
        "heard",
        "held",
        "hidden",
        "hung",
        "kept",
        "known",
        "laid",
        "learnt",
        "led",
        "left",
        "lent",
        "lost",
        "made",
        "meant",
        "met",
        "offered",
        "paid",
        "put",
        "read",
        "said",
        "seen",
        "sent",
        "set",
        "shown",
        "shrunk",
        "shut",
        "sold",
        "spent",
        "split",
        "spoken",
        "spread",
        "spun",
        "stood",
        "stuck",
        "swept",
        "sworn",
        "taken",
        "taught",
        "thought",
        "thrown",
        "told",
        "torn",
        "understood",
        "woken",
        "won",
        "worn",
        "wound",
        "written",
    ]
) - {"cut", "put", "read", "set", "split", "spread", "left", "bound", "ground", "wound", "shut"}

NO_PARTICIPLES = frozenset(
    [
        "seed",
        "need",
        "speed",
        "feed",
        "embed",
        "bed",
        "shed",
        "red",
        "proceed",
        "exceed",
        "succeed",
        "unneeded",
        "led",
    ]
)


@dataclass(frozen=True)
class Figure:
    """A figure of the code: how many of how many, and where.

    Attributes
    ----------
    count, total : int
    places : tuple of str
        "file:line name" of each that counts.
    """

    count: int
    total: int
    places: tuple[str, ...]

    @property
    def share(self) -> float:
        """Return count / total, 0 .. 1."""
        return self.count / max(1, self.total)


@dataclass(frozen=True)
class Definition:
    """A function or class with where it stands, "file:line name", and its docstring."""

    node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    place: str

    @property
    def first_word(self) -> str:
        """Return the first word of the docstring in lower case; empty where there is none."""
        text = (ast.get_docstring(self.node) or "").lstrip("`([*").split()
        return text[0].rstrip(",.:;()").lower() if text else ""

    @property
    def documented(self) -> bool:
        """Return whether there is a docstring."""
        return bool(ast.get_docstring(self.node))


def python_files(folder: Path) -> list[Path]:
    """List the Python files below a folder, sorted."""
    return sorted(path for path in folder.rglob("*.py") if "__pycache__" not in path.parts)


@functools.cache
def _nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def definitions(files: Sequence[Path], kinds: tuple[type, ...]) -> Iterator[Definition]:
    """Yield every definition of some kinds of node."""
    for path in files:
        for node in _nodes(path):
            if isinstance(node, kinds):
                yield Definition(node, f"{_shown(path)}:{node.lineno} {node.name}")  # type: ignore[attr-defined]


def functions(files: Sequence[Path]) -> list[Definition]:
    """List every function and method."""
    return list(definitions(files, (ast.FunctionDef, ast.AsyncFunctionDef)))


def imperative_docstrings(files: Sequence[Path]) -> Figure:
    """Count the function docstrings that do not begin with an imperative."""
    known = [one for one in functions(files) if one.documented]
    other = [one for one in known if one.first_word not in IMPERATIVES]
    return Figure(len(other), len(known), tuple(_with_start(one) for one in other))


def relative_clauses(files: Sequence[Path]) -> Figure:
    """Count the function docstrings that begin with a relative clause."""
    known = [one for one in functions(files) if one.documented]
    found = [one for one in known if one.first_word in RELATIVES]
    return Figure(len(found), len(known), tuple(_with_start(one) for one in found))


def participle_names(files: Sequence[Path]) -> Figure:
    """Count the functions that are named by a participle: `kept`, `made_plain`, `_quantised`."""
    every = functions(files)
    found = [one for one in every if is_participle(one.node.name.strip("_").split("_")[0])]
    return Figure(len(found), len(every), tuple(one.place for one in found))


def is_participle(word: str) -> bool:
    """Return whether a word is a past participle, by its ending or by a list."""
    regular = len(word) > 3 and word.endswith("ed") and word not in NO_PARTICIPLES
    return word in IRREGULAR or regular


def shared_class_names(files: Sequence[Path]) -> Figure:
    """Count the class names that stand in more than one module."""
    places = defaultdict(list)
    for one in definitions(files, (ast.ClassDef,)):
        places[one.node.name].append(one.place)
    shared = {name: found for name, found in places.items() if len(found) > 1}
    return Figure(len(shared), len(places), tuple(", ".join(found) for found in shared.values()))


def long_lines(files: Sequence[Path]) -> Figure:
    """Count the lines longer than `LINE_LENGTH` characters."""
    found, total = [], 0
    for path in files:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            total += 1
            if len(line) > LINE_LENGTH:
                found.append(f"{_shown(path)}:{number} {len(line)}")
    return Figure(len(found), total, tuple(found))


def comment_lines(files: Sequence[Path]) -> int:
    """Count the lines that hold a comment."""
    return sum(
        token.type == tokenize.COMMENT
        for path in files
        for token in tokenize.generate_tokens(
            io.StringIO(path.read_text(encoding="utf-8")).readline
        )
    )


def code_lines(path: Path) -> int:
    """Count the lines of a file that hold code: no blank lines, comments or docstrings."""
    source = path.read_text(encoding="utf-8")
    silent = (
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    )
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in silent:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for one in body if isinstance(body, list) else []:
            if (
                isinstance(one, ast.Expr)
                and isinstance(one.value, ast.Constant)
                and isinstance(one.value.value, str)
            ):
                lines -= set(range(one.lineno, (one.end_lineno or one.lineno) + 1))
    return len(lines)


def module_name(path: Path) -> str:
    """Return the dotted name of a file of the package."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(files: Sequence[Path], *, deferred: bool = True) -> dict[str, set[str]]:
    """Map each module of the package to the modules of it that it imports.

    `deferred` counts the imports inside functions as well; those for type checkers alone never
    count.
    """
    known = {module_name(path) for path in files}
    found: dict[str, set[str]] = {}
    for path in files:
        name = module_name(path)
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        edges = {
            target
            for statement in _statements(ast.parse(path.read_text(encoding="utf-8")), deferred)
            for target in _targets(statement, package, known)
        }
        found[name] = edges - {name}
    return found


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """List the groups of modules that import each other in a circle (strongly connected
    components).
    """
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            group, stack[at:] = stack[at:], []
            if len(group) > 1:
                groups.append(sorted(group))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return groups


def single_importers(graph: dict[str, set[str]]) -> list[str]:
    """List the modules that exactly one other module imports, packages left out."""
    importers = Counter(target for targets in graph.values() for target in targets)
    packages = {name.rpartition(".")[0] for name in graph}
    return sorted(name for name, count in importers.items() if count == 1 and name not in packages)


def _statements(tree: ast.Module, deferred: bool) -> Iterator[ast.Import | ast.ImportFrom]:
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting.extend(node.orelse)
        elif deferred or not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            waiting.extend(ast.iter_child_nodes(node))


def _targets(node: ast.Import | ast.ImportFrom, package: str, known: set[str]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    else:
        parts = package.split(".")
        base = ".".join(parts[: len(parts) - node.level + 1]) if node.level else ""
        module = ".".join(filter(None, (base, node.module)))
        names = [f"{module}.{alias.name}" for alias in node.names]
    for name in names:
        while name and name not in known:
            name = name.rpartition(".")[0]
        if name:
            yield name


def _with_start(one: Definition) -> str:
    text = (ast.get_docstring(one.node) or "").splitlines()[0]
    return f"{one.place}: {text}"


def _shown(path: Path) -> str:
    return path.resolve().relative_to(ROOT).as_posix()


def main() -> None:
    """Print the figures of a folder."""
    parser = argparse.ArgumentParser(
        description="The language and the layout of the code in figures."
    )
    parser.add_argument("folder", nargs="*", type=Path, default=[PACKAGE], help="folders or files")
    parser.add_argument("--list", action="store_true", help="also list what counts")
    given = parser.parse_args()
    files = [
        file for one in given.folder for file in (python_files(one) if one.is_dir() else [one])
    ]
    every = python_files(PACKAGE)
    figures = {
        "docstrings that begin with no imperative": imperative_docstrings(files),
        "of them with a relative clause": relative_clauses(files),
        "functions named by a participle": participle_names(files),
        "class names in several modules": shared_class_names(files),
        f"lines over {LINE_LENGTH} characters": long_lines(files),
    }
    for name, figure in figures.items():
        print(f"{name}: {figure.count} of {figure.total} ({figure.share:.1%})")
        if given.list:
            print(*(f"    {place}" for place in figure.places), sep="\n")
    lines = sum(code_lines(path) for path in files)
    print(
        f"files: {len(files)}, lines of code: {lines}, lines with a comment: {comment_lines(files)}"
    )
    graph = imports(every)
    alone, rings = single_importers(graph), circles(graph)
    print(
        f"modules of the package with one importer: {len(alone)}; circles of imports: {len(rings)}"
    )
    if given.list:
        print(*(f"    {name}" for name in alone), sep="\n")
        print(*(f"    circle: {' '.join(ring)}" for ring in rings), sep="\n")


if __name__ == "__main__":
    main()
