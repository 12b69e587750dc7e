"""Tutorials: pages whose python blocks are the cells of a notebook.

A cell is run as a notebook does it: what it prints is shown below it, and so is the value of its
last expression: a picture where that is a 2-D image. `made` inserts these outputs into the page,
`notebook` writes them with the page's text as .ipynb.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import shutil
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import trabecula as tb
from steps.blocks import Block, blocks_of

FOLDER = "tutorials"
MADE = "made"
"""Folder of docs that holds what the examples of a page made, by the page's name."""


@dataclass(frozen=True)
class Output:
    """What a cell gave: its text, and the name of its picture or nothing."""

    line: int
    text: str
    picture: str


def run_cell(page: Path, block: Block, namespace: dict, place: Path) -> Output:
    """Run a block as a cell of a notebook; write its picture into `place`."""
    tree = ast.parse("\n" * (block.line - 1) + block.text, str(page))
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, str(page), "exec"), namespace)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), str(page), "eval"), namespace)
    text, picture = printed.getvalue(), ""
    if isinstance(value, tb.Image) and value.ndim == 2:
        picture = f"cell-{block.line}.png"
        place.mkdir(parents=True, exist_ok=True)
        tb.write(value, place / picture)
    elif value is not None:
        text += f"{value!r}\n"
    return Output(block.line, text, picture)


def write_made(place: Path, name: str, source: str, outputs: Sequence[Output]) -> None:
    """Write the outputs of a page and its notebook beside its pictures."""
    place.mkdir(parents=True, exist_ok=True)
    lines = [vars(one) for one in outputs]
    (place / "outputs.json").write_text(json.dumps(lines), encoding="utf-8")
    cells = notebook(source, outputs, place)
    (place / f"{name}.ipynb").write_text(json.dumps(cells, indent=1) + "\n", encoding="utf-8")


def with_outputs(source: str, place: Path, name: str) -> str:
    """Return the page with what its cells gave, and with a link to its notebook."""
    path = place / "outputs.json"
    if not path.exists():
        return source
    found = {one["line"]: Output(**one) for one in json.loads(path.read_text(encoding="utf-8"))}
    lines = source.splitlines()
    for block in sorted(blocks_of(source), key=lambda one: one.line, reverse=True):
        output = found.get(block.line)
        if block.language != "python" or output is None:
            continue
        end = block.line + block.text.count("\n")  # of the closing fence, counted from 1
        lines[end:end] = _shown(output, name)
    link = f"{{download}}`Download the notebook <../{MADE}/{FOLDER}/{name}/{name}.ipynb>`"
    title = next(i for i, line in enumerate(lines) if line.startswith("# "))
    lines[title + 1 : title + 1] = ["", link]
    return "\n".join(lines) + "\n"


def _shown(output: Output, name: str) -> list[str]:
    lines = []
    if output.text:
        lines += ["", "```text", *output.text.rstrip("\n").splitlines(), "```"]
    if output.picture:
        place = f"../{MADE}/{FOLDER}/{name}/{output.picture}"
        lines += ["", f"![what this cell shows]({place})"]
    return lines


def notebook(source: str, outputs: Sequence[Output], place: Path) -> dict:
    """Return a notebook, nbformat 4.5, of a page's text and blocks with what these gave."""
    found = {one.line: one for one in outputs}
    lines, cells, at = source.splitlines(), [], 0
    for block in blocks_of(source):
        if block.language != "python":
            continue
        cells += _text_cell(lines[at : block.line - 2])
        cells.append(_code_cell(block, found.get(block.line), place, len(cells) + 1))
        at = block.line + block.text.count("\n")
    cells += _text_cell(lines[at:])
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def _text_cell(lines: Sequence[str]) -> list[dict]:
    text = "\n".join(lines).strip()
    cell = {"cell_type": "markdown", "id": _name(text), "metadata": {}, "source": text}
    return [cell] if text else []


def _code_cell(block: Block, output: Output | None, place: Path, number: int) -> dict:
    given = []
    if output and output.text:
        given.append({"output_type": "stream", "name": "stdout", "text": output.text})
    if output and output.picture:
        data = base64.b64encode((place / output.picture).read_bytes()).decode()
        given.append({"output_type": "display_data", "data": {"image/png": data}, "metadata": {}})
    return {
        "cell_type": "code",
        "id": _name(f"{number} {block.text}"),
        "execution_count": number,
        "metadata": {},
        "source": block.text.rstrip("\n"),
        "outputs": given,
    }


def _name(text: str) -> str:
    return uuid.uuid5(uuid.NAMESPACE_URL, text).hex[:12]


def keep_pictures(source: str, page: str, folder: Path, place: Path) -> list[str]:
    """Copy the pictures of a page that its examples made, and list those that are missing."""
    named = {
        part.partition(")")[0].partition('"')[0]
        for part in source.split(f"../{MADE}/{page}/")[1:]
        if part.partition(")")[0].endswith(".png")
    }
    for name in named:
        if (folder / name).is_file():
            place.mkdir(parents=True, exist_ok=True)
            shutil.copy(folder / name, place / name)
    return sorted(name for name in named if not (place / name).is_file())


def data_sets_table() -> str:
    """Return the table of published data sets."""
    from trabecula.exemplar.datasets import DATA_SETS

    rows = ["| name | what | voxels | licence | source |", "|---|---|---|---|---|"]
    for one in DATA_SETS.values():
        shape = " x ".join(map(str, one.shape))
        edge = "" if one.unit == "voxel" else f", {one.spacing:g} {one.unit}"
        where = f"[{one.source}]({one.address})" if one.address else one.source
        rows.append(f"| `{one.name}` | {one.summary} | {shape}{edge} | {one.licence} | {where} |")
    return "\n".join(rows)
