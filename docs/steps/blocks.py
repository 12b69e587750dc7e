"""Fenced blocks of a page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Block:
    """A fenced block of a page; `line` is the number of its first line of text, `shown` what a
    python block prints.
    """

    language: str
    text: str
    line: int
    shown: str | None = None


def blocks_of(text: str) -> Iterator[Block]:
    """List the fenced blocks of a page."""
    fence, language, held, first = "", "", [], 0
    for number, line in enumerate(text.splitlines(), start=1):
        mark = re.match(r"\s*(`{3,})(.*)", line)
        if not fence and mark:
            fence, language, held, first = mark[1], mark[2].strip(), [], number + 1
        elif fence and mark and len(mark[1]) >= len(fence) and not mark[2].strip():
            yield Block(language, "\n".join(held) + "\n", first)
            fence = ""
        elif fence:
            held.append(line)
